/* The solenoid bench as it is wired and calibrated: the one file to edit for your own. */
#ifndef BENCH_H
#define BENCH_H

#define BENCH_SERIAL "mega-1" /* at most 16 ASCII characters */
#define LINE_BAUD_RATE 500000 /* exact at 16 MHz */

/* Sampling: SAMPLE_RATE divides the 5 kHz of the current loop; a frame leaves every SAMPLES_PER_FRAME. */
#define SAMPLE_RATE 1000
#define SAMPLES_PER_FRAME 10

/* Coil: its gate driver on digital pin 11 (OC1A), 20 kHz. The current loop is designed from these. */
#define COIL_SUPPLY 12.0f      /* V */
#define COIL_RESISTANCE 4.0f   /* ohm */
#define COIL_INDUCTANCE 0.02f  /* H, the least over the plunger's way */
#define LOOP_TIME_CONSTANT 1e-3f /* s, 1e-3 or more */

/* Sensors: value = (count - ZERO) * SCALE in SI, counts of 10 bits at 5 V, analogue pins 0 to 7.
 * Current: an amplifier with 1.5 V/A. Position: 0 to 5 mm on 5 V. */
#define CURRENT_PIN 0
#define CURRENT_SCALE (5.0f / 1024.0f / 1.5f)
#define CURRENT_ZERO 0.0f
#define POSITION_PIN 1
#define POSITION_SCALE (5e-3f / 1024.0f)
#define POSITION_ZERO 0.0f

/* Load cell: its amplifier on FORCE_PIN; a scale of 0 says that there is none. */
#define FORCE_PIN 2
#define FORCE_SCALE 0.0f
#define FORCE_ZERO 0.0f

/* How long (s) the coil may carry current without a break before it is switched off until SAFE. */
#define LONGEST_OUTPUT_S 120

#endif
