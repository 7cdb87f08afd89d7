/* The firmware's side of the talk on the host, with a clock that the test turns.
 *
 * Each line of the input is "T hear HEX" (bytes come at T microseconds), "T watch" (the main loop comes
 * by) or "T sample" (STATE is sent). The answer to each: the command in effect, then the bytes sent.
 */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "session.h"

static const struct channel_scale channels[] = {{0.5f, 512.0f}, {0.001f, 15000.0f}};

const struct bench bench = {
    .device = "ball_beam",
    .serial = "0123456789abcdefgh",
    .sample_rate = 100,
    .channels = channels,
    .channel_count = 2,
    .fitted_count = 2,
    .safe = 15000,
    .longest_output_s = 10,
};

static uint16_t command;
static uint8_t sent[1024];
static unsigned sent_size;

void bench_set(uint16_t raw)
{
    command = raw;
}

bool line_send(const uint8_t *bytes, uint8_t size)
{
    memcpy(sent + sent_size, bytes, size);
    sent_size += size;
    return true;
}

static void hear(const char *hex, uint32_t now)
{
    unsigned byte;
    for (; sscanf(hex, "%2x", &byte) == 1; hex += 2)
        session_receive((uint8_t)byte, now);
}

int main(void)
{
    char line[4096], verb[16], hex[4000];
    uint32_t now;
    uint16_t number = 0;
    session_begin(7, 0);
    while (fgets(line, sizeof line, stdin)) {
        hex[0] = 0;
        if (sscanf(line, "%" SCNu32 " %15s %3999s", &now, verb, hex) < 2)
            return 2;
        if (strcmp(verb, "hear") == 0)
            hear(hex, now);
        else if (strcmp(verb, "watch") == 0)
            session_watch(now);
        else if (strcmp(verb, "sample") == 0)
            session_state(number++, now, (const uint16_t[]){512, command});
        else
            return 2;
        printf("%u ", command);
        for (unsigned i = 0; i < sent_size; i++)
            printf("%02x", sent[i]);
        printf("\n");
        sent_size = 0;
    }
    return 0;
}
