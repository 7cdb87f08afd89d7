/* Samples on their way from the interrupt handlers to the host, several in a frame. */
#ifndef LABHIL_BATCH_H
#define LABHIL_BATCH_H

#include <stdbool.h>
#include <stdint.h>

/* Called in an interrupt handler: a sample period begins, and with it a sample. Numbers it. */
void batch_begin_sample(void);

/* Called in an interrupt handler: the sample that was begun last is complete; `bench.fitted_count`
 * numbers. When the main loop has fallen behind it is lost, and its number missing. */
void batch_end_sample(const uint16_t *raw);

/* Tell whether a frame is full. */
bool batch_is_full(void);

/* Send the frame that is full, if one is. */
void batch_send(void);

#endif
