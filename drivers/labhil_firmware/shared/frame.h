/* Frames on the wire: COBS(version | type | seq | t_us | payload | crc) 0x00, as in docs/reference/serial-protocol.md.
 *
 * Plain C11 without any hardware, so that a test on the host holds it to the same golden vectors as
 * labhil/link.py.
 */
#ifndef LABHIL_FRAME_H
#define LABHIL_FRAME_H

#include <stdbool.h>
#include <stdint.h>

enum {
    PROTOCOL_VERSION = 1,
    HEADER_SIZE = 8,
    CRC_SIZE = 2,
    LONGEST_FRAME = 254, /* bytes between two delimiters; COBS adds one to the body */
    LONGEST_PAYLOAD = LONGEST_FRAME - 1 - HEADER_SIZE - CRC_SIZE,
};

enum message_type {
    HELLO = 1,
    STATE = 2,
    SET = 3,
    HEARTBEAT = 4,
    SAFE = 5,
    HELLO_REQUEST = 6,
    CONFIG = 7,
    SAMPLES = 8,
};

enum state_flag {
    FLAG_CONFIGURED = 1,
    FLAG_SAFE = 2,
    FLAG_EXPIRED = 4,
};

/* One message. After decoding, `payload` points into the decoder and holds until its next byte. */
struct frame {
    uint8_t type;
    uint16_t seq;
    uint32_t t_us;
    const uint8_t *payload;
    uint8_t size;
};

/* Write the frame, delimiter included, and return its length; 0 when the payload is too long. */
uint8_t frame_encode(const struct frame *frame, uint8_t wire[LONGEST_FRAME + 1]);

/* Takes bytes as they come. All zeros is a decoder that has heard nothing. The counters wrap.
 * `pending` stands last, and no padding after it, so that a sanitizer sees a byte beyond its end. */
struct decoder {
    uint16_t frames;
    uint16_t crc_errors; /* pieces between two delimiters that were no frame */
    uint16_t resyncs;    /* how often a good frame followed upon bytes that were thrown away */
    uint16_t other_versions;
    uint16_t last_other_version;
    bool overlong; /* more than a frame can have came without a delimiter */
    bool joined;   /* a delimiter has been seen: what came before it was no loss */
    bool astray;   /* bytes had to be thrown away since the last good frame */
    uint8_t size;
    uint8_t pending[LONGEST_FRAME];
};

/* Take one byte; true when it completes a frame of our version, which then stands in `frame`. */
bool decoder_feed(struct decoder *decoder, uint8_t byte, struct frame *frame);

/* CRC-16/CCITT-FALSE of `size` bytes: polynomial 0x1021, start 0xFFFF. */
uint16_t frame_crc(const uint8_t *bytes, uint8_t size);

/* Little-endian numbers in a buffer. put_* return where the next one goes. */
static inline uint8_t *put_u8(uint8_t *at, uint8_t value)
{
    *at++ = value;
    return at;
}

static inline uint8_t *put_u16(uint8_t *at, uint16_t value)
{
    return put_u8(put_u8(at, (uint8_t)value), (uint8_t)(value >> 8));
}

static inline uint8_t *put_u32(uint8_t *at, uint32_t value)
{
    return put_u16(put_u16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

static inline uint8_t *put_f32(uint8_t *at, float value)
{
    union {
        float real;
        uint32_t bits;
    } number = {.real = value}; /* IEEE 754 single on the AVR as well */
    return put_u32(at, number.bits);
}

static inline uint16_t get_u16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (uint16_t)at[1] << 8);
}

static inline uint32_t get_u32(const uint8_t *at)
{
    return get_u16(at) | (uint32_t)get_u16(at + 2) << 16;
}

#endif
