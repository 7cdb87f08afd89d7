/* Firmware on a simulated board with a plant around it, on a pseudo terminal, in real time.
 *
 *     harness FIRMWARE.elf PLANT
 *
 * The first line of the output is the address to connect to. Opening it resets the board, as an
 * Arduino's USB port does. One command per line of the input, each answered by one line:
 *
 *     report           what was measured, as JSON
 *     forget           start the worst cases anew
 *     reset            press the reset button
 *     hang ADDRESS     let the code at this byte of the flash run in circles until the next reset; answers
 *                      with the cycle from which it does
 *     deafen           switch the converter off, as its own program never would
 *     peek ADDRESS N   N bytes of memory, in hex
 *
 * It ends with its input.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "board.h"

enum {
    TURN = 8000,        /* cycles between two looks at the world: 0.5 ms */
    BOOTLOADER = 50,    /* ms after a reset by opening, in which the bootloader takes the bytes */
    PATIENCE = 50,      /* ms behind real time that are caught up; after more the world has paused */
};

static const struct plant *plant;
static int terminal;
static uint8_t outgoing[4096], incoming[4096];
static size_t outgoing_size, incoming_size;
static double worst_lag, paused; /* s */

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return time.tv_sec + 1e-9 * time.tv_nsec;
}

static void send_byte(uint8_t byte)
{
    if (outgoing_size < sizeof outgoing)
        outgoing[outgoing_size++] = byte;
}

static void open_terminal(void)
{
    char name[128];
    int device;
    struct termios raw;
    if (openpty(&terminal, &device, name, NULL, NULL) != 0) {
        perror("openpty");
        exit(1);
    }
    tcgetattr(device, &raw);
    cfmakeraw(&raw);
    tcsetattr(device, TCSANOW, &raw);
    /* with our own end closed, the kernel tells whether anybody else has it open */
    close(device);
    fcntl(terminal, F_SETFL, O_NONBLOCK);
    printf("%s\n", name);
    fflush(stdout);
}

static bool somebody_is_there(void)
{
    struct pollfd end = {terminal, 0, 0};
    poll(&end, 1, 0);
    return !(end.revents & POLLHUP);
}

/* Carry bytes both ways; without a client they fall on the floor. */
static void exchange(void)
{
    static bool was_there;
    static double deaf_until;
    bool there = somebody_is_there();
    if (there && !was_there) {
        board_reset();
        deaf_until = now() + 1e-3 * BOOTLOADER;
        outgoing_size = incoming_size = 0;
    }
    was_there = there;
    ssize_t size = read(terminal, incoming + incoming_size, sizeof incoming - incoming_size);
    if (size > 0)
        incoming_size += (size_t)size;
    if (now() < deaf_until)
        incoming_size = 0;
    size_t taken = board_receive(incoming, incoming_size);
    memmove(incoming, incoming + taken, incoming_size -= taken);
    size = there ? write(terminal, outgoing, outgoing_size) : (ssize_t)outgoing_size;
    if (size > 0)
        memmove(outgoing, outgoing + size, outgoing_size -= (size_t)size);
}

static void report(void)
{
    const struct pins *pins = board_pins();
    printf("{\"cycle\": %llu, \"worst_turn\": %llu, \"worst_interrupt\": %llu, \"last_byte\": %llu,"
           " \"safe_since\": %llu, \"watchdog_resets\": %u, \"resets\": %u, \"bytes_in\": %llu,"
           " \"bytes_out\": %llu, \"pulse_us\": %.4f, \"duty\": [%.6f, %.6f], \"worst_lag\": %.6f,"
           " \"paused\": %.6f, \"value\": %.6f, \"pulses_us\": [",
           (unsigned long long)board_cycle(), (unsigned long long)measured.worst_turn,
           (unsigned long long)measured.worst_interrupt, (unsigned long long)measured.last_byte,
           (unsigned long long)measured.safe_since, measured.watchdog_resets, measured.resets,
           (unsigned long long)measured.bytes_in, (unsigned long long)measured.bytes_out, pins->pulse_us,
           pins->duty[0], pins->duty[1], worst_lag, paused, plant->value());
    for (unsigned i = 0; i < PULSES; i++)
        printf("%s%.1f", i ? ", " : "", measured.pulses_us[(measured.pulses + i) % PULSES]);
    printf("]}\n");
}

static void peek(unsigned address, unsigned count)
{
    for (unsigned i = 0; i < count; i++)
        printf("%02x", board_peek((uint16_t)(address + i)));
    printf("\n");
}

static void obey(const char *line)
{
    unsigned address, count;
    if (strcmp(line, "report") == 0) {
        report();
    } else if (sscanf(line, "peek %u %u", &address, &count) == 2) {
        peek(address, count);
    } else if (strcmp(line, "reset") == 0) {
        board_reset();
        printf("reset\n");
    } else if (strcmp(line, "forget") == 0) {
        measured.worst_turn = measured.worst_interrupt = 0;
        worst_lag = paused = 0.0;
        printf("forgotten\n");
    } else if (strcmp(line, "deafen") == 0) {
        board_stop_converter();
        printf("deafened\n");
    } else if (sscanf(line, "hang %u", &address) == 1) {
        board_hang(address);
        printf("%llu\n", (unsigned long long)board_cycle());
    } else {
        printf("unknown: %s\n", line);
    }
    fflush(stdout);
}

/* Read commands; false at the end of the input. */
static bool listen(void)
{
    static char line[256];
    static size_t size;
    struct pollfd input = {STDIN_FILENO, POLLIN, 0};
    while (poll(&input, 1, 0) > 0) {
        if (size + 1 >= sizeof line || read(STDIN_FILENO, line + size, 1) <= 0)
            return false;
        if (line[size] != '\n') {
            size++;
            continue;
        }
        line[size] = 0;
        size = 0;
        obey(line);
    }
    return true;
}

/* Wait until real time has come to where the board is. */
static void pace(double *epoch)
{
    double ahead = board_cycle() / BOARD_HZ - (now() - *epoch);
    if (-ahead > worst_lag)
        worst_lag = -ahead;
    if (-ahead > 1e-3 * PATIENCE) {
        paused -= ahead;
        *epoch -= ahead;
    }
    if (ahead > 0.0) {
        struct timespec pause = {0, (long)(1e9 * ahead)};
        nanosleep(&pause, NULL);
    }
}

int main(int argc, char **argv)
{
    plant = argc == 3 ? plant_named(argv[2]) : NULL;
    if (plant == NULL) {
        fprintf(stderr, "usage: harness FIRMWARE.elf ball_beam|solenoid|dc_motor\n");
        return 2;
    }
    board_begin(argv[1], plant, send_byte);
    open_terminal();
    double epoch = now();
    while (listen()) {
        board_run_until(board_cycle() + TURN);
        exchange();
        pace(&epoch);
    }
    return 0;
}
