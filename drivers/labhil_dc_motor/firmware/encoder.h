/* The encoder: two channels on digital pins 2 and 3 (INT4, INT5), every edge an interrupt. */
#ifndef LABHIL_ENCODER_H
#define LABHIL_ENCODER_H

#include <stdbool.h>
#include <stdint.h>

#define ENCODER_SPEED_SCALE 0.02f /* rad/s */
#define ENCODER_SPEED_ZERO 32768.0f

void encoder_begin(void);

/* For interrupt handlers: edges counted since boot, modulo 65536; grows with a positive angle. */
uint16_t encoder_count(void);

/* What the speed is worked out from. */
struct edges {
    uint8_t count;  /* 0: at rest */
    bool backward;
    uint32_t ticks; /* of 0.5 us, that they took */
};

/* For interrupt handlers, quick: the last edges as of now. */
struct edges encoder_last_edges(void);

/* The speed, in ENCODER_SPEED_SCALE; a division of 40 us that may be interrupted. */
uint16_t encoder_speed(struct edges edges);

#endif
