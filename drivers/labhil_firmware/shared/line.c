#include "line.h"

#include <avr/interrupt.h>
#include <avr/io.h>

#include "bench.h"
#include "session.h"

#define BAUD LINE_BAUD_RATE
#define BAUD_TOL 3
#include <util/setbaud.h>

/* both have 256 places, so that an index is a byte and wraps by itself */
static volatile uint8_t received[256], to_send[256];
static volatile uint8_t received_head, received_tail;
static volatile uint8_t send_head, send_tail;

volatile struct line_losses line_losses;

static void count(volatile uint16_t *counter)
{
    if (*counter != UINT16_MAX)
        ++*counter;
}

void line_begin(void)
{
#if USE_2X
    UCSR0A = _BV(U2X0);
#else
    UCSR0A = 0;
#endif
    UBRR0H = UBRRH_VALUE;
    UBRR0L = UBRRL_VALUE; /* last: the simulator takes the rate over here */
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

ISR(USART0_RX_vect)
{
    uint8_t status = UCSR0A;
    uint8_t byte = UDR0;
    if (status & _BV(DOR0))
        count(&line_losses.overruns);
    if (status & _BV(FE0)) {
        count(&line_losses.framing_errors);
        return;
    }
    uint8_t next = received_head + 1;
    if (next == received_tail) {
        count(&line_losses.overruns);
        return;
    }
    received[received_head] = byte;
    received_head = next;
}

ISR(USART0_UDRE_vect)
{
    if (send_tail != send_head)
        UDR0 = to_send[send_tail++];
    if (send_tail == send_head)
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
}

bool line_has_bytes(void)
{
    return received_head != received_tail;
}

bool line_receive(uint8_t *byte)
{
    if (!line_has_bytes())
        return false;
    *byte = received[received_tail];
    received_tail++;
    return true;
}

bool line_send(const uint8_t *bytes, uint8_t size)
{
    uint8_t room = (uint8_t)(send_tail - send_head - 1);
    if (size > room) {
        count(&line_losses.unsent);
        return false;
    }
    uint8_t head = send_head;
    for (uint8_t i = 0; i < size; i++)
        to_send[head++] = bytes[i];
    send_head = head;
    UCSR0B |= _BV(UDRIE0);
    return true;
}
