#include "session.h"

#include <string.h>

#ifndef BUILD_HASH
#define BUILD_HASH 0
#endif

enum {
    FIRMWARE_MAJOR = 0,
    FIRMWARE_MINOR = 2,
    FIRMWARE_PATCH = 0,
};

static struct decoder decoder;
static uint8_t flags;
static uint16_t hellos;
static uint16_t sample_frames;
static uint32_t boot_id;
static uint32_t timeout_us;
static uint32_t heard_us; /* the last sign of life */
static bool away;         /* the output was told to be another than the safe one */
static uint16_t away_s;   /* for how long, in whole seconds: a clock in us would wrap too early */
static uint32_t away_us;  /* when the last of them was full */
static uint16_t longest_output_s;

static bool send(uint8_t type, uint16_t seq, uint32_t t_us, const uint8_t *payload, uint8_t size)
{
    static uint8_t wire[LONGEST_FRAME + 1];
    const struct frame frame = {type, seq, t_us, payload, size};
    return line_send(wire, frame_encode(&frame, wire));
}

static uint8_t *put_name(uint8_t *at, const char *name)
{
    memset(at, 0, LONGEST_NAME);
    for (uint8_t i = 0; i < LONGEST_NAME && name[i]; i++)
        at[i] = (uint8_t)name[i];
    return at + LONGEST_NAME;
}

static void say_hello(uint16_t answers, uint32_t now_us)
{
    uint8_t payload[LONGEST_PAYLOAD];
    uint8_t *at = put_u16(payload, answers);
    at = put_u8(put_u8(put_u8(at, FIRMWARE_MAJOR), FIRMWARE_MINOR), FIRMWARE_PATCH);
    at = put_name(put_name(at, bench.device), bench.serial);
    at = put_u32(put_u32(at, boot_id), BUILD_HASH);
    at = put_f32(put_f32(at, bench.sample_rate), 1.0f);
    at = put_u8(at, bench.channel_count);
    for (uint8_t i = 0; i < bench.channel_count; i++)
        at = put_f32(put_f32(at, bench.channels[i].scale), bench.channels[i].zero);
    send(HELLO, hellos++, now_us, payload, (uint8_t)(at - payload));
}

static void go_safe(void)
{
    bench_set(bench.safe);
    flags |= FLAG_SAFE;
    away = false;
}

static bool set(const struct frame *frame, uint32_t now_us)
{
    if (frame->size != 2)
        return false;
    if (flags & FLAG_EXPIRED)
        return true;
    uint16_t raw = get_u16(frame->payload);
    bench_set(raw);
    flags &= (uint8_t)~FLAG_SAFE;
    if (raw == bench.safe) {
        away = false;
    } else if (!away) {
        away = true;
        away_s = 0;
        away_us = now_us;
    }
    return true;
}

/* The shorter of two limits of which 0 is none. */
static uint16_t shorter(uint16_t one, uint16_t other)
{
    if (one == 0 || other == 0)
        return one | other;
    return one < other ? one : other;
}

static bool configure(const struct frame *frame)
{
    if (frame->size != 2 && frame->size != 4)
        return false;
    uint16_t timeout_ms = get_u16(frame->payload);
    if (timeout_ms > LONGEST_COMMAND_TIMEOUT_MS)
        timeout_ms = LONGEST_COMMAND_TIMEOUT_MS;
    timeout_us = timeout_ms * 1000UL;
    longest_output_s = bench.longest_output_s;
    if (frame->size == 4)
        longest_output_s = shorter(longest_output_s, get_u16(frame->payload + 2));
    flags |= FLAG_CONFIGURED;
    return true;
}

/* True when the message was one: a broken payload is no sign of life. */
static bool obey(const struct frame *frame, uint32_t now_us)
{
    switch (frame->type) {
    case SET:
        return set(frame, now_us);
    case CONFIG:
        return configure(frame);
    case SAFE:
        go_safe();
        flags &= (uint8_t)~FLAG_EXPIRED;
        return true;
    case HELLO_REQUEST:
        say_hello(frame->seq, now_us);
        return true;
    default: /* HEARTBEAT, and what later versions may add */
        return true;
    }
}

void session_begin(uint32_t id, uint32_t now_us)
{
    memset(&decoder, 0, sizeof decoder);
    boot_id = id;
    hellos = sample_frames = 0;
    flags = 0;
    timeout_us = FIRST_COMMAND_TIMEOUT_MS * 1000UL;
    longest_output_s = bench.longest_output_s;
    heard_us = now_us;
    go_safe();
    say_hello(0, now_us);
}

void session_receive(uint8_t byte, uint32_t now_us)
{
    struct frame frame;
    if (decoder_feed(&decoder, byte, &frame) && obey(&frame, now_us))
        heard_us = now_us;
}

static bool lasted_too_long(uint32_t now_us)
{
    while (away && now_us - away_us >= 1000000UL) {
        away_us += 1000000UL;
        away_s++;
        if (longest_output_s && away_s >= longest_output_s)
            return true;
    }
    return false;
}

void session_watch(uint32_t now_us)
{
    /* once safe there is nothing to watch, so that no wrap of the clock can look like a short silence */
    if (flags & FLAG_SAFE)
        return;
    if (now_us - heard_us > timeout_us)
        go_safe();
    if (lasted_too_long(now_us)) {
        go_safe();
        flags |= FLAG_EXPIRED;
    }
}

bool session_state(uint16_t seq, uint32_t t_us, const uint16_t *raw)
{
    uint8_t payload[1 + 2 * MOST_CHANNELS];
    uint8_t *at = put_u8(payload, flags);
    for (uint8_t i = 0; i < bench.fitted_count; i++)
        at = put_u16(at, raw[i]);
    return send(STATE, seq, t_us, payload, (uint8_t)(at - payload));
}

bool session_samples(uint32_t first, uint32_t t_us, uint8_t count, const uint16_t *raw)
{
    uint8_t payload[LONGEST_PAYLOAD];
    if (count > MOST_SAMPLES(bench.fitted_count))
        return false;
    uint8_t *at = put_u32(put_u8(put_u8(payload, flags), count), first);
    for (uint8_t i = 0; i < count * bench.fitted_count; i++)
        at = put_u16(at, raw[i]);
    return send(SAMPLES, sample_frames++, t_us, payload, (uint8_t)(at - payload));
}
