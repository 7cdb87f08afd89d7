#include "clock.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#if F_CPU != 16000000UL
#error "expected a clock of 16 MHz: the prescalers are chosen for it"
#endif

static volatile uint32_t overflows;

void clock_begin(void)
{
    TCCR5A = 0;
    TCCR5B = _BV(CS51); /* 16 MHz / 8 */
    TIMSK5 = _BV(TOIE5);
}

ISR(TIMER5_OVF_vect)
{
    overflows++;
}

/* The ticks, and in `wraps` the overflows up to them, with one that still waits for its handler. */
static uint16_t read_ticks(uint32_t *wraps)
{
    uint16_t ticks = TCNT5;
    *wraps = overflows;
    if ((TIFR5 & _BV(TOV5)) && ticks < 0x8000) /* else it came after the ticks were read */
        ++*wraps;
    return ticks;
}

uint32_t clock_us_in_interrupt(void)
{
    uint32_t wraps;
    uint16_t ticks = read_ticks(&wraps);
    return (wraps << 15) | (ticks >> 1);
}

uint32_t clock_ticks_in_interrupt(void)
{
    uint32_t wraps;
    uint16_t ticks = read_ticks(&wraps);
    return (wraps << 16) | ticks;
}

uint32_t clock_us(void)
{
    uint32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = clock_us_in_interrupt(); }
    return now;
}
