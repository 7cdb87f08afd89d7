/* An Arduino Mega in simavr: its pins on a plant, its serial line as bytes, its resets. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "plants.h"

#define BOARD_HZ 16000000.0

enum { PULSES = 64 };

struct measured {
    double pulses_us[PULSES]; /* the last of the servo's pulses, in a ring */
    unsigned pulses;
    uint64_t worst_turn;      /* of the main loop, cycles, interrupts included */
    uint64_t worst_interrupt; /* cycles in one handler */
    uint64_t last_byte;       /* cycle at which the host's last byte was handed over */
    uint64_t safe_since;      /* cycle since which the outputs are safe; 0 while they are not */
    unsigned watchdog_resets, resets;
    uint64_t bytes_in, bytes_out;
};

extern struct measured measured;

/* Load the firmware; exits with a message when it cannot be. `sent` is told every byte it sends. */
void board_begin(const char *elf, const struct plant *plant, void (*sent)(uint8_t byte));

/* Run until this cycle. */
void board_run_until(uint64_t cycle);
uint64_t board_cycle(void);

/* The reset button. */
void board_reset(void);

/* Make it hang: the code at this address runs in circles until the next reset. */
void board_hang(uint32_t address);

/* Switch the converter's interrupt off behind the program's back. */
void board_stop_converter(void);

/* Give bytes to its serial line; returns how many it took. */
size_t board_receive(const uint8_t *bytes, size_t size);

/* A byte of its memory. */
uint8_t board_peek(uint16_t address);

const struct pins *board_pins(void);

#endif
