#include "board.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_timer.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

/* data addresses of the ATmega2560 */
enum {
    DDRB_ADDRESS = 0x24,
    GPIOR0_ADDRESS = 0x3E,
    TCCR1A_ADDRESS = 0x80,
    ADCSRA_ADDRESS = 0x7A,
    ICR1_ADDRESS = 0x86,
    OCR1A_ADDRESS = 0x88,
    OCR1B_ADDRESS = 0x8A,
    SERVO_PIN = 5, /* of port B, OC1A */
    ENCODER_PIN = 4, /* of port E, and the next */
    JUMP_TO_ITSELF = 0xCFFF,
};

struct measured measured;

static avr_t *avr;
static avr_run_t run;
static const struct plant *plant;
static struct pins pins;
static struct sensors sensors;
static bool line_full;
static void (*tell_sent)(uint8_t byte);
static uint64_t pulse_began, turn_began, interrupt_began;
static uint32_t hung_at;
static uint8_t hung_code[2];

static uint16_t word_at(uint16_t address)
{
    return (uint16_t)(avr->data[address] | avr->data[address + 1] << 8);
}

/* What output A or B of Timer 1 gives its pin: nothing unless it is connected and the pin an output. */
static double duty_of(int output)
{
    bool connected = avr->data[TCCR1A_ADDRESS] & (output ? 0x20 : 0x80);
    bool driven = avr->data[DDRB_ADDRESS] & (1 << (SERVO_PIN + output));
    if (!connected || !driven)
        return 0.0;
    return (word_at(output ? OCR1B_ADDRESS : OCR1A_ADDRESS) + 1.0) / (word_at(ICR1_ADDRESS) + 1.0);
}

static void note_safety(void)
{
    if (!plant->is_safe(&pins))
        measured.safe_since = 0;
    else if (measured.safe_since == 0)
        measured.safe_since = avr->cycle;
}

static void turn_encoder(void)
{
    static bool shown[2];
    for (int i = 0; i < 2; i++) {
        if (shown[i] != sensors.encoder[i])
            avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('E'), ENCODER_PIN + i),
                          sensors.encoder[i]);
        shown[i] = sensors.encoder[i];
    }
}

static avr_cycle_count_t step_plant(avr_t *unused, avr_cycle_count_t when, void *param)
{
    (void)unused;
    (void)param;
    pins.duty[0] = duty_of(0);
    pins.duty[1] = duty_of(1);
    plant->step(&pins, &sensors, plant->period);
    turn_encoder();
    note_safety();
    return when + (avr_cycle_count_t)(plant->period * BOARD_HZ);
}

static void see_pulse(struct avr_irq_t *irq, uint32_t level, void *param)
{
    (void)irq;
    (void)param;
    if (level && !pulse_began)
        pulse_began = avr->cycle;
    if (!level && pulse_began) {
        pins.pulse_us = (avr->cycle - pulse_began) / (BOARD_HZ * 1e-6);
        pulse_began = 0;
        measured.pulses_us[measured.pulses++ % PULSES] = pins.pulse_us;
    }
}

/* A conversion begins: show it what the sensors show. simavr takes 1023 for the reference voltage, the
 * converter 1024. */
static void convert(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    (void)value;
    (void)param;
    for (int pin = 0; pin < 8; pin++) {
        double count = floor(fmin(fmax(sensors.volts[pin] / 5.0 * 1024.0, 0.0), 1023.0));
        avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0 + pin),
                      (uint32_t)ceil(count * 5000.0 / 1023.0));
    }
}

static void see_sent(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    (void)param;
    measured.bytes_out++;
    tell_sent((uint8_t)value);
}

static void see_full(struct avr_irq_t *irq, uint32_t value, void *param)
{
    (void)irq;
    (void)param;
    line_full = value;
}

static void note_worst(uint64_t *worst, uint64_t began)
{
    if (avr->cycle - began > *worst)
        *worst = avr->cycle - began;
}

static void see_turn(avr_t *unused, avr_io_addr_t address, uint8_t value, void *param)
{
    (void)unused;
    (void)param;
    avr->data[address] = value;
    if (value)
        turn_began = avr->cycle;
    else
        note_worst(&measured.worst_turn, turn_began);
}

