/* Simple worlds around the simulated board: what its pins do, and what its sensors show. */
#ifndef PLANTS_H
#define PLANTS_H

#include <stdbool.h>

struct pins {
    double pulse_us;     /* of the servo, the latest; 0 before the first */
    double duty[2];      /* of Timer 1's outputs A and B, 0 where they are not connected */
};

struct sensors {
    double volts[8];     /* at the analogue pins */
    bool encoder[2];
};

struct plant {
    const char *name;
    double period;       /* of a step, s */
    void (*start)(struct sensors *sensors);
    void (*step)(const struct pins *pins, struct sensors *sensors, double dt);
    bool (*is_safe)(const struct pins *pins);
    double (*value)(void); /* what a test may want to know of it: position, current, speed */
};

const struct plant *plant_named(const char *name);

#endif
