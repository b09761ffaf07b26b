/* FMI 3.0 for co-simulation. Types and functions as in the standard, without its files. */

#include <stdbool.h>
#include <stdlib.h>

typedef void *fmi3Instance, *fmi3InstanceEnvironment, *fmi3FMUState;
typedef unsigned int fmi3ValueReference;
typedef float fmi3Float32;
typedef double fmi3Float64;
typedef bool fmi3Boolean, fmi3Clock;
typedef const char *fmi3String;
typedef uint8_t fmi3Byte;
typedef const fmi3Byte *fmi3Binary;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef int fmi3DependencyKind, fmi3IntervalQualifier;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3Callback)(void);

typedef struct {
    Core core; /* first, as it may hold vectors */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Instance;

static fmi3Status said(fmi3Instance c, fmi3Status status, const char *category, const char *sentence)
{
    Instance *s = c;
    if (s->log)
        s->log(s->environment, status, category, sentence);
    return status;
}

static fmi3Status ended(fmi3Instance c, const char *wrong)
{
    return wrong ? said(c, fmi3Error, "logStatusError", wrong) : fmi3OK;
}

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }

EXPORTED fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi3OK;
}

EXPORTED fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                                  fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events,
                                                  fmi3Boolean early, const fmi3ValueReference wanted[], size_t n,
                                                  fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                  fmi3Callback update)
{
    (void)name, (void)resources, (void)visible, (void)logging, (void)early, (void)wanted, (void)update;
    if (!token || strcmp(token, GUID) != 0 || events || n)
        return NULL;
    void *whole = calloc(1, sizeof(Instance) + 64);
    if (!whole)
        return NULL;
    Instance *s = aligned(whole);
    s->core.whole = whole, s->environment = environment, s->log = log;
    begin(&s->core);
    return s;
}

EXPORTED fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
                                                   fmi3Boolean visible, fmi3Boolean logging,
                                                   fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return NULL;
}

EXPORTED fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources,
                                                        fmi3Boolean visible, fmi3Boolean logging,
                                                        fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                                        fmi3Callback update, fmi3Callback lock, fmi3Callback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)update, (void)lock, (void)unlock;
    return NULL;
}

EXPORTED void fmi3FreeInstance(fmi3Instance c)
{
    if (c)
        free(((Instance *)c)->core.whole);
}

EXPORTED fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean defined, fmi3Float64 tolerance,
                                                fmi3Float64 start, fmi3Boolean ends, fmi3Float64 stop)
{
    (void)defined, (void)tolerance, (void)ends, (void)stop;
    ((Instance *)c)->core.time = start;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3Reset(fmi3Instance c)
{
    begin(&((Instance *)c)->core);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference at[], size_t n, fmi3Float64 value[], size_t m)
{
    return ended(c, n == m ? get(&((Instance *)c)->core, at, n, value) : "fmi3GetFloat64: there are no arrays");
}

EXPORTED fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference at[], size_t n, const fmi3Float64 value[],
                                   size_t m)
{
    return ended(c, n == m ? set(&((Instance *)c)->core, at, n, value) : "fmi3SetFloat64: there are no arrays");
}

EXPORTED fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 length, fmi3Boolean no_way_back,
                               fmi3Boolean *events, fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last)
{
    Core *s = &((Instance *)c)->core;
    const char *doubt, *wrong = advance(s, now, length, &doubt);
    (void)no_way_back;
    *events = *terminate = *early = false, *last = s->time;
    return !wrong && doubt ? said(c, fmi3Warning, "logStatusWarning", doubt) : ended(c, wrong);
}

EXPORTED fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference of[], size_t m,
                                                 const fmi3ValueReference by[], size_t n, const fmi3Float64 d[],
                                                 size_t n_d, fmi3Float64 to[], size_t n_to)
{
    if (n != n_d || m != n_to)
        return ended(c, "fmi3GetDirectionalDerivative: there are no arrays");
    return ended(c, slope(&((Instance *)c)->core, of, m, by, n, d, to));
}

/* ---- state ---- */

EXPORTED fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    if (!*state) {
        void *whole = calloc(1, sizeof(Core) + 64);
        if (!whole)
            return ended(c, "fmi3GetFMUState: no memory");
        Core *made = aligned(whole);
        made->whole = whole;
        *state = made;
    }
    keep(*state, &((Instance *)c)->core);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    keep(&((Instance *)c)->core, state);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
    (void)c;
    if (*state)
        free(((Core *)*state)->whole);
    *state = NULL;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size)
{
    (void)c, (void)state;
    *size = KEPT;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    if (size < KEPT)
        return ended(c, "fmi3SerializeFMUState: too few bytes");
    write_out((char *)bytes, state);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    if (!is_own((const char *)bytes, size))
        return ended(c, "fmi3DeserializeFMUState: these are not the bytes of a state of this FMU");
    fmi3Status status = *state ? fmi3OK : fmi3GetFMUState(c, state);
    if (status != fmi3OK)
        return status;
    read_in(*state, (const char *)bytes);
    return fmi3OK;
}

