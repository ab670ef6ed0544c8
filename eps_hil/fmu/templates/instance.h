/* An instance of the model behind either version of FMI: what both do is done here. */
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
#ifdef PREFIX
#define PASTE(a, b) a##b
#define PASTED(a, b) PASTE(a, b)
#define FMI(name) PASTED(PREFIX, name)
#else
#define FMI(name) name
#endif

typedef double Real;
typedef const char *String;
typedef unsigned int Reference;
typedef enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING } Status;

typedef struct Instance Instance;
struct Instance {
    Core core;
    double start_s;
    int initialising;
    int failed;
    void (*say)(const Instance *, String); /* from here on: of this instance alone */
    void (*logger)(void);
    void *environment;
    char name[128];
};
#define KEPT offsetof(Instance, say) /* bytes that are its state */

static Status complain(Instance *i, const char *format, ...)
{
    char text[256];
    va_list given;
    va_start(given, format);
    vsnprintf(text, sizeof text, format, given);
    va_end(given);
    if (i->logger)
        i->say(i, text);
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

/* NULL where the description is of another model. */
static Instance *made(String name, String guid, void (*say)(const Instance *, String),
                      void (*logger)(void), void *environment)
{
    Instance *i;
    if (!guid || strcmp(guid, GUID) != 0)
        return NULL;
    i = calloc(1, sizeof *i);
    if (!i)
        return NULL;
    i->say = say;
    i->logger = logger;
    i->environment = environment;
    snprintf(i->name, sizeof i->name, "%s", name ? name : "");
    core_reset(&i->core);
    return i;
}

static Status reset(Instance *i)
{
    core_reset(&i->core);
    i->start_s = 0.0;
    i->initialising = i->failed = 0;
    return OK;
}

static Status begin(Instance *i)
{
    if (in_bounds(i) != OK)
        return ERROR;
    i->initialising = 0;
    core_begin(&i->core);
    return OK;
}

static Status get(Instance *i, const Reference vr[], size_t n, Real value[])
{
    size_t k;
    if (i->initialising && core_wrong(&i->core) < 0)
        core_begin(&i->core);
    for (k = 0; k < n; k++) {
        if (vr[k] > VARIABLES)
            return complain(i, "no variable has the value reference %u", vr[k]);
        value[k] = vr[k] < VARIABLES ? i->core.r[vr[k]] : i->start_s + i->core.time_s;
    }
    return OK;
}

static Status set(Instance *i, const Reference vr[], size_t n, const Real value[])
{
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

static Status go(Instance *i, Real time, Real step)
{
    if (i->failed || !i->core.begun)
        return complain(i, "a step before the initialisation, or after an error");
    if (!(step > 0.0) || step > 10.0)
        return complain(i, "a step of %g s, expected more than 0 and at most 10", step);
    if (in_bounds(i) != OK)
        return ERROR;
    if (core_step(&i->core, time - i->start_s, step) && !i->core.forgot)
        return OK;
    i->failed = 1;
    if (i->core.forgot)
        return complain(i, "the motor torque is %g s late and %d steps of it are kept: "
                        "take steps of %.3g s or more", LATE_S, HISTORY, LATE_S / (HISTORY - 2));
    return complain(i, "the motion is no number any more after %g s", time + step);
}

static Status keep(Instance *i, void **state)
{
    if (!*state)
        *state = malloc(KEPT);
    if (!*state)
        return complain(i, "no memory for the state");
    memcpy(*state, i, KEPT);
    return OK;
}

static Status restore(Instance *i, const void *state)
{
    memcpy(i, state, KEPT);
    return OK;
}

static Status forget(void **state)
{
    free(*state);
    *state = NULL;
    return OK;
}

static Status write_down(Instance *i, const void *state, void *bytes, size_t size)
{
    if (size < KEPT)
        return complain(i, "too little room for the state");
    memcpy(bytes, state, KEPT);
    return OK;
}

static Status read_back(Instance *i, const void *bytes, size_t size, void **state)
{
    if (size != KEPT)
        return complain(i, "a state of another model");
    if (!*state)
        *state = malloc(KEPT);
    if (!*state)
        return complain(i, "no memory for the state");
    memcpy(*state, bytes, KEPT);
    return OK;
}
