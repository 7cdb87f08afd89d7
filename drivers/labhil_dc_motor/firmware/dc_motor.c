/* DC motor: an H-bridge on Timer 1, an encoder by interrupts, current by the converter.
 *
 * Timer 4 begins a sample. The encoder's count and the times of its last edges are read at that very
 * moment, the current is converted, then the latest command acts until the next sample.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <math.h>
#include <util/atomic.h>

#include "batch.h"
#include "bench.h"
#include "encoder.h"
#include "loop.h"
#include "session.h"

enum {
    FULL = 800, /* of Timer 1: a duty of 1, 20 kHz */
    ZERO_VOLT = 32768U,
    LARGEST_MV = 12000,
    SUPPLY_MV = (uint16_t)(MOTOR_SUPPLY * 1000.0f),
    TICKS_PER_SAMPLE = 2000000UL / SAMPLE_RATE, /* of Timer 4: 16 MHz / 8 */
    HAS_TEMPERATURE = TEMPERATURE_SCALE != 0,
    CONVERSIONS = HAS_TEMPERATURE ? 2 : 1,
};

_Static_assert(SAMPLE_RATE >= 31 && SAMPLE_RATE <= 1000, "SAMPLE_RATE: expected 31 to 1000");

static const struct channel_scale channels[] = {
    {ENCODER_SPEED_SCALE, ENCODER_SPEED_ZERO},
    {CURRENT_SCALE, CURRENT_ZERO},
    {2.0f * (float)M_PI / ENCODER_COUNTS, 0.0f},
    {TEMPERATURE_SCALE, TEMPERATURE_ZERO},
    {1e-3f, ZERO_VOLT},
};

const struct bench bench = {
    .device = "dc_motor",
    .serial = BENCH_SERIAL,
    .sample_rate = SAMPLE_RATE,
    .channels = channels,
    .channel_count = 5,
    .fitted_count = HAS_TEMPERATURE ? 5 : 4,
    .safe = ZERO_VOLT,
    .longest_output_s = LONGEST_OUTPUT_S,
};

static const uint8_t pins[] = {CURRENT_PIN, TEMPERATURE_PIN};

/* The latest command: a duty with the direction as its sign, and the voltage that this really is. */
static volatile int16_t wanted;
static volatile uint16_t wanted_raw = ZERO_VOLT;

/* What follows belongs to the interrupt handlers. */
static volatile uint8_t conversion; /* which one is made; CONVERSIONS when all are */
static volatile bool has_speed;
static uint16_t raw[MOST_CHANNELS];

void bench_begin(void)
{
    PORTB &= (uint8_t) ~(_BV(PB5) | _BV(PB6));
    PORTH |= _BV(PH5); /* enabled, and both halves low: a brake */
    DDRB |= _BV(PB5) | _BV(PB6);
    DDRH |= _BV(PH5);
    ICR1 = FULL - 1;
    TCCR1A = _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);

    encoder_begin();

    DIDR0 = _BV(CURRENT_PIN) | (HAS_TEMPERATURE ? _BV(TEMPERATURE_PIN) : 0);
    ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1); /* 250 kHz: 52 us each */

    OCR4A = TICKS_PER_SAMPLE - 1;
    TCCR4A = 0;
    TCCR4B = _BV(WGM42) | _BV(CS41);
    TIMSK4 = _BV(OCIE4A);
}

/* Drive one half by its timer and leave the other one low; a compare of 0 would still be a spike. */
static void drive(int16_t duty)
{
    uint8_t halves = 0;
    if (duty > 0) {
        OCR1A = (uint16_t)duty - 1;
        halves = _BV(COM1A1);
    } else if (duty < 0) {
        OCR1B = (uint16_t)-duty - 1;
        halves = _BV(COM1B1);
    }
    TCCR1A = _BV(WGM11) | halves;
}

void bench_set(uint16_t value)
{
    int32_t millivolt = (int32_t)value - (int32_t)ZERO_VOLT;
    if (millivolt > LARGEST_MV)
        millivolt = LARGEST_MV;
    if (millivolt < -LARGEST_MV)
        millivolt = -LARGEST_MV;
    int32_t half = millivolt < 0 ? -(SUPPLY_MV / 2L) : SUPPLY_MV / 2L;
    int32_t duty = (millivolt * FULL + half) / SUPPLY_MV;
    if (duty > FULL)
        duty = FULL;
    if (duty < -FULL)
        duty = -FULL;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        wanted = (int16_t)duty;
        wanted_raw = (uint16_t)((int32_t)ZERO_VOLT + duty * SUPPLY_MV / FULL);
    }
}

static void convert(uint8_t which)
{
    conversion = which;
    ADMUX = _BV(REFS0) | pins[which];
    ADCSRA |= _BV(ADSC);
}

/* All of a sample is there: let its command act. */
static void finish(void)
{
    drive(wanted);
    raw[bench.fitted_count - 1] = wanted_raw;
    batch_end_sample(raw);
}

ISR(TIMER4_COMPA_vect)
{
    convert(0);
    batch_begin_sample();
    raw[2] = encoder_count();
    struct edges edges = encoder_last_edges();
    has_speed = false;
    sei(); /* no edge may wait for the division */
    uint16_t speed = encoder_speed(edges);
    cli();
    raw[0] = speed;
    has_speed = true;
    if (conversion == CONVERSIONS)
        finish();
}

ISR(ADC_vect)
{
    raw[conversion == 0 ? 1 : 3] = ADC;
    if (conversion + 1 < CONVERSIONS) {
        convert(conversion + 1);
        return;
    }
    conversion = CONVERSIONS;
    if (has_speed)
        finish();
}

bool bench_has_report(void)
{
    return batch_is_full();
}

void bench_report(void)
{
    batch_send();
}
