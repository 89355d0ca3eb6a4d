/* FMI 2.0 for co-simulation around @P@.h. Value references: q from 0, qd from @DOF@,
   qdd from 2 * @DOF@, tau from 3 * @DOF@. A step computes the torque of the inputs that
   were set before it. */
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

typedef struct {
    double value[ALL];
    @P@_memory memory;
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
    @P@_start(&own->memory);
}

static void compute(instance *own, double t)
{
    double *v = own->value;
    @P@_torque(&own->memory, t, v, v + @DOF@, v + 2 * @DOF@, v + 3 * @DOF@);
}

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }

FMI fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid,
    fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
    fmi2Boolean logging)
{
    UNUSED(name), UNUSED(resources), UNUSED(visible), UNUSED(logging);
    if (type != 1 || strcmp(guid, "@GUID@") != 0) return NULL;
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
    const instance *own = c;
    for (size_t i = 0; i < n; i++) {
        if (r[i] >= ALL) return ERROR;
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
        own->value[r[i]] = value[i];
    }
    return OK;
}

FMI fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real step, fmi2Boolean kept)
{
    UNUSED(step), UNUSED(kept);
    compute(c, t);
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
FMI fmi2Status fmi2CancelStep(fmi2Component c) { UNUSED(c); return ERROR; }
NOTHING(SetupExperiment, OK, ARG(fmi2Boolean) a, ARG(fmi2Real) b, ARG(fmi2Real) d,
    ARG(fmi2Boolean) e, ARG(fmi2Real) f)
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
NOTHING(SetRealInputDerivatives, ERROR, REFS, ARG(const fmi2Integer *) o,
    ARG(const fmi2Real *) v)
NOTHING(GetRealOutputDerivatives, ERROR, REFS, ARG(const fmi2Integer *) o,
    ARG(fmi2Real *) v)
NOTHING(GetStatus, DISCARD, ARG(int) k, ARG(fmi2Status *) v)
NOTHING(GetRealStatus, DISCARD, ARG(int) k, ARG(fmi2Real *) v)
NOTHING(GetIntegerStatus, DISCARD, ARG(int) k, ARG(fmi2Integer *) v)
NOTHING(GetBooleanStatus, DISCARD, ARG(int) k, ARG(fmi2Boolean *) v)
NOTHING(GetStringStatus, DISCARD, ARG(int) k, ARG(fmi2String *) v)
