/* FMI 2.0 around @P@.h, for model exchange and co-simulation. Value references: q from
   0, qd from @DOF@, qdd from 2 * @DOF@, tau from 3 * @DOF@. A torque is that of the
   inputs at the time at which it is read: nothing is a step late. What depends on the
   past remembers a time once, by its last inputs, when the time is over. */
#include <stddef.h>
#include <string.h>
#include "@P@.h"

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean, fmi2Status;
typedef const char *fmi2String;
typedef void *fmi2FMUstate;
typedef char fmi2Byte;
typedef struct {
    void (*logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;

enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING };
enum { INPUTS = 3 * @DOF@, ALL = 4 * @DOF@ };
enum { MODEL_EXCHANGE, CO_SIMULATION };

typedef struct {
    double value[ALL], rate[INPUTS], time;
    @P@_memory before, after; /* what is remembered without this time, and with it */
    int known; /* the torque is that of the inputs */
    int kept; /* this time is remembered */
    void (*freeMemory)(void *);
} instance;

#if defined(_WIN32)
#define FMI __declspec(dllexport)
#else
#define FMI __attribute__((visibility("default")))
#endif
#define UNUSED(x) (void)(x)

static void forget(instance *own)
{
    for (int i = 0; i < ALL; i++) own->value[i] = 0.0;
    for (int i = 0; i < INPUTS; i++) own->rate[i] = 0.0;
    own->time = 0.0;
    own->known = own->kept = 0;
    @P@_start(&own->before);
}

static void compute(instance *own)
{
    double *v = own->value;
    if (own->known) return;
    own->after = own->before;
    @P@_torque(&own->after, own->time, v, v + @DOF@, v + 2 * @DOF@, v + 3 * @DOF@);
    own->known = 1;
}

static void keep(instance *own)
{
    if (own->kept) return;
    compute(own);
    own->before = own->after;
    own->kept = 1;
}

static void go_to(instance *own, double t)
{
    own->time = t;
    own->known = own->kept = 0;
}

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }

FMI fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid,
    fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
    fmi2Boolean logging)
{
    UNUSED(name), UNUSED(resources), UNUSED(visible), UNUSED(logging);
    if (type > CO_SIMULATION || strcmp(guid, "@GUID@") != 0) return NULL;
    instance *own = functions->allocateMemory(1, sizeof *own);
    if (own == NULL) return NULL;
    own->freeMemory = functions->freeMemory;
    forget(own);
    return own;
}

FMI void fmi2FreeInstance(fmi2Component c)
{
    if (c != NULL) ((instance *)c)->freeMemory(c);
}

FMI fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
    fmi2Real value[])
{
    instance *own = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= ALL) return ERROR;
        if (r[i] >= INPUTS) compute(own);
        value[i] = own->value[r[i]];
    }
    return OK;
}

FMI fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n,
    const fmi2Real value[])
{
    instance *own = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= INPUTS) return ERROR;
        if (own->value[r[i]] != value[i]) own->known = 0;
        own->value[r[i]] = value[i];
    }
    return OK;
}

FMI fmi2Status fmi2SetRealInputDerivatives(fmi2Component c,
    const fmi2ValueReference r[], size_t n, const fmi2Integer order[],
    const fmi2Real value[])
{
    instance *own = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= INPUTS || order[i] != 1) return ERROR;
        own->rate[r[i]] = value[i];
    }
    return OK;
}

FMI fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance,
    fmi2Real tolerance, fmi2Real start, fmi2Boolean has_stop, fmi2Real stop)
{
    UNUSED(has_tolerance), UNUSED(tolerance), UNUSED(has_stop), UNUSED(stop);
    ((instance *)c)->time = start;
    return OK;
}

/* At the end of a step the inputs are what their rates have made of them; without rates
   they are as they were, until others are set. */
FMI fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real step, fmi2Boolean rest)
{
    instance *own = c;
    UNUSED(rest);
    if (t != own->time && !own->kept) own->time = t, own->known = 0;
    keep(own);
    for (int i = 0; i < INPUTS; i++) {
        own->value[i] += step * own->rate[i];
        own->rate[i] = 0.0;
    }
    go_to(own, t + step);
    return OK;
}

/* Of the times that a solver tries, those are remembered that it takes; and the first. */
FMI fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t)
{
    go_to(c, t);
    return OK;
}

FMI fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) { keep(c); return OK; }