static void see_interrupt(struct avr_irq_t *irq, uint32_t vector, void *param)
{
    (void)irq;
    (void)param;
    if (vector)
        interrupt_began = avr->cycle;
    else
        note_worst(&measured.worst_interrupt, interrupt_began);
}

/* simavr forgets its timers in a reset, ours among them. */
static void after_reset(void)
{
    if (hung_at)
        memcpy(avr->flash + hung_at, hung_code, sizeof hung_code);
    hung_at = 0;
    pulse_began = 0;
    line_full = false;
    avr_cycle_timer_register(avr, (avr_cycle_count_t)(plant->period * BOARD_HZ), step_plant, NULL);
}

/* Only what went wrong, and not where the address of the terminal is expected. */
static void complain(avr_t *unused, const int level, const char *format, va_list list)
{
    (void)unused;
    if (level <= LOG_ERROR && level != LOG_OUTPUT)
        vfprintf(stderr, format, list);
}

void board_begin(const char *elf, const struct plant *chosen, void (*sent)(uint8_t byte))
{
    elf_firmware_t firmware;
    avr_global_logger_set(complain);
    memset(&firmware, 0, sizeof firmware);
    if (elf_read_firmware(elf, &firmware) != 0) {
        fprintf(stderr, "%s: expected firmware for an AVR\n", elf);
        exit(2);
    }
    plant = chosen;
    tell_sent = sent;
    avr = avr_make_mcu_by_name("atmega2560");
    avr_init(avr);
    firmware.frequency = (uint32_t)BOARD_HZ;
    avr_load_firmware(avr, &firmware);
    avr->frequency = (uint32_t)BOARD_HZ;
    avr->vcc = avr->avcc = avr->aref = 5000;
    avr->log = LOG_ERROR;
    run = avr->run;

    uint32_t quiet = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &quiet);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), see_sent, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), see_full, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), convert, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('B'), SERVO_PIN), see_pulse, NULL);
    avr_irq_register_notify(avr_get_interrupt_irq(avr, AVR_INT_ANY) + AVR_INT_IRQ_RUNNING, see_interrupt, NULL);
    avr_register_io_write(avr, GPIOR0_ADDRESS, see_turn, NULL);
    plant->start(&sensors);
    after_reset();
}

/* simavr sleeps by itself where the program does; we pace it from outside. */
static void do_not_sleep(avr_t *unused, avr_cycle_count_t how_long)
{
    (void)unused;
    (void)how_long;
}

void board_run_until(uint64_t cycle)
{
    avr->sleep = do_not_sleep;
    while (avr->cycle < cycle) {
        bool bites = avr->run != run; /* the watchdog resets by taking over one turn */
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) {
            fprintf(stderr, "the firmware has crashed\n");
            exit(1);
        }
        if (bites) {
            measured.watchdog_resets++;
            after_reset();
        }
    }
}

uint64_t board_cycle(void)
{
    return avr->cycle;
}

void board_reset(void)
{
    avr->run = run;
    avr_reset(avr);
    measured.resets++;
    after_reset();
}

void board_hang(uint32_t address)
{
    hung_at = address;
    memcpy(hung_code, avr->flash + address, sizeof hung_code);
    avr->flash[address] = JUMP_TO_ITSELF & 0xFF;
    avr->flash[address + 1] = JUMP_TO_ITSELF >> 8;
}

void board_stop_converter(void)
{
    enum { ADIE_BIT = 3 };
    avr->data[ADCSRA_ADDRESS] &= (uint8_t)~(1 << ADIE_BIT);
}

size_t board_receive(const uint8_t *bytes, size_t size)
{
    avr_irq_t *input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    size_t taken = 0;
    while (taken < size && !line_full)
        avr_raise_irq(input, bytes[taken++]);
    if (taken)
        measured.last_byte = avr->cycle;
    measured.bytes_in += taken;
    return taken;
}

uint8_t board_peek(uint16_t address)
{
    return avr->data[address];
}

const struct pins *board_pins(void)
{
    return &pins;
}
