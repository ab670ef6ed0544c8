/* FMI 2.0 co-simulation around the model of core.h. */
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include "model.h"
#include "core.h"

#if defined(_WIN32)
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif
#ifdef FMI2_FUNCTION_PREFIX
#define PASTE(a, b) a##b
#define PASTED(a, b) PASTE(a, b)
#define FMI(name) PASTED(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI(name) name
#endif

typedef double Real;
typedef int Integer;
typedef int Boolean;
typedef const char *String;
typedef unsigned int Reference;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;
typedef void (*Logger)(void *, String, Status, String, String, ...);
typedef struct {
    Logger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, Status);
    void *componentEnvironment;
} Callbacks;

typedef struct {
    Core core;
    double start_s;
    int initialising;
    int failed;
    Callbacks callbacks;
    char name[128];
} Instance;

static Status complain(Instance *i, const char *format, ...)
{
    char text[256];
    va_list given;
    va_start(given, format);
    vsnprintf(text, sizeof text, format, given);
    va_end(given);
    if (i->callbacks.logger)
        i->callbacks.logger(i->callbacks.componentEnvironment, i->name, ERROR, "logStatusError",
                            "%s", text);
    return ERROR;
}

static Status in_bounds(Instance *i)
{
    int k = core_wrong(&i->core);
    if (k < 0)
        return OK;
    return complain(i, "%s is %g, expected %g to %g", NAMES[k], i->core.r[k], LOWEST[k],
                    HIGHEST[k]);
}

EXPORT String FMI(fmi2GetTypesPlatform)(void) { return "default"; }
EXPORT String FMI(fmi2GetVersion)(void) { return "2.0"; }

EXPORT Status FMI(fmi2SetDebugLogging)(void *c, Boolean on, size_t n, const String *categories)
{
    (void)c; (void)on; (void)n; (void)categories;
    return OK;
}

EXPORT void *FMI(fmi2Instantiate)(String name, int type, String guid, String resources,
                                  const Callbacks *callbacks, Boolean visible, Boolean logging)
{
    Instance *i;
    (void)resources; (void)visible; (void)logging;
    if (type != 1 || !guid || strcmp(guid, GUID) != 0)
        return NULL; /* this is co-simulation, and of another description */
    i = calloc(1, sizeof *i);
    if (!i)
        return NULL;
    if (callbacks)
        i->callbacks = *callbacks;
    snprintf(i->name, sizeof i->name, "%s", name ? name : "");
    core_reset(&i->core);
    return i;
}

EXPORT void FMI(fmi2FreeInstance)(void *c) { free(c); }

EXPORT Status FMI(fmi2SetupExperiment)(void *c, Boolean tolerated, Real tolerance, Real start,
                                       Boolean stops, Real stop)
{
    (void)tolerated; (void)tolerance; (void)stops; (void)stop;
    ((Instance *)c)->start_s = start;
    return OK;
}

EXPORT Status FMI(fmi2EnterInitializationMode)(void *c)
{
    ((Instance *)c)->initialising = 1;
    return OK;
}

EXPORT Status FMI(fmi2ExitInitializationMode)(void *c)
{
    Instance *i = c;
    if (in_bounds(i) != OK)
        return ERROR;
    i->initialising = 0;
    core_begin(&i->core);
    return OK;
}

EXPORT Status FMI(fmi2Terminate)(void *c) { (void)c; return OK; }

EXPORT Status FMI(fmi2Reset)(void *c)
{
    Instance *i = c;
    core_reset(&i->core);
    i->start_s = 0.0;
    i->initialising = i->failed = 0;
    return OK;
}

EXPORT Status FMI(fmi2GetReal)(void *c, const Reference vr[], size_t n, Real value[])
{
    Instance *i = c;
    size_t k;
    if (i->initialising && core_wrong(&i->core) < 0)
        core_begin(&i->core);
    for (k = 0; k < n; k++) {
        if (vr[k] >= VARIABLES)
            return complain(i, "no variable has the value reference %u", vr[k]);
        value[k] = i->core.r[vr[k]];
    }
    return OK;
}

EXPORT Status FMI(fmi2SetReal)(void *c, const Reference vr[], size_t n, const Real value[])
{
    Instance *i = c;
    size_t k;
    for (k = 0; k < n; k++) {
        if (vr[k] >= VARIABLES || (vr[k] >= GIVEN && vr[k] < GIVEN + OUTPUTS))
            return complain(i, "the value reference %u cannot be set", vr[k]);
        if (i->core.begun && !i->initialising && vr[k] >= GIVEN && vr[k] < TUNABLE)
            return complain(i, "%s can be set before the start only", NAMES[vr[k]]);
        i->core.r[vr[k]] = value[k];
        if (vr[k] < INPUTS)
            i->core.rate[vr[k]] = 0.0;
    }
    if (i->core.begun && !i->initialising && core_wrong(&i->core) < 0) {
        core_set(&i->core);
        core_outputs(&i->core);
    }
    return OK;
}

