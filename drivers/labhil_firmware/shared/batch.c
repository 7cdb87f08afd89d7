#include "batch.h"

#include <string.h>

#include "bench.h"
#include "clock.h"
#include "loop.h"
#include "session.h"

#ifdef SAMPLES_PER_FRAME

enum { PLACES = 32 }; /* a power of two, so that indices wrap by a mask */

_Static_assert(SAMPLES_PER_FRAME <= MOST_SAMPLES(MOST_CHANNELS), "SAMPLES_PER_FRAME: too long a frame");
_Static_assert(SAMPLES_PER_FRAME < PLACES, "SAMPLES_PER_FRAME: expected less than 32");

struct sample {
    uint32_t number;
    uint32_t t_us;
    uint16_t raw[MOST_CHANNELS];
};

static struct sample samples[PLACES];
static volatile uint8_t head, tail; /* written by the handlers; by the main loop */
static uint32_t next_number;

void batch_begin_sample(void)
{
    samples[head].t_us = clock_us_in_interrupt();
    samples[head].number = next_number++;
}

void batch_end_sample(const uint16_t *raw)
{
    loop_note_sample();
    uint8_t next = (head + 1) & (PLACES - 1);
    if (next == tail)
        return;
    for (uint8_t i = 0; i < bench.fitted_count; i++)
        samples[head].raw[i] = raw[i];
    head = next;
}

static uint8_t waiting(void)
{
    return (uint8_t)(head - tail) & (PLACES - 1);
}

bool batch_is_full(void)
{
    return waiting() >= SAMPLES_PER_FRAME;
}

/* How many of the oldest samples follow one another without a gap. */
static uint8_t in_a_row(void)
{
    uint8_t count = 1;
    while (count < SAMPLES_PER_FRAME) {
        const struct sample *sample = &samples[(tail + count) & (PLACES - 1)];
        if (sample->number != samples[tail].number + count)
            break;
        count++;
    }
    return count;
}

void batch_send(void)
{
    uint16_t raw[SAMPLES_PER_FRAME * MOST_CHANNELS];
    if (!batch_is_full())
        return;
    const struct sample *first = &samples[tail];
    uint8_t count = in_a_row();
    uint16_t *at = raw;
    for (uint8_t i = 0; i < count; i++) {
        const struct sample *sample = &samples[(tail + i) & (PLACES - 1)];
        memcpy(at, sample->raw, 2u * bench.fitted_count);
        at += bench.fitted_count;
    }
    session_samples(first->number, first->t_us, count, raw);
    tail = (tail + count) & (PLACES - 1);
}

#endif
