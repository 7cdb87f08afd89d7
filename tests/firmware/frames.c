/* The firmware's frame code on the host, for a test to compare with labhil/link.py.
 *
 *     frames decode < bytes         a line "type seq t_us payload" per frame, then the counters
 *     frames encode < such lines    the bytes of each in hex, a line per frame
 */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "frame.h"

static void print_hex(const uint8_t *bytes, unsigned size)
{
    for (unsigned i = 0; i < size; i++)
        printf("%02x", bytes[i]);
    printf("\n");
}

static void decode(void)
{
    /* on the heap, where a sanitizer sees every byte beyond its end */
    struct decoder *decoder = calloc(1, sizeof *decoder);
    struct frame frame;
    int byte;
    while ((byte = getchar()) != EOF) {
        if (decoder_feed(decoder, (uint8_t)byte, &frame)) {
            printf("%u %u %" PRIu32 " ", frame.type, frame.seq, frame.t_us);
            print_hex(frame.payload, frame.size);
        }
    }
    printf("frames %u crc_errors %u resyncs %u other_versions %u last_other_version %u\n", decoder->frames,
           decoder->crc_errors, decoder->resyncs, decoder->other_versions, decoder->last_other_version);
    free(decoder);
}

static void encode(void)
{
    char line[1024], hex[600];
    while (fgets(line, sizeof line, stdin)) {
        unsigned type, seq;
        uint32_t t_us;
        hex[0] = 0;
        if (sscanf(line, "%u %u %" SCNu32 " %599s", &type, &seq, &t_us, hex) < 3)
            exit(2);
        unsigned size = (unsigned)strlen(hex) / 2;
        uint8_t *payload = malloc(size + 1), *wire = malloc(LONGEST_FRAME + 1);
        for (unsigned i = 0; i < size; i++)
            sscanf(hex + 2 * i, "%2hhx", &payload[i]);
        struct frame frame = {(uint8_t)type, (uint16_t)seq, t_us, payload, (uint8_t)size};
        print_hex(wire, frame_encode(&frame, wire));
        free(payload);
        free(wire);
    }
}

int main(int argc, char **argv)
{
    if (argc == 2 && strcmp(argv[1], "decode") == 0)
        decode();
    else if (argc == 2 && strcmp(argv[1], "encode") == 0)
        encode();
    else
        return 2;
    return 0;
}
