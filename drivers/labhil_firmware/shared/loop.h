/* What the main loop asks of a bench. */
#ifndef LABHIL_LOOP_H
#define LABHIL_LOOP_H

#include <stdbool.h>

/* Set up pins, timers and converter, the outputs safe from the first moment; interrupts are off. */
void bench_begin(void);

/* Send the sample that waits, if there is one. */
void bench_report(void);

/* Called by the bench's interrupt handlers when a sample is complete. The watchdog timer is satisfied only
 * by a loop that turns and a bench that samples: an output nobody measures must not stay on. */
void loop_note_sample(void);

/* Tell whether a sample waits; called with interrupts off. */
bool bench_has_report(void);

#endif
