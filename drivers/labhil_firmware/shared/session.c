#include "session.h"

#include <string.h>

#ifndef BUILD_HASH
#define BUILD_HASH 0
#endif

enum {
    FIRMWARE_MAJOR = 0,
    FIRMWARE_MINOR = 2,
    FIRMWARE_PATCH = 0,
    MOST_COMMANDS = 4,
};

static struct decoder decoder;
static uint8_t flags;
static uint16_t hellos;
static uint32_t boot_id;
static uint32_t timeout_us;
static uint32_t heard_us; /* the last sign of life */
static uint32_t set_us;   /* the last SET */

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
    bench_go_safe();
    flags |= FLAG_SAFE;
}

static bool set(const struct frame *frame, uint32_t now_us)
{
    uint16_t raw[MOST_COMMANDS];
    if (frame->size != 2 * bench.command_count)
        return false;
    for (uint8_t i = 0; i < bench.command_count; i++)
        raw[i] = get_u16(frame->payload + 2 * i);
    bench_set(raw);
    flags &= (uint8_t)~FLAG_SAFE;
    set_us = now_us;
    return true;
}

static bool configure(const struct frame *frame)
{
    if (frame->size != 2)
        return false;
    uint16_t timeout_ms = get_u16(frame->payload);
    if (timeout_ms > LONGEST_COMMAND_TIMEOUT_MS)
        timeout_ms = LONGEST_COMMAND_TIMEOUT_MS;
    timeout_us = timeout_ms * 1000UL;
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
    hellos = 0;
    flags = 0;
    timeout_us = FIRST_COMMAND_TIMEOUT_MS * 1000UL;
    heard_us = set_us = now_us;
    go_safe();
    say_hello(0, now_us);
}

void session_receive(uint8_t byte, uint32_t now_us)
{
    struct frame frame;
    if (decoder_feed(&decoder, byte, &frame) && obey(&frame, now_us))
        heard_us = now_us;
}

void session_watch(uint32_t now_us)
{
    /* once safe there is nothing to watch, so that no wrap of the clock can look like a short silence */
    if (flags & FLAG_SAFE)
        return;
    if (now_us - heard_us > timeout_us || now_us - set_us > bench.longest_output_us)
        go_safe();
}

bool session_sample(uint16_t seq, uint32_t t_us, const uint16_t *raw)
{
    uint8_t payload[LONGEST_PAYLOAD];
    uint8_t *at = put_u8(payload, flags);
    for (uint8_t i = 0; i < bench.channel_count; i++)
        at = put_u16(at, raw[i]);
    return send(STATE, seq, t_us, payload, (uint8_t)(at - payload));
}
