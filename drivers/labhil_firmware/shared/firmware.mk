# How a bench is built and flashed; included by each bench's Makefile, which sets BENCH.
#   make                         build/$(BENCH).hex, and how much memory it takes
#   make flash PORT=/dev/ttyACM0 write it to the board

SHARED ?= $(dir $(lastword $(MAKEFILE_LIST)))
HERE ?= .
BUILD ?= build
PORT ?= /dev/ttyACM0
CC = avr-gcc
MCU = atmega2560

SOURCES = $(wildcard $(HERE)/*.c) $(wildcard $(SHARED)/*.c)
HEADERS = $(wildcard $(HERE)/*.h) $(wildcard $(SHARED)/*.h)
# which sources this was built from; HELLO says it
BUILD_HASH := $(shell cat $(sort $(SOURCES) $(HEADERS)) | cksum | cut -d' ' -f1)
CFLAGS = -std=gnu11 -Os -Wall -Wextra -Werror -mmcu=$(MCU) -DF_CPU=16000000UL \
         -DBUILD_HASH=$(BUILD_HASH)UL -ffunction-sections -fdata-sections -fshort-enums \
         -I$(HERE) -I$(SHARED)

all: $(BUILD)/$(BENCH).hex
	avr-size -C --mcu=$(MCU) $(BUILD)/$(BENCH).elf

$(BUILD)/$(BENCH).elf: $(SOURCES) $(HEADERS)
	mkdir -p $(BUILD)
	$(CC) $(CFLAGS) -Wl,--gc-sections -o $@ $(SOURCES) -lm

$(BUILD)/$(BENCH).hex: $(BUILD)/$(BENCH).elf
	avr-objcopy -O ihex -R .eeprom $< $@

flash: $(BUILD)/$(BENCH).hex
	avrdude -p $(MCU) -c wiring -P $(PORT) -b 115200 -D -U flash:w:$<:i

clean:
	rm -rf $(BUILD)

.PHONY: all flash clean
