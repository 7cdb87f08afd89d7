#include "boot.h"

#include <avr/eeprom.h>

/* A cell of the EEPROM lasts 100 000 writes and every opening of the port is a boot, so the count
 * walks through these places. */
enum { PLACES = 64 };
static uint32_t EEMEM counts[PLACES];

uint32_t boot_count(void)
{
    uint32_t latest = 0;
    uint8_t place = PLACES - 1;
    for (uint8_t i = 0; i < PLACES; i++) {
        uint32_t count = eeprom_read_dword(&counts[i]);
        if (count != UINT32_MAX && count > latest) { /* an erased cell is all ones */
            latest = count;
            place = i;
        }
    }
    eeprom_update_dword(&counts[(place + 1) % PLACES], latest + 1);
    return latest + 1;
}
