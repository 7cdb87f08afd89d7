/* The ball-and-beam bench as it is wired and calibrated: the one file to edit for your own. */
#ifndef BENCH_H
#define BENCH_H

#define BENCH_SERIAL "mega-1" /* at most 16 ASCII characters */
#define LINE_BAUD_RATE 115200

/* Sampling. The servo gets SERVO_PULSES_PER_SAMPLE pulses in a sample period of 10 ms: 1 (100 Hz) for
 * an analogue servo that takes no more, 2 (200 Hz) for a digital one, 4 (400 Hz) where it can. */
#define SAMPLE_RATE 100
#define SERVO_PULSES_PER_SAMPLE 2

/* Servo on digital pin 11 (OC1A); pulse widths in 0.1 us. To calibrate, find the width at which the
 * beam is level and the change of width that turns the disc by 90 degrees. */
#define SERVO_LEVEL 15000
#define SERVO_QUARTER_TURN 5000

/* Position: linear potentiometer between 5 V and ground, its wiper on analogue pin POSITION_PIN.
 * position (m) = (count - POSITION_ZERO) * POSITION_SCALE, both for 10 bits; POSITION_BITS 8 or 10. */
#define POSITION_PIN 0
#define POSITION_BITS 10
#define POSITION_SCALE (0.5f / 1024.0f)
#define POSITION_ZERO 512.0f

/* How long (s) the servo may be away from level without a break before it goes there and stays until
 * SAFE; 0: as long as the host wants. A servo takes no harm from it, and the driver does not expect it. */
#define LONGEST_OUTPUT_S 0

#endif
