/* Solenoid: a current loop at 5 kHz on a coil driven by Timer 1, samples by the converter.
 *
 * Timer 4 begins a step of the loop every 200 us. A step converts the current, then position (and
 * force); as soon as the current is known, the PI sets the coil's duty. Every so many steps begin a
 * sample: its current is read before its command is taken over, its position 52 us after its current,
 * and its voltage is the mean over the sample period before it.
 */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <util/atomic.h>

#include "batch.h"
#include "bench.h"
#include "loop.h"
#include "session.h"

#define STEP_RATE 5000

enum {
    FULL = 800, /* of Timer 1: a duty of 1, 20 kHz */
    STEPS = STEP_RATE / SAMPLE_RATE,
    LARGEST = 27000, /* command, in 0.1 mA */
    COMMAND_BITS = 4, /* of a count, in which the PI takes its set point */
    GAIN_BITS = 16,
    HAS_FORCE = FORCE_SCALE != 0,
    CONVERSIONS = HAS_FORCE ? 3 : 2,
};

/* The PI, from errors in counts / 16 to duties in 1/800: gains L/tau (V/A) and R/tau (V/(A s)). */
#define DUTY_PER_VOLT (FULL / COIL_SUPPLY)
#define AMPERE_PER_ERROR (CURRENT_SCALE / (1 << COMMAND_BITS))
#define GAIN(volt_per_ampere) \
    ((int32_t)((volt_per_ampere) * AMPERE_PER_ERROR * DUTY_PER_VOLT * (1L << GAIN_BITS) + 0.5f))
#define PROPORTIONAL GAIN(COIL_INDUCTANCE / LOOP_TIME_CONSTANT)
#define INTEGRAL GAIN(COIL_RESISTANCE / LOOP_TIME_CONSTANT / STEP_RATE)
/* from commands in 0.1 mA to counts / 16 */
#define ERROR_PER_COMMAND ((uint32_t)(1e-4f / AMPERE_PER_ERROR * 65536.0f + 0.5f))

_Static_assert(SAMPLE_RATE * STEPS == STEP_RATE, "SAMPLE_RATE: expected a divisor of 5000");
_Static_assert(CURRENT_SCALE > 7e-4f, "CURRENT_SCALE: the set point would not fit into 32 bits");
_Static_assert(STEPS >= 2, "SAMPLE_RATE: expected at most 2500, the converter's interrupt takes its time");

static const struct channel_scale channels[] = {
    {CURRENT_SCALE, CURRENT_ZERO},
    {POSITION_SCALE, POSITION_ZERO},
    {COIL_SUPPLY / FULL / STEPS, 0.0f},
    {FORCE_SCALE, FORCE_ZERO},
    {1e-4f, 0.0f},
};

const struct bench bench = {
    .device = "solenoid",
    .serial = BENCH_SERIAL,
    .sample_rate = SAMPLE_RATE,
    .channels = channels,
    .channel_count = 5,
    .fitted_count = HAS_FORCE ? 5 : 4,
    .safe = 0,
    .longest_output_s = LONGEST_OUTPUT_S,
};

static const uint8_t pins[] = {CURRENT_PIN, POSITION_PIN, FORCE_PIN};

static volatile uint16_t wanted;      /* the latest command, 0.1 mA */
static volatile uint16_t wanted_count; /* the same in counts / 16 */

/* What follows belongs to the interrupt handlers. */
static uint16_t set_point;      /* counts / 16 */
static uint16_t command;        /* in effect, 0.1 mA */
static int32_t accumulated;     /* the integral, duty << GAIN_BITS */
static uint16_t duty, duty_sum; /* now, and over the sample period */
static uint8_t step;            /* of the sample period */
static uint8_t conversion;
static uint16_t raw[MOST_CHANNELS];

static void coil_set(uint16_t new_duty)
{
    duty = new_duty;
    if (duty == 0) {
        /* a compare of 0 would still be a spike: let go of the pin, it is low */
        TCCR1A &= (uint8_t)~_BV(COM1A1);
        return;
    }
    OCR1A = duty - 1;
    TCCR1A |= _BV(COM1A1);
}

/* No command, no current: whatever the sensor says, the coil is off. */
static void coil_off(void)
{
    accumulated = 0;
    coil_set(0);
}

void bench_begin(void)
{
    PORTB &= (uint8_t)~_BV(PB5);
    DDRB |= _BV(PB5);
    ICR1 = FULL - 1;
    TCCR1A = _BV(WGM11);
    TCCR1B = _BV(WGM13) | _BV(WGM12) | _BV(CS10);

    DIDR0 = _BV(CURRENT_PIN) | _BV(POSITION_PIN) | (HAS_FORCE ? _BV(FORCE_PIN) : 0);
    ADCSRA = _BV(ADEN) | _BV(ADIE) | _BV(ADPS2) | _BV(ADPS1); /* 250 kHz: 52 us each */

    OCR4A = F_CPU / STEP_RATE - 1;
    TCCR4A = 0;
    TCCR4B = _BV(WGM42) | _BV(CS40);
    TIMSK4 = _BV(OCIE4A);
}

void bench_set(uint16_t value)
{
    if (value > LARGEST)
        value = LARGEST;
    uint16_t count = (uint16_t)((value * ERROR_PER_COMMAND) >> 16);
    count += (uint16_t)(CURRENT_ZERO * (1 << COMMAND_BITS));
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE)
    {
        wanted = value;
        wanted_count = count;
    }
}

static void control(uint16_t current)
{
    if (command == 0) {
        coil_off();
        return;
    }
    int16_t error = (int16_t)(set_point - (current << COMMAND_BITS));
    int32_t next = accumulated + error * INTEGRAL;
    int32_t output = (next + error * PROPORTIONAL) >> GAIN_BITS;
    /* where the supply ends the integral stops, unless it comes back from there */
    if (output > FULL) {
        output = FULL;
        if (error < 0)
            accumulated = next;
    } else if (output < 0) {
        output = 0;
        if (error > 0)
            accumulated = next;
    } else {
        accumulated = next;
    }
    coil_set((uint16_t)output);
}

static void convert(uint8_t which)
{
    conversion = which;
    ADMUX = _BV(REFS0) | pins[which];
    ADCSRA |= _BV(ADSC);
}

ISR(TIMER4_COMPA_vect)
{
    convert(0);
    if (step == 0)
        batch_begin_sample();
}

/* The current of a sample is known: keep what the sample holds, and let its command act. */
static void take_over(uint16_t current)
{
    raw[0] = current;
    raw[2] = duty_sum;
    duty_sum = 0;
    command = wanted;
    set_point = wanted_count;
    raw[bench.fitted_count - 1] = command;
}

ISR(ADC_vect)
{
    uint16_t count = ADC;
    uint8_t done = conversion;
    if (done + 1 < CONVERSIONS)
        convert(done + 1);
    if (done == 0) {
        if (step == 0)
            take_over(count);
        control(count);
        duty_sum += duty;
    } else if (step == 0) {
        raw[done == 1 ? 1 : 3] = count;
    }
    if (done + 1 == CONVERSIONS) {
        if (step == 0)
            batch_end_sample(raw);
        if (++step == STEPS)
            step = 0;
    }
}

bool bench_has_report(void)
{
    return batch_is_full();
}

void bench_report(void)
{
    batch_send();
}
