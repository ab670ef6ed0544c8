/* FMI 3.0 co-simulation around the model of core.h. */
#include <stdbool.h>
#include <stdint.h>
#ifdef FMI3_FUNCTION_PREFIX
#define PREFIX FMI3_FUNCTION_PREFIX
#endif
#include "instance.h"

typedef void (*Logger)(void *, Status, String, String);
typedef const uint8_t *Binary;

static void say(const Instance *i, String text)
{
    ((Logger)i->logger)(i->environment, ERROR, "logStatusError", text);
}

EXPORT String FMI(fmi3GetVersion)(void) { return "3.0"; }

EXPORT Status FMI(fmi3SetDebugLogging)(void *c, bool on, size_t n, const String categories[])
{
    (void)c; (void)on; (void)n; (void)categories;
    return OK;
}

EXPORT void *FMI(fmi3InstantiateCoSimulation)(String name, String token, String resources,
                                              bool visible, bool logging, bool events, bool early,
                                              const Reference required[], size_t n,
                                              void *environment, Logger logger, void (*update)(void))
{
    (void)resources; (void)visible; (void)logging; (void)events; (void)early;
    (void)required; (void)n; (void)update;
    return made(name, token, say, (void (*)(void))logger, environment);
}

/* This is co-simulation. */
EXPORT void *FMI(fmi3InstantiateModelExchange)(String name, String token, String resources,
                                               bool visible, bool logging, void *environment,
                                               Logger logger)
{
    (void)name; (void)token; (void)resources; (void)visible; (void)logging; (void)environment;
    (void)logger;
    return NULL;
}
EXPORT void *FMI(fmi3InstantiateScheduledExecution)(String name, String token, String resources,
                                                    bool visible, bool logging, void *environment,
                                                    Logger logger, void (*update)(void),
                                                    void (*lock)(void), void (*unlock)(void))
{
    (void)name; (void)token; (void)resources; (void)visible; (void)logging; (void)environment;
    (void)logger; (void)update; (void)lock; (void)unlock;
    return NULL;
}

EXPORT void FMI(fmi3FreeInstance)(void *c) { free(c); }

EXPORT Status FMI(fmi3EnterInitializationMode)(void *c, bool tolerated, Real tolerance, Real start,
                                               bool stops, Real stop)
{
    (void)tolerated; (void)tolerance; (void)stops; (void)stop;
    ((Instance *)c)->start_s = start;
    ((Instance *)c)->initialising = 1;
    return OK;
}

EXPORT Status FMI(fmi3ExitInitializationMode)(void *c) { return begin(c); }
EXPORT Status FMI(fmi3Terminate)(void *c) { (void)c; return OK; }
EXPORT Status FMI(fmi3Reset)(void *c) { return reset(c); }

EXPORT Status FMI(fmi3GetFloat64)(void *c, const Reference vr[], size_t n, Real value[], size_t m)
{
    if (n != m)
        return complain(c, "every variable is one number");
    return get(c, vr, n, value);
}

EXPORT Status FMI(fmi3SetFloat64)(void *c, const Reference vr[], size_t n, const Real value[],
                                  size_t m)
{
    if (n != m)
        return complain(c, "every variable is one number");
    return set(c, vr, n, value);
}

EXPORT Status FMI(fmi3DoStep)(void *c, Real time, Real step, bool noSet, bool *event, bool *end,
                              bool *early, Real *reached)
{
    Status status = go(c, time, step);
    (void)noSet;
    *event = *end = *early = false;
    *reached = status == OK ? time + step : time;
    return status;
}

EXPORT Status FMI(fmi3GetFMUState)(void *c, void **state) { return keep(c, state); }
EXPORT Status FMI(fmi3SetFMUState)(void *c, void *state) { return restore(c, state); }
EXPORT Status FMI(fmi3FreeFMUState)(void *c, void **state) { (void)c; return forget(state); }

EXPORT Status FMI(fmi3SerializedFMUStateSize)(void *c, void *state, size_t *size)
{
    (void)c; (void)state;
    *size = KEPT;
    return OK;
}

EXPORT Status FMI(fmi3SerializeFMUState)(void *c, void *state, uint8_t bytes[], size_t size)
{
    return write_down(c, state, bytes, size);
}

EXPORT Status FMI(fmi3DeserializeFMUState)(void *c, const uint8_t bytes[], size_t size,
                                           void **state)
{
    return read_back(c, bytes, size, state);
}

