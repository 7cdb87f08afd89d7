/* Ball and beam: a servo on Timer 1, a potentiometer on the converter, 100 samples per second.
 *
 * Timer 1 makes one pulse per turn; every SERVO_PULSES_PER_SAMPLE turns begin a sample period. Within
 * it the servo goes linearly from the pulse at the last sample to the latest command, so the pulse
 * that begins with a sample is exactly what the last command asked for, and what STATE shows.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <math.h>
#include <util/atomic.h>

#include "bench.h"
#include "clock.h"
#include "loop.h"
#include "session.h"

enum {
    TICK = 5, /* of Timer 1: 16 MHz / 8, in 0.1 us */
    TICKS_PER_TURN = 2000000UL / SAMPLE_RATE / SERVO_PULSES_PER_SAMPLE,
    LEVEL = (SERVO_LEVEL + TICK / 2) / TICK,
    FARTHEST = SERVO_QUARTER_TURN / TICK,
    BETWEEN_PULSES = LEVEL + FARTHEST + 100,
    SURPLUS_BITS = 10 - POSITION_BITS,
};

_Static_assert(POSITION_BITS == 8 || POSITION_BITS == 10, "POSITION_BITS: expected 8 or 10");
/* these divide by a shift, and their product with the longest way fits into 16 bits */
_Static_assert(SERVO_PULSES_PER_SAMPLE == 1 || SERVO_PULSES_PER_SAMPLE == 2 || SERVO_PULSES_PER_SAMPLE == 4,
               "SERVO_PULSES_PER_SAMPLE: expected 1, 2 or 4");
_Static_assert(TICKS_PER_TURN <= 65536UL, "SAMPLE_RATE times SERVO_PULSES_PER_SAMPLE: expected 31 or more");
_Static_assert(BETWEEN_PULSES + 100UL < TICKS_PER_TURN, "SERVO_PULSES_PER_SAMPLE: the pulse does not fit");

static const struct channel_scale channels[] = {
    {POSITION_SCALE * (1 << SURPLUS_BITS), POSITION_ZERO / (1 << SURPLUS_BITS)},
    {(float)M_PI / 2.0f / SERVO_QUARTER_TURN, LEVEL *TICK},
};

const struct bench bench = {
    .device = "ball_beam",
    .serial = BENCH_SERIAL,
    .sample_rate = SAMPLE_RATE,
    .channels = channels,
    .channel_count = 2,
    .fitted_count = 2,
    .safe = LEVEL * TICK,
    .longest_output_s = LONGEST_OUTPUT_S,
};

/* Pulse widths in ticks. */
static volatile uint16_t wanted = LEVEL; /* the latest command */
static uint16_t from = LEVEL, to = LEVEL; /* at the last sample, and at the next */
static uint8_t turn;                      /* of the sample period */

struct sample {
    uint16_t seq;
    uint32_t t_us;
    uint16_t pulse;
    uint16_t count;
};

static struct sample sampling;          /* belongs to the interrupt handlers */
static volatile struct sample finished; /* waits for the main loop */
static volatile bool has_finished;

void bench_begin(void)
{
    ICR1 = TICKS_PER_TURN - 1;
    OCR1A = LEVEL - 1;
    OCR1B = BETWEEN_PULSES;
    TCCR1A = _BV(COM1A1) | _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS11);
    TIMSK1 = _BV(TOIE1) | _BV(OCIE1B);
    DDRB |= _BV(PB5); /* the pin follows the timer from here on */

    DIDR0 = _BV(POSITION_PIN);
    ADMUX = _BV(REFS0) | POSITION_PIN;
    ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0); /* 125 kHz */
}

void bench_set(uint16_t raw)
{
    int32_t tenths = (int32_t)raw - LEVEL * TICK;
    int32_t ticks = (tenths + (tenths < 0 ? -TICK / 2 : TICK / 2)) / TICK;
    if (ticks > FARTHEST)
        ticks = FARTHEST;
    if (ticks < -FARTHEST)
        ticks = -FARTHEST;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { wanted = (uint16_t)(LEVEL + ticks); }
}

/* A pulse begins, and with the first of a period a sample. */
ISR(TIMER1_OVF_vect)
{
    if (++turn < SERVO_PULSES_PER_SAMPLE)
        return;
    turn = 0;
    sampling.t_us = clock_us_in_interrupt();
    ADCSRA |= _BV(ADSC);
    sampling.seq++;
    sampling.pulse = to;
    from = to;
    to = wanted;
}

/* The pulse is over: the next one gets its width. It is taken over at the end of the turn. */
ISR(TIMER1_COMPB_vect)
{
    int16_t way = (int16_t)(to - from);
    OCR1A = (uint16_t)(from + way * (turn + 1) / SERVO_PULSES_PER_SAMPLE) - 1;
}

ISR(ADC_vect)
{
    sampling.count = ADC >> SURPLUS_BITS;
    finished = sampling; /* one that nobody fetched is lost, and its number missing */
    has_finished = true;
    loop_note_sample();
}

bool bench_has_report(void)
{
    return has_finished;
}

void bench_report(void)
{
    struct sample sample;
    if (!has_finished)
        return;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        sample = finished;
        has_finished = false;
    }
    const uint16_t raw[] = {sample.count, sample.pulse * TICK};
    session_state(sample.seq, sample.t_us, raw);
}
