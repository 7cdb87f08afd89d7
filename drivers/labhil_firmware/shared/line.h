/* The serial line to the host: USART 0 (the Mega's USB port) with a ring buffer each way. */
#ifndef LABHIL_LINE_H
#define LABHIL_LINE_H

#include <stdbool.h>
#include <stdint.h>

/* What went wrong on the line since boot; each saturates. */
struct line_losses {
    uint16_t overruns;      /* bytes that came while the receive buffer, or the USART, was full */
    uint16_t framing_errors; /* bytes without a stop bit: wrong baud rate, or a bad cable */
    uint16_t unsent;        /* messages for which the transmit buffer had no room */
};

extern volatile struct line_losses line_losses;

void line_begin(void);

/* Give the oldest byte received; false when there is none. */
bool line_receive(uint8_t *byte);

/* Tell whether bytes wait; for use with interrupts off. */
bool line_has_bytes(void);

#endif
