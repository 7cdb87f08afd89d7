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

uint32_t clock_us_in_interrupt(void)
{
    uint16_t ticks = TCNT5;
    uint32_t wraps = overflows;
    /* an overflow that waits for its handler counts, if the ticks were read after it */
    if ((TIFR5 & _BV(TOV5)) && ticks < 0x8000)
        wraps++;
    return (wraps << 15) | (ticks >> 1);
}

uint32_t clock_us(void)
{
    uint32_t now;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { now = clock_us_in_interrupt(); }
    return now;
}
