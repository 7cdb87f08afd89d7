#include "plants.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

static double clamped(double value, double low, double high)
{
    return value < low ? low : value > high ? high : value;
}

/* Ball and beam: beta = asin(r/l sin gamma), a = 5/7 g sin beta - c v, between two stops. */
static struct {
    double position, velocity;
} ball;

static void ball_show(struct sensors *sensors)
{
    sensors->volts[0] = 5.0 * (ball.position / 0.5 + 0.5);
}

static void ball_start(struct sensors *sensors)
{
    ball.position = 0.05;
    ball.velocity = 0.0;
    ball_show(sensors);
}

static void ball_step(const struct pins *pins, struct sensors *sensors, double dt)
{
    if (pins->pulse_us > 0.0) {
        double angle = (pins->pulse_us - 1500.0) / 500.0 * M_PI_2;
        double beam = asin(0.08 / 0.40 * sin(angle));
        ball.velocity += dt * (5.0 / 7.0 * 9.81 * sin(beam) - 0.3 * ball.velocity);
        ball.position += dt * ball.velocity;
        if (fabs(ball.position) > 0.24) {
            ball.position = copysign(0.24, ball.position);
            ball.velocity = 0.0;
        }
    }
    ball_show(sensors);
}

static bool ball_is_safe(const struct pins *pins)
{
    return fabs(pins->pulse_us - 1500.0) < 1.0;
}

static double ball_value(void)
{
    return ball.position;
}

/* Solenoid: L di/dt = V - R i, i >= 0; a plunger on a spring, drawn by k i^2, between two stops. */
static struct {
    double current, position, velocity;
} coil;

static void coil_show(struct sensors *sensors)
{
    sensors->volts[0] = 1.5 * coil.current;
    sensors->volts[1] = 1000.0 * coil.position;
}

static void coil_start(struct sensors *sensors)
{
    memset(&coil, 0, sizeof coil);
    coil_show(sensors);
}

static void coil_step(const struct pins *pins, struct sensors *sensors, double dt)
{
    coil.current += dt * (12.0 * pins->duty[0] - 4.0 * coil.current) / 0.02;
    coil.current = fmax(coil.current, 0.0);
    double force = 2.0 * coil.current * coil.current - 1.0 - 1500.0 * coil.position - 2.0 * coil.velocity;
    coil.velocity += dt * force / 0.064;
    coil.position += dt * coil.velocity;
    if (coil.position < 0.0 || coil.position > 0.005) {
        coil.position = clamped(coil.position, 0.0, 0.005);
        coil.velocity = 0.0;
    }
    coil_show(sensors);
}

static bool coil_is_safe(const struct pins *pins)
{
    return pins->duty[0] == 0.0;
}

static double coil_value(void)
{
    return coil.current;
}

/* DC motor: L di/dt = V - R i - k w, J dw/dt = k i - b w; an encoder of 400 edges per turn. */
static struct {
    double current, speed, angle;
} motor;

static void motor_show(struct sensors *sensors)
{
    static const bool a[] = {false, true, true, false}, b[] = {false, false, true, true};
    long phase = (long)floor(motor.angle / (2.0 * M_PI) * 400.0) & 3;
    sensors->volts[0] = 2.5 + 0.5 * motor.current;
    sensors->encoder[0] = a[phase];
    sensors->encoder[1] = b[phase];
}

static void motor_start(struct sensors *sensors)
{
    memset(&motor, 0, sizeof motor);
    motor_show(sensors);
}

static void motor_step(const struct pins *pins, struct sensors *sensors, double dt)
{
    double voltage = 12.0 * (pins->duty[0] - pins->duty[1]);
    motor.current += dt * (voltage - 2.0 * motor.current - 0.06 * motor.speed) / 2e-3;
    motor.speed += dt * (0.06 * motor.current - 1e-4 * motor.speed) / 1e-4;
    motor.angle += dt * motor.speed;
    motor_show(sensors);
}

static bool motor_is_safe(const struct pins *pins)
{
    return pins->duty[0] == 0.0 && pins->duty[1] == 0.0;
}

static double motor_value(void)
{
    return motor.speed;
}

static const struct plant plants[] = {
    {"ball_beam", 200e-6, ball_start, ball_step, ball_is_safe, ball_value},
    {"solenoid", 20e-6, coil_start, coil_step, coil_is_safe, coil_value},
    {"dc_motor", 5e-6, motor_start, motor_step, motor_is_safe, motor_value},
};

const struct plant *plant_named(const char *name)
{
    for (size_t i = 0; i < sizeof plants / sizeof *plants; i++)
        if (strcmp(plants[i].name, name) == 0)
            return &plants[i];
    return NULL;
}
