/* A pendulum as an FMU, FMI 2 (-DFMI=2) and FMI 3 (-DFMI=3): model exchange and co-simulation.
 *
 * The FMU under test, written against the standard's headers alone. Co-simulation makes Euler's steps of 0.1 ms, or
 * of -DSTEP s and then no others, as exported solvers of a fixed step do; -DHEUN makes them by Heun's method.
 * -DSTARTS are the starts of the variables in the order of their value references; the rates start at 0.
 * -DDRY adds Coulomb friction with a state event, which a table of accelerations cannot hold.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#if FMI == 2
#include "fmi2Functions.h"
#define NAME(x) fmi2##x
typedef fmi2Component Instance;
typedef fmi2Status Status;
typedef fmi2Real Real;
#define OK fmi2OK
#define FAILED fmi2Error
#else
#include "fmi3Functions.h"
#define NAME(x) fmi3##x
typedef fmi3Instance Instance;
typedef fmi3Status Status;
typedef fmi3Float64 Real;
#define OK fmi3OK
#define FAILED fmi3Error
#endif

/* by value reference */
enum { ANGLE, RATE, TORQUE, INERTIA, GRAVITY, DRAG, WIDTH, START, RATE_OF_ANGLE, RATE_OF_RATE, COUNT };
typedef struct { double v[COUNT]; int is_placed; } Rod;

static void reset(Rod *rod) {
    const double starts[COUNT] = {STARTS};
    memcpy(rod->v, starts, sizeof starts);
    rod->is_placed = 0;
}

static void derive(Rod *rod) {
    double *v = rod->v, dry = 0.0;
#ifdef DRY
    dry = 0.05 * ((v[RATE] > 0.0) - (v[RATE] < 0.0));
#endif
    v[RATE_OF_ANGLE] = v[RATE];
    v[RATE_OF_RATE] = (v[TORQUE] - v[GRAVITY] * sin(v[ANGLE]) - v[DRAG] * v[RATE] - dry) / v[INERTIA];
}

static void euler(Rod *rod, double h) {
    derive(rod);
    rod->v[ANGLE] += h * rod->v[RATE_OF_ANGLE];
    rod->v[RATE] += h * rod->v[RATE_OF_RATE];
}

static void step(Rod *rod, double h) {
#ifdef HEUN
    const double angle = rod->v[ANGLE], rate = rod->v[RATE];
    euler(rod, h);
    euler(rod, h);
    rod->v[ANGLE] = 0.5 * (angle + rod->v[ANGLE]);
    rod->v[RATE] = 0.5 * (rate + rod->v[RATE]);
#else
    euler(rod, h);
#endif
}

static Status go(Rod *rod, double length) {
#ifdef STEP
    int parts = (int)(length / STEP + 0.5);
    if (parts < 1 || fabs(length - parts * STEP) > 1e-9) return FAILED;
#else
    int parts = (int)(length / 1e-4 + 0.5);
#endif
    for (int k = 0; k < parts; k++) step(rod, length / parts);
    return OK;
}

static Status put(Rod *rod, const unsigned *vr, size_t n, const Real *x) {
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= RATE_OF_ANGLE) return FAILED;
        rod->v[vr[k]] = x[k];
        if (vr[k] == ANGLE) rod->is_placed = 1;
    }
    return OK;
}

static Status get(Rod *rod, const unsigned *vr, size_t n, Real *x) {
    derive(rod);
    for (size_t k = 0; k < n; k++) {
        if (vr[k] >= COUNT) return FAILED;
        x[k] = rod->v[vr[k]];
    }
    return OK;
}

Status NAME(Reset)(Instance c) { reset(c); return OK; }
Status NAME(ExitInitializationMode)(Instance c) { (void)c; return OK; }
Status NAME(EnterEventMode)(Instance c) { (void)c; return OK; }
Status NAME(EnterContinuousTimeMode)(Instance c) { (void)c; return OK; }
Status NAME(Terminate)(Instance c) { (void)c; return OK; }
void NAME(FreeInstance)(Instance c) { free(c); }
Status NAME(SetTime)(Instance c, Real t) { (void)c; (void)t; return OK; }

Status NAME(GetContinuousStates)(Instance c, Real *x, size_t n) {
    memcpy(x, ((Rod *)c)->v, n * sizeof *x);
    return OK;
}
Status NAME(SetContinuousStates)(Instance c, const Real *x, size_t n) {
    memcpy(((Rod *)c)->v, x, n * sizeof *x);
    return OK;
}

#if FMI == 2
fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *calls, fmi2Boolean visible, fmi2Boolean logging) {
    (void)name; (void)type; (void)resources; (void)calls; (void)visible; (void)logging;
    if (strcmp(guid, "{rod}")) return NULL;
    Rod *rod = malloc(sizeof *rod);
    reset(rod);
    return rod;
}
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean d, fmi2Real tol, fmi2Real t, fmi2Boolean e,
                               fmi2Real stop) {
    (void)c; (void)d; (void)tol; (void)t; (void)e; (void)stop;
    return OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Rod *rod = c;
    if (!rod->is_placed) rod->v[ANGLE] = rod->v[START];
    return rod->v[INERTIA] > 0.0 ? OK : FAILED;
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real x[]) {
    return put(c, vr, n, x);
}
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real x[]) {
    return get(c, vr, n, x);
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    (void)c;
    memset(info, 0, sizeof *info);
    return OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    derive(c);
    memcpy(dx, ((Rod *)c)->v + RATE_OF_ANGLE, n * sizeof *dx);
    return OK;
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real length, fmi2Boolean none) {
    (void)t; (void)none;
    return go(c, length);
}
#else
static Instance made(fmi3String token) {
    if (strcmp(token, "{rod}")) return NULL;
    Rod *rod = malloc(sizeof *rod);
    reset(rod);
    return rod;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3InstanceEnvironment env,
                                          fmi3LogMessageCallback log) {
    (void)name; (void)path; (void)visible; (void)logging; (void)env; (void)log;
    return made(token);
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference vr[], size_t n, fmi3InstanceEnvironment env,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name; (void)path; (void)visible; (void)logging; (void)events; (void)early; (void)vr; (void)n;
    (void)env; (void)log; (void)update;
    return made(token);
}
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean d, fmi3Float64 tol, fmi3Float64 t,
                                       fmi3Boolean e, fmi3Float64 stop) {
    Rod *rod = c;
    (void)d; (void)tol; (void)t; (void)e; (void)stop;
    if (!rod->is_placed) rod->v[ANGLE] = rod->v[START];
    return rod->v[INERTIA] > 0.0 ? OK : FAILED;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 x[],
                          size_t m) {
    (void)m;
    return put(c, vr, n, x);
}
fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 x[], size_t m) {
    (void)m;
    return get(c, vr, n, x);
}
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *more, fmi3Boolean *end, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *next, fmi3Float64 *at) {
    (void)c;
    *more = *end = *nominals = *values = *next = 0;
    *at = 0.0;
    return OK;
}
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) {
    derive(c);
    memcpy(dx, ((Rod *)c)->v + RATE_OF_ANGLE, n * sizeof *dx);
    return OK;
}
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 length, fmi3Boolean none, fmi3Boolean *event,
                      fmi3Boolean *end, fmi3Boolean *early, fmi3Float64 *last) {
    (void)none;
    *event = *end = *early = 0;
    *last = t + length;
    return go(c, length);
}
#endif
