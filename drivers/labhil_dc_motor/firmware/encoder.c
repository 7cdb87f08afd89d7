#include "encoder.h"

#include <avr/interrupt.h>
#include <avr/io.h>
#include <math.h>

#include "bench.h"
#include "clock.h"

/* Speed is edges by time over the last whole cycles of the encoder (4 edges each, so that unequal
 * distances within a cycle do not matter): as many as fit into about 2 ms. */
enum {
    PLACES = 32,
    CYCLE = 4,
    WINDOW = 4000, /* ticks of 0.5 us */
    REST = 100000, /* so long without an edge is no speed */
};

/* raw speed = this / ticks per edge */
#define SPEED_TICKS ((uint32_t)(2.0f * (float)M_PI / ENCODER_COUNTS * 2e6f / ENCODER_SPEED_SCALE + 0.5f))

static uint16_t count;
static uint32_t times[PLACES]; /* of the last edges in one direction */
static uint8_t newest;
static uint8_t known; /* how many of them there are */
static int8_t direction;
static uint8_t levels;

void encoder_begin(void)
{
    DDRE &= (uint8_t) ~(_BV(PE4) | _BV(PE5));
    PORTE |= _BV(PE4) | _BV(PE5); /* pulled up, for open collectors */
    levels = (PINE >> PE4) & 3;
    EICRB = _BV(ISC40) | _BV(ISC50); /* any edge */
    EIMSK = _BV(INT4) | _BV(INT5);
}

/* From the old levels (bits 2, 3) and the new ones (bits 0, 1): which way; 0 is none, or two at once. */
static const int8_t ways[16] = {0, 1, -1, 0, -1, 0, 0, 1, 1, 0, 0, -1, 0, -1, 1, 0};

ISR(INT4_vect)
{
    uint8_t now = (PINE >> PE4) & 3;
    int8_t way = ways[levels << 2 | now];
    levels = now;
    if (way == 0)
        return;
    count += (uint16_t)(int16_t)way;
    if (way != direction) {
        direction = way;
        known = 0;
    }
    newest = (newest + 1) & (PLACES - 1);
    times[newest] = clock_ticks_in_interrupt();
    if (known < PLACES)
        known++;
}

ISR_ALIAS(INT5_vect, INT4_vect);

uint16_t encoder_count(void)
{
    return count;
}

static uint32_t ticks_of(uint8_t edges)
{
    return times[newest] - times[(newest - edges) & (PLACES - 1)];
}

struct edges encoder_last_edges(void)
{
    struct edges last = {0, direction < 0, 0};
    uint32_t since = clock_ticks_in_interrupt() - times[newest];
    if (known < 2 || since > REST)
        return last;
    last.count = known > CYCLE ? CYCLE : known - 1;
    while (last.count >= CYCLE && 2 * last.count < known && ticks_of(2 * last.count) <= WINDOW)
        last.count *= 2;
    last.ticks = ticks_of(last.count);
    /* an edge that is long overdue bounds the speed from above */
    if (since * last.count > 2 * last.ticks)
        last.ticks = since * last.count;
    return last;
}

uint16_t encoder_speed(struct edges edges)
{
    if (edges.count == 0 || edges.ticks == 0)
        return (uint16_t)ENCODER_SPEED_ZERO;
    uint32_t speed = SPEED_TICKS * edges.count / edges.ticks;
    uint16_t magnitude = speed > 32767 ? 32767 : (uint16_t)speed;
    return edges.backward ? 32768U - magnitude : 32768U + magnitude;
}
