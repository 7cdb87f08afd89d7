/* The DC motor bench as it is wired and calibrated: the one file to edit for your own. */
#ifndef BENCH_H
#define BENCH_H

#define BENCH_SERIAL "mega-1" /* at most 16 ASCII characters */
#define LINE_BAUD_RATE 500000 /* exact at 16 MHz */

/* Sampling: 100 to 1000 Hz; a frame leaves every SAMPLES_PER_FRAME. */
#define SAMPLE_RATE 100
#define SAMPLES_PER_FRAME 1

/* H-bridge: forward half on digital pin 11 (OC1A), backward half on 12 (OC1B), 20 kHz, both low is
 * a brake; enable on digital pin 8. */
#define MOTOR_SUPPLY 12.0f /* V, measured at the bridge */

/* Encoder: A on digital pin 2, B on 3; counts are edges of both. At most 20000 edges per second. */
#define ENCODER_COUNTS 400 /* per turn of the shaft */

/* Current: value = (count - ZERO) * SCALE in A, counts of 10 bits at 5 V; an amplifier with 0.5 V/A
 * around 2.5 V. */
#define CURRENT_PIN 0
#define CURRENT_SCALE (5.0f / 1024.0f / 0.5f)
#define CURRENT_ZERO 512.0f

/* Temperature of the winding, 10 mV per degree Celsius; a scale of 0 says that there is no sensor. */
#define TEMPERATURE_PIN 1
#define TEMPERATURE_SCALE 0.0f
#define TEMPERATURE_ZERO 0.0f

/* How long (s) the motor may have voltage without a break before it is switched off until SAFE. */
#define LONGEST_OUTPUT_S 3600

#endif