/* What this model has none of. */
#define NONE_OF(name, Kind)                                                                       \
    EXPORT Status FMI(fmi3Get##name)(void *c, const Reference vr[], size_t n, Kind value[],       \
                                     size_t m)                                                    \
    {                                                                                             \
        (void)vr; (void)value; (void)m;                                                           \
        return n ? complain(c, "this model has no " #name) : OK;                                  \
    }                                                                                             \
    EXPORT Status FMI(fmi3Set##name)(void *c, const Reference vr[], size_t n, const Kind value[], \
                                     size_t m)                                                    \
    {                                                                                             \
        (void)vr; (void)value; (void)m;                                                           \
        return n ? complain(c, "this model has no " #name) : OK;                                  \
    }
NONE_OF(Float32, float)
NONE_OF(Int8, int8_t)
NONE_OF(UInt8, uint8_t)
NONE_OF(Int16, int16_t)
NONE_OF(UInt16, uint16_t)
NONE_OF(Int32, int32_t)
NONE_OF(UInt32, uint32_t)
NONE_OF(Int64, int64_t)
NONE_OF(UInt64, uint64_t)
NONE_OF(Boolean, bool)
NONE_OF(String, String)

EXPORT Status FMI(fmi3GetBinary)(void *c, const Reference vr[], size_t n, size_t size[],
                                 Binary value[], size_t m)
{
    (void)vr; (void)size; (void)value; (void)m;
    return n ? complain(c, "this model has no Binary") : OK;
}
EXPORT Status FMI(fmi3SetBinary)(void *c, const Reference vr[], size_t n, const size_t size[],
                                 const Binary value[], size_t m)
{
    (void)vr; (void)size; (void)value; (void)m;
    return n ? complain(c, "this model has no Binary") : OK;
}

typedef const Reference *Vr;
/* Functions for what this model does not have: clocks, events, arrays, derivatives, states. */
#define NOT_HERE(name, ...)                                                                       \
    EXPORT Status FMI(fmi3##name)(void *c, __VA_ARGS__)                                           \
    {                                                                                             \
        return complain(c, #name " is not provided");                                             \
    }
NOT_HERE(GetClock, Vr vr, size_t n, bool value[])
NOT_HERE(SetClock, Vr vr, size_t n, const bool value[])
NOT_HERE(GetNumberOfVariableDependencies, Reference vr, size_t *n)
NOT_HERE(GetVariableDependencies, Reference vr, size_t of[], Reference on[], size_t elements[],
         int kinds[], size_t n)
NOT_HERE(GetDirectionalDerivative, Vr unknown, size_t n, Vr known, size_t m, const Real seed[],
         size_t k, Real value[], size_t l)
NOT_HERE(GetAdjointDerivative, Vr unknown, size_t n, Vr known, size_t m, const Real seed[],
         size_t k, Real value[], size_t l)
NOT_HERE(GetOutputDerivatives, Vr vr, size_t n, const int32_t order[], Real value[], size_t m)
NOT_HERE(GetIntervalDecimal, Vr vr, size_t n, Real interval[], int qualifier[])
NOT_HERE(GetIntervalFraction, Vr vr, size_t n, uint64_t count[], uint64_t per[], int qualifier[])
NOT_HERE(GetShiftDecimal, Vr vr, size_t n, Real shift[])
NOT_HERE(GetShiftFraction, Vr vr, size_t n, uint64_t count[], uint64_t per[])
NOT_HERE(SetIntervalDecimal, Vr vr, size_t n, const Real interval[])
NOT_HERE(SetIntervalFraction, Vr vr, size_t n, const uint64_t count[], const uint64_t per[])
NOT_HERE(SetShiftDecimal, Vr vr, size_t n, const Real shift[])
NOT_HERE(SetShiftFraction, Vr vr, size_t n, const uint64_t count[], const uint64_t per[])
NOT_HERE(UpdateDiscreteStates, bool *update, bool *end, bool *nominals, bool *values, bool *timed,
         Real *next)
NOT_HERE(CompletedIntegratorStep, bool noSet, bool *event, bool *end)
NOT_HERE(SetTime, Real time)
NOT_HERE(SetContinuousStates, const Real state[], size_t n)
NOT_HERE(GetContinuousStateDerivatives, Real slope[], size_t n)
NOT_HERE(GetEventIndicators, Real value[], size_t n)
NOT_HERE(GetContinuousStates, Real state[], size_t n)
NOT_HERE(GetNominalsOfContinuousStates, Real nominal[], size_t n)
NOT_HERE(GetNumberOfEventIndicators, size_t *n)
NOT_HERE(GetNumberOfContinuousStates, size_t *n)
NOT_HERE(ActivateModelPartition, Reference clock, Real time)

#define NO_MODE(name)                                                                             \
    EXPORT Status FMI(fmi3##name)(void *c) { return complain(c, #name " is not provided"); }
NO_MODE(EnterEventMode)
NO_MODE(EnterStepMode)
NO_MODE(EnterContinuousTimeMode)
NO_MODE(EnterConfigurationMode)
NO_MODE(ExitConfigurationMode)
NO_MODE(EvaluateDiscreteStates)