/* ---- what there is nothing to do for ---- */

#define NOTHING(name) \
    EXPORTED fmi3Status fmi3##name(fmi3Instance c) { return c ? fmi3OK : fmi3Error; }
NOTHING(ExitInitializationMode)
NOTHING(Terminate)
NOTHING(EnterStepMode)
NOTHING(EnterConfigurationMode)
NOTHING(ExitConfigurationMode)

/* ---- what there is none of ---- */

#define WITHOUT(type, kind)                                                                                          \
    EXPORTED fmi3Status fmi3Get##type(fmi3Instance c, const fmi3ValueReference at[], size_t n, kind value[], size_t m) \
    {                                                                                                                \
        (void)at, (void)value, (void)m;                                                                              \
        return ended(c, n ? "all variables are of type Float64" : NULL);                                             \
    }                                                                                                                \
    EXPORTED fmi3Status fmi3Set##type(fmi3Instance c, const fmi3ValueReference at[], size_t n, const kind value[],     \
                                      size_t m)                                                                      \
    {                                                                                                                \
        (void)at, (void)value, (void)m;                                                                              \
        return ended(c, n ? "all variables are of type Float64" : NULL);                                             \
    }
WITHOUT(Float32, fmi3Float32)
WITHOUT(Int8, int8_t)
WITHOUT(UInt8, uint8_t)
WITHOUT(Int16, int16_t)
WITHOUT(UInt16, uint16_t)
WITHOUT(Int32, int32_t)
WITHOUT(UInt32, uint32_t)
WITHOUT(Int64, int64_t)
WITHOUT(UInt64, uint64_t)
WITHOUT(Boolean, fmi3Boolean)
WITHOUT(String, fmi3String)

#define NONE(name, ...)                                      \
    EXPORTED fmi3Status fmi3##name(fmi3Instance c, __VA_ARGS__) \
    {                                                        \
        return ended(c, "fmi3" #name ": there is no such thing here"); \
    }
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
typedef const fmi3ValueReference *References;
NONE(GetBinary, References at, size_t n, size_t sizes[], fmi3Binary value[], size_t m)
NONE(SetBinary, References at, size_t n, const size_t sizes[], const fmi3Binary value[], size_t m)
NONE(GetClock, References at, size_t n, fmi3Clock value[])
NONE(SetClock, References at, size_t n, const fmi3Clock value[])
NONE(GetNumberOfVariableDependencies, fmi3ValueReference at, size_t *n)
NONE(GetVariableDependencies, fmi3ValueReference at, size_t of[], fmi3ValueReference by[], size_t in[],
     fmi3DependencyKind kinds[], size_t n)
NONE(GetAdjointDerivative, References of, size_t m, References by, size_t n, const fmi3Float64 d[], size_t n_d,
     fmi3Float64 to[], size_t n_to)
NONE(GetOutputDerivatives, References at, size_t n, const int32_t order[], fmi3Float64 value[], size_t m)
NONE(GetIntervalDecimal, References at, size_t n, fmi3Float64 value[], fmi3IntervalQualifier kinds[])
NONE(GetIntervalFraction, References at, size_t n, uint64_t count[], uint64_t of[], fmi3IntervalQualifier kinds[])
NONE(GetShiftDecimal, References at, size_t n, fmi3Float64 value[])
NONE(GetShiftFraction, References at, size_t n, uint64_t count[], uint64_t of[])
NONE(SetIntervalDecimal, References at, size_t n, const fmi3Float64 value[])
NONE(SetIntervalFraction, References at, size_t n, const uint64_t count[], const uint64_t of[])
NONE(SetShiftDecimal, References at, size_t n, const fmi3Float64 value[])
NONE(SetShiftFraction, References at, size_t n, const uint64_t count[], const uint64_t of[])
NONE(UpdateDiscreteStates, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals, fmi3Boolean *values,
     fmi3Boolean *event, fmi3Float64 *next)
NONE(ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)
NONE(CompletedIntegratorStep, fmi3Boolean no_way_back, fmi3Boolean *event, fmi3Boolean *terminate)
NONE(SetTime, fmi3Float64 time)
NONE(SetContinuousStates, const fmi3Float64 x[], size_t n)
NONE(GetContinuousStates, fmi3Float64 x[], size_t n)
NONE(GetContinuousStateDerivatives, fmi3Float64 x[], size_t n)
NONE(GetNominalsOfContinuousStates, fmi3Float64 x[], size_t n)
NONE(GetEventIndicators, fmi3Float64 z[], size_t n)
NONE(GetNumberOfContinuousStates, size_t *n)
NONE(GetNumberOfEventIndicators, size_t *n)

EXPORTED fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return ended(c, "there is no model exchange"); }
EXPORTED fmi3Status fmi3EnterEventMode(fmi3Instance c) { return ended(c, "there are no events"); }
EXPORTED fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { return ended(c, "there are no events"); }
