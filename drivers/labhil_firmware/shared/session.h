/* What every bench does with messages: HELLO, CONFIG, signs of life, SAFE, STATE. No hardware. */
#ifndef LABHIL_SESSION_H
#define LABHIL_SESSION_H

#include "frame.h"

enum {
    LONGEST_NAME = 16,
    FIRST_COMMAND_TIMEOUT_MS = 300,    /* until CONFIG says otherwise */
    LONGEST_COMMAND_TIMEOUT_MS = 2000, /* no host can switch the watchdog off */
};

/* value (SI) = (raw - zero) * scale */
struct channel_scale {
    float scale;
    float zero;
};

/* Who a bench is: what HELLO says of it, and its limits. Defined once in each bench's main file. */
struct bench {
    const char *device;
    const char *serial;
    float sample_rate; /* Hz */
    const struct channel_scale *channels;
    uint8_t channel_count;
    uint8_t command_count;
    uint32_t longest_output_us; /* how long an output may stay without a new SET, heartbeats or not */
};

extern const struct bench bench;

/* Provided by the bench: carry out a SET of `command_count` numbers; take the safe output at once. */
void bench_set(const uint16_t *raw);
void bench_go_safe(void);

/* Provided by the serial line: send all bytes or none; false when there is no room. */
bool line_send(const uint8_t *bytes, uint8_t size);

/* Begin: safe, nothing configured; say HELLO. */
void session_begin(uint32_t boot_id, uint32_t now_us);

/* Take a byte from the host and do what it completes. */
void session_receive(uint8_t byte, uint32_t now_us);

/* Go safe when the host has been silent for too long, or nothing new was set for too long. */
void session_watch(uint32_t now_us);

/* Send a sample of `channel_count` numbers taken at `t_us`; false when the line has no room. */
bool session_sample(uint16_t seq, uint32_t t_us, const uint16_t *raw);

#endif
