/* A number that no other boot of this board has had. */
#ifndef LABHIL_BOOT_H
#define LABHIL_BOOT_H

#include <stdint.h>

/* Count this boot in the EEPROM and return the count, from 1. Takes up to 15 ms. */
uint32_t boot_count(void);

#endif
