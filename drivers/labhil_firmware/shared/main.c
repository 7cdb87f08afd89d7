/* The main loop of every bench. Nothing in it waits; the watchdog timer sees to that. */
#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "boot.h"
#include "clock.h"
#include "line.h"
#include "loop.h"
#include "session.h"

enum { BYTES_PER_TURN = 64 };

static volatile bool has_sampled;

void loop_note_sample(void)
{
    has_sampled = true;
}

/* After a reset by the watchdog it is still running, at its shortest: stop it before memory is set up. */
static void stop_watchdog(void) __attribute__((naked, used, section(".init3")));
static void stop_watchdog(void)
{
    MCUSR = 0;
    wdt_disable();
}

static void turn(void)
{
    uint8_t byte;
    for (uint8_t i = 0; i < BYTES_PER_TURN && line_receive(&byte); i++)
        session_receive(byte, clock_us());
    session_watch(clock_us());
    bench_report();
}

static void sleep_until_interrupt(void)
{
    cli();
    if (line_has_bytes() || bench_has_report()) {
        sei();
        return;
    }
    sleep_enable();
    sei(); /* takes effect after the next instruction, so no interrupt slips in between */
    sleep_cpu();
    sleep_disable();
}

int main(void)
{
    uint32_t boot_id = boot_count(); /* the pins are still as the reset left them: nothing is driven */
    line_begin();
    clock_begin();
    bench_begin();
    set_sleep_mode(SLEEP_MODE_IDLE);
    sei();
    session_begin(boot_id, clock_us());
    wdt_enable(WDTO_60MS);
    for (;;) {
        /* a register that nothing else uses, for the simulator to see how long a turn takes */
        GPIOR0 = 1;
        if (has_sampled) {
            has_sampled = false;
            wdt_reset();
        }
        turn();
        GPIOR0 = 0;
        sleep_until_interrupt();
    }
}
