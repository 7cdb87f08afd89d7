#include "frame.h"

#include <string.h>

uint16_t frame_crc(const uint8_t *bytes, uint8_t size)
{
    uint16_t crc = 0xFFFF;
    while (size--) {
        /* a byte at a time without a table: the quotient of the byte folds into these three shifts */
        uint8_t x = (uint8_t)(crc >> 8) ^ *bytes++;
        x ^= x >> 4;
        crc = (uint16_t)(crc << 8) ^ (uint16_t)((uint16_t)x << 12) ^ (uint16_t)((uint16_t)x << 5) ^ x;
    }
    return crc;
}

/* Stuff `size` (at most 253) bytes; returns the length with the delimiter. */
static uint8_t stuff(const uint8_t *body, uint8_t size, uint8_t *wire)
{
    uint8_t *code = wire, *out = wire + 1;
    for (uint8_t i = 0; i < size; i++) {
        if (body[i] == 0) {
            *code = (uint8_t)(out - code);
            code = out++;
        } else {
            *out++ = body[i];
        }
    }
    *code = (uint8_t)(out - code);
    *out++ = 0;
    return (uint8_t)(out - wire);
}

/* Undo the stuffing in place; returns the length of the body, 0 when these bytes are none. */
static uint8_t unstuff(uint8_t *bytes, uint8_t size)
{
    uint8_t in = 0, out = 0;
    while (in < size) {
        uint8_t code = bytes[in++];
        if (code == 0 || code - 1 > size - in)
            return 0;
        while (--code)
            bytes[out++] = bytes[in++];
        if (in < size)
            bytes[out++] = 0;
    }
    return out;
}

uint8_t frame_encode(const struct frame *frame, uint8_t wire[LONGEST_FRAME + 1])
{
    uint8_t body[LONGEST_FRAME];
    if (frame->size > LONGEST_PAYLOAD)
        return 0;
    uint8_t *at = put_u8(body, PROTOCOL_VERSION);
    at = put_u8(at, frame->type);
    at = put_u16(at, frame->seq);
    at = put_u32(at, frame->t_us);
    if (frame->size)
        memcpy(at, frame->payload, frame->size);
    at += frame->size;
    at = put_u16(at, frame_crc(body, (uint8_t)(at - body)));
    return stuff(body, (uint8_t)(at - body), wire);
}

static bool is_intact(const uint8_t *body, uint8_t size)
{
    return size >= HEADER_SIZE + CRC_SIZE
        && frame_crc(body, size - CRC_SIZE) == get_u16(body + size - CRC_SIZE);
}

/* What stood between two delimiters, stuffing undone: is it a frame for us? */
static bool parse(struct decoder *decoder, uint8_t size, struct frame *frame)
{
    const uint8_t *body = decoder->pending;
    if (body[0] != PROTOCOL_VERSION) {
        decoder->other_versions++;
        decoder->last_other_version = body[0];
        return false;
    }
    frame->type = body[1];
    frame->seq = get_u16(body + 2);
    frame->t_us = get_u32(body + 4);
    frame->payload = body + HEADER_SIZE;
    frame->size = size - HEADER_SIZE - CRC_SIZE;
    return true;
}

static bool complete(struct decoder *decoder, struct frame *frame)
{
    uint8_t encoded = decoder->size;
    bool overlong = decoder->overlong, joined = decoder->joined;
    decoder->size = 0;
    decoder->overlong = false;
    decoder->joined = true;
    if (encoded == 0 && !overlong)
        return false;

    uint8_t size = overlong ? 0 : unstuff(decoder->pending, encoded);
    bool intact = is_intact(decoder->pending, size);
    if (intact && parse(decoder, size, frame)) {
        decoder->frames++;
        decoder->resyncs += decoder->astray;
        decoder->astray = false;
        return true;
    }
    if (joined) {
        decoder->crc_errors += !intact;
        decoder->astray = true;
    }
    return false;
}

bool decoder_feed(struct decoder *decoder, uint8_t byte, struct frame *frame)
{
    if (byte == 0)
        return complete(decoder, frame);
    if (decoder->size == LONGEST_FRAME) {
        decoder->overlong = true;
        decoder->size = 0;
    }
    decoder->pending[decoder->size++] = byte;
    return false;
}
