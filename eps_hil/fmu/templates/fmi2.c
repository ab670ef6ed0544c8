/* FMI 2.0 co-simulation around the model of core.h. */
#ifdef FMI2_FUNCTION_PREFIX
#define PREFIX FMI2_FUNCTION_PREFIX
#endif
#include "instance.h"

typedef int Integer;
typedef int Boolean;
typedef void (*Logger)(void *, String, Status, String, String, ...);
typedef struct {
    Logger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, Status);
    void *componentEnvironment;
} Callbacks;

static void say(const Instance *i, String text)
{
    ((Logger)i->logger)(i->environment, i->name, ERROR, "logStatusError", "%s", text);
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
    (void)resources; (void)visible; (void)logging;
    if (type != 1)
        return NULL; /* this is co-simulation */
    return made(name, guid, say, callbacks ? (void (*)(void))callbacks->logger : NULL,
                callbacks ? callbacks->componentEnvironment : NULL);
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

EXPORT Status FMI(fmi2ExitInitializationMode)(void *c) { return begin(c); }
EXPORT Status FMI(fmi2Terminate)(void *c) { (void)c; return OK; }
EXPORT Status FMI(fmi2Reset)(void *c) { return reset(c); }

EXPORT Status FMI(fmi2GetReal)(void *c, const Reference vr[], size_t n, Real value[])
{
    return get(c, vr, n, value);
}

EXPORT Status FMI(fmi2SetReal)(void *c, const Reference vr[], size_t n, const Real value[])
{
    return set(c, vr, n, value);
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
    (void)noSet;
    return go(c, time, step);
}

EXPORT Status FMI(fmi2CancelStep)(void *c) { return complain(c, "a step cannot be cancelled"); }

EXPORT Status FMI(fmi2GetFMUstate)(void *c, void **state) { return keep(c, state); }
EXPORT Status FMI(fmi2SetFMUstate)(void *c, void *state) { return restore(c, state); }
EXPORT Status FMI(fmi2FreeFMUstate)(void *c, void **state) { (void)c; return forget(state); }

EXPORT Status FMI(fmi2SerializedFMUstateSize)(void *c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = KEPT;
    return OK;
}

EXPORT Status FMI(fmi2SerializeFMUstate)(void *c, void *state, char bytes[], size_t size)
{
    return write_down(c, state, bytes, size);
}

EXPORT Status FMI(fmi2DeSerializeFMUstate)(void *c, const char bytes[], size_t size, void **state)
{
    return read_back(c, bytes, size, state);
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