FMI fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final,
    fmi2Boolean *event, fmi2Boolean *stop)
{
    UNUSED(final);
    keep(c);
    *event = *stop = 0;
    return OK;
}

typedef struct {
    fmi2Boolean newDiscreteStatesNeeded, terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged, valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

FMI fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    UNUSED(c);
    memset(info, 0, sizeof *info);
    return OK;
}

FMI fmi2Status fmi2Reset(fmi2Component c) { forget(c); return OK; }

/* What there is nothing to do for, or nothing of. */
#define NOTHING(name, result, ...) \
    FMI fmi2Status fmi2##name(fmi2Component c, __VA_ARGS__) { UNUSED(c); return result; }
#define PLAIN(name) FMI fmi2Status fmi2##name(fmi2Component c) { UNUSED(c); return OK; }
#define REFS const fmi2ValueReference r[] __attribute__((unused)), \
    size_t n __attribute__((unused))
#define ARG(type) type __attribute__((unused))

PLAIN(EnterInitializationMode)
PLAIN(ExitInitializationMode)
PLAIN(Terminate)
PLAIN(EnterEventMode)
FMI fmi2Status fmi2CancelStep(fmi2Component c) { UNUSED(c); return ERROR; }
NOTHING(SetContinuousStates, n ? ERROR : OK, ARG(const fmi2Real *) x, ARG(size_t) n)
NOTHING(GetContinuousStates, n ? ERROR : OK, ARG(fmi2Real *) x, ARG(size_t) n)
NOTHING(GetNominalsOfContinuousStates, n ? ERROR : OK, ARG(fmi2Real *) x,
    ARG(size_t) n)
NOTHING(GetDerivatives, n ? ERROR : OK, ARG(fmi2Real *) x, ARG(size_t) n)
NOTHING(GetEventIndicators, n ? ERROR : OK, ARG(fmi2Real *) x, ARG(size_t) n)
NOTHING(SetDebugLogging, OK, ARG(fmi2Boolean) a, ARG(size_t) b,
    ARG(const fmi2String *) d)
NOTHING(GetInteger, n ? ERROR : OK, REFS, ARG(fmi2Integer *) v)
NOTHING(GetBoolean, n ? ERROR : OK, REFS, ARG(fmi2Boolean *) v)
NOTHING(GetString, n ? ERROR : OK, REFS, ARG(fmi2String *) v)
NOTHING(SetInteger, n ? ERROR : OK, REFS, ARG(const fmi2Integer *) v)
NOTHING(SetBoolean, n ? ERROR : OK, REFS, ARG(const fmi2Boolean *) v)
NOTHING(SetString, n ? ERROR : OK, REFS, ARG(const fmi2String *) v)
NOTHING(GetFMUstate, ERROR, ARG(fmi2FMUstate *) s)
NOTHING(SetFMUstate, ERROR, ARG(fmi2FMUstate) s)
NOTHING(FreeFMUstate, ERROR, ARG(fmi2FMUstate *) s)
NOTHING(SerializedFMUstateSize, ERROR, ARG(fmi2FMUstate) s, ARG(size_t *) n)
NOTHING(SerializeFMUstate, ERROR, ARG(fmi2FMUstate) s, ARG(fmi2Byte *) b, ARG(size_t) n)
NOTHING(DeSerializeFMUstate, ERROR, ARG(const fmi2Byte *) b, ARG(size_t) n,
    ARG(fmi2FMUstate *) s)
NOTHING(GetDirectionalDerivative, ERROR, REFS, ARG(const fmi2ValueReference *) k,
    ARG(size_t) m, ARG(const fmi2Real *) x, ARG(fmi2Real *) y)
NOTHING(GetRealOutputDerivatives, ERROR, REFS, ARG(const fmi2Integer *) o,
    ARG(fmi2Real *) v)
NOTHING(GetStatus, DISCARD, ARG(int) k, ARG(fmi2Status *) v)
NOTHING(GetRealStatus, DISCARD, ARG(int) k, ARG(fmi2Real *) v)
NOTHING(GetIntegerStatus, DISCARD, ARG(int) k, ARG(fmi2Integer *) v)
NOTHING(GetBooleanStatus, DISCARD, ARG(int) k, ARG(fmi2Boolean *) v)
NOTHING(GetStringStatus, DISCARD, ARG(int) k, ARG(fmi2String *) v)
