/* What the main loop asks of a bench. */
#ifndef LABHIL_LOOP_H
#define LABHIL_LOOP_H

#include <stdbool.h>

/* Set up pins, timers and converter, the outputs safe from the first moment; interrupts are off. */
void bench_begin(void);

/* Send the sample that waits, if there is one. */
void bench_report(void);

/* Tell whether a sample waits; called with interrupts off. */
bool bench_has_report(void);

#endif