EXPORT Status FMI(fmi2SetRealInputDerivatives)(void *c, const Reference vr[], size_t n,
                                               const Integer order[], const Real value[])
{
    Instance *i = c;
    size_t k;
    for (k = 0; k < n; k++) {
        if (vr[k] >= INPUTS || order[k] != 1)
            return complain(i, "an input's first derivative can be set, nothing else");
        i->core.rate[vr[k]] = value[k];
    }
    return OK;
}

EXPORT Status FMI(fmi2DoStep)(void *c, Real time, Real step, Boolean noSet)
{
    Instance *i = c;
    (void)noSet;
    if (i->failed || !i->core.begun)
        return complain(i, "a step before the initialisation, or after an error");
    if (!(step > 0.0) || step > 10.0)
        return complain(i, "a step of %g s, expected more than 0 and at most 10", step);
    if (in_bounds(i) != OK)
        return ERROR;
    if (core_step(&i->core, time - i->start_s, step))
        return OK;
    i->failed = 1;
    return complain(i, "the motion is no number any more after %g s", time + step);
}

EXPORT Status FMI(fmi2CancelStep)(void *c) { return complain(c, "a step cannot be cancelled"); }

EXPORT Status FMI(fmi2GetFMUstate)(void *c, void **state)
{
    Instance *i = c;
    if (!*state)
        *state = malloc(sizeof *i);
    if (!*state)
        return complain(i, "no memory for the state");
    memcpy(*state, i, sizeof *i);
    return OK;
}

static Status restore(Instance *i, const Instance *from)
{
    i->core = from->core;
    i->start_s = from->start_s;
    i->initialising = from->initialising;
    i->failed = from->failed;
    return OK;
}

EXPORT Status FMI(fmi2SetFMUstate)(void *c, void *state) { return restore(c, state); }

EXPORT Status FMI(fmi2FreeFMUstate)(void *c, void **state)
{
    (void)c;
    free(*state);
    *state = NULL;
    return OK;
}

EXPORT Status FMI(fmi2SerializedFMUstateSize)(void *c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = offsetof(Instance, callbacks);
    return OK;
}

EXPORT Status FMI(fmi2SerializeFMUstate)(void *c, void *state, char bytes[], size_t size)
{
    if (size < offsetof(Instance, callbacks))
        return complain(c, "too little room for the state");
    memcpy(bytes, state, offsetof(Instance, callbacks));
    return OK;
}

EXPORT Status FMI(fmi2DeSerializeFMUstate)(void *c, const char bytes[], size_t size, void **state)
{
    if (size != offsetof(Instance, callbacks))
        return complain(c, "a state of another model");
    if (!*state)
        *state = calloc(1, sizeof(Instance));
    if (!*state)
        return complain(c, "no memory for the state");
    memcpy(*state, bytes, size);
    return OK;
}

/* What this model has none of. */
#define NONE_OF(name, Kind)                                                                       \
    EXPORT Status FMI(name)(void *c, const Reference vr[], size_t n, Kind value[])                \
    {                                                                                             \
        (void)vr; (void)value;                                                                    \
        return n ? complain(c, #name ": this model has only reals") : OK;                         \
    }
NONE_OF(fmi2GetInteger, Integer)
NONE_OF(fmi2GetBoolean, Boolean)
NONE_OF(fmi2GetString, String)
NONE_OF(fmi2SetInteger, const Integer)
NONE_OF(fmi2SetBoolean, const Boolean)
NONE_OF(fmi2SetString, const String)

EXPORT Status FMI(fmi2GetRealOutputDerivatives)(void *c, const Reference vr[], size_t n,
                                                const Integer order[], Real value[])
{
    (void)vr; (void)order; (void)value;
    return n ? complain(c, "outputs have no derivatives here") : OK;
}

EXPORT Status FMI(fmi2GetDirectionalDerivative)(void *c, const Reference u[], size_t nu,
                                                const Reference k[], size_t nk, const Real dv[],
                                                Real out[])
{
    (void)u; (void)nu; (void)k; (void)nk; (void)dv; (void)out;
    return complain(c, "directional derivatives are not provided");
}

EXPORT Status FMI(fmi2GetStatus)(void *c, int kind, Status *value)
{
    (void)c; (void)kind; (void)value;
    return DISCARD;
}
EXPORT Status FMI(fmi2GetRealStatus)(void *c, int kind, Real *value)
{
    if (kind != 2)
        return DISCARD;
    *value = ((Instance *)c)->core.time_s + ((Instance *)c)->start_s;
    return OK;
}
EXPORT Status FMI(fmi2GetIntegerStatus)(void *c, int kind, Integer *value)
{
    (void)c; (void)kind; (void)value;
    return DISCARD;
}
EXPORT Status FMI(fmi2GetBooleanStatus)(void *c, int kind, Boolean *value)
{
    if (kind != 3)
        return DISCARD;
    *value = ((Instance *)c)->failed;
    return OK;
}
EXPORT Status FMI(fmi2GetStringStatus)(void *c, int kind, String *value)
{
    (void)c; (void)kind; (void)value;
    return DISCARD;
}
