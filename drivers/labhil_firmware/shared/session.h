/* What every bench does with messages: HELLO, CONFIG, signs of life, SAFE, STATE. No hardware. */
#ifndef LABHIL_SESSION_H
#define LABHIL_SESSION_H

#include "frame.h"

enum {
    MOST_CHANNELS = 5,
    LONGEST_NAME = 16,
    FIRST_COMMAND_TIMEOUT_MS = 300,    /* until CONFIG says otherwise */
    LONGEST_COMMAND_TIMEOUT_MS = 2000, /* no host can switch the watchdog off */
};

/* How many samples of so many channels fit into a frame. */
#define MOST_SAMPLES(channels) ((LONGEST_PAYLOAD - 6) / (2 * (channels)))

/* value (SI) = (raw - zero) * scale; a scale of 0 is a channel that is not fitted. */
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
    uint8_t fitted_count;      /* how many of them have a scale: the width of a sample */
    uint16_t safe;             /* the command that is safe; every bench has one command */
    uint16_t longest_output_s; /* how long the output may be another than that without a break; 0: ever */
};

extern const struct bench bench;

/* Provided by the bench: take over a command, `bench.safe` among them, at the next sample. Values beyond
 * the bench's range count as its end. */
void bench_set(uint16_t raw);

/* Provided by the serial line: send all bytes or none; false when there is no room. */
bool line_send(const uint8_t *bytes, uint8_t size);

/* Begin: safe, nothing configured; say HELLO. */
void session_begin(uint32_t boot_id, uint32_t now_us);

/* Take a byte from the host and do what it completes. */
void session_receive(uint8_t byte, uint32_t now_us);

/* Go safe when the host has been silent for too long, or the output has lasted too long. */
void session_watch(uint32_t now_us);

/* Send STATE: one sample, taken at `t_us`, numbered by `seq`. False when the line has no room. */
bool session_state(uint16_t seq, uint32_t t_us, const uint16_t *raw);

/* Send SAMPLES: `count` samples in a row, of which the first has the number `first` and was taken at
 * `t_us`. False when the line has no room, or the frame would be too long. */
bool session_samples(uint32_t first, uint32_t t_us, uint8_t count, const uint16_t *raw);

#endif
