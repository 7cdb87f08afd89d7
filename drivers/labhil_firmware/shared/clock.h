/* The device's clock: Timer 5, free-running at 2 MHz, widened by its overflows. Wraps after 71.6 min. */
#ifndef LABHIL_CLOCK_H
#define LABHIL_CLOCK_H

#include <stdint.h>

void clock_begin(void);

/* Microseconds since boot. */
uint32_t clock_us(void);

/* The same for interrupt handlers, where interrupts are off already. */
uint32_t clock_us_in_interrupt(void);

/* Half microseconds, for interrupt handlers; wraps after 35.8 min. */
uint32_t clock_ticks_in_interrupt(void);

#endif
