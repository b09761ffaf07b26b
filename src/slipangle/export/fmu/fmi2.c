/* FMI 2.0 for co-simulation. Types and functions as in the standard, without its files. */

typedef void *fmi2Component, *fmi2ComponentEnvironment, *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer, fmi2Boolean;
typedef char fmi2Char, fmi2Byte;
typedef const fmi2Char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum { fmi2DoStepStatus, fmi2PendingStatus, fmi2LastSuccessfulTime, fmi2Terminated } fmi2StatusKind;

typedef struct {
    void (*logger)(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(fmi2ComponentEnvironment, fmi2Status);
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

#define NAMED 100
typedef struct {
    Core core; /* first, as it may hold vectors */
    const fmi2CallbackFunctions *callbacks;
    char name[NAMED];
} Instance;

static fmi2Status say(Instance *s, fmi2Status status, const char *sentence)
{
    if (s->callbacks->logger)
        s->callbacks->logger(s->callbacks->componentEnvironment, s->name, status,
                             status == fmi2Warning ? "logStatusWarning" : "logStatusError", sentence);
    return status;
}

EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }

EXPORTED fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return fmi2OK;
}

static fmi2Status ended(Instance *s, const char *wrong) { return wrong ? say(s, fmi2Error, wrong) : fmi2OK; }

EXPORTED fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                       const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    (void)resources, (void)visible, (void)logging;
    if (!callbacks || !callbacks->allocateMemory || !callbacks->freeMemory || type != fmi2CoSimulation || !guid ||
        strcmp(guid, GUID) != 0)
        return NULL;
    void *whole = callbacks->allocateMemory(1, sizeof(Instance) + 64);
    if (!whole)
        return NULL;
    Instance *s = aligned(whole);
    s->core.whole = whole, s->callbacks = callbacks;
    snprintf(s->name, NAMED, "%s", name ? name : "");
    begin(&s->core);
    return s;
}

EXPORTED void fmi2FreeInstance(fmi2Component c)
{
    Instance *s = c;
    if (s)
        s->callbacks->freeMemory(s->core.whole);
}

EXPORTED fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean defined, fmi2Real tolerance, fmi2Real start,
                                        fmi2Boolean ends, fmi2Real stop)
{
    (void)defined, (void)tolerance, (void)ends, (void)stop;
    ((Instance *)c)->core.time = start;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
EXPORTED fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return c ? fmi2OK : fmi2Error; }
EXPORTED fmi2Status fmi2Terminate(fmi2Component c) { return c ? fmi2OK : fmi2Error; }

EXPORTED fmi2Status fmi2Reset(fmi2Component c)
{
    begin(&((Instance *)c)->core);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Real value[])
{
    return ended(c, get(&((Instance *)c)->core, at, n, value));
}

EXPORTED fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Real value[])
{
    return ended(c, set(&((Instance *)c)->core, at, n, value));
}

EXPORTED fmi2Status fmi2DoStep(fmi2Component c, fmi2Real now, fmi2Real length, fmi2Boolean no_way_back)
{
    const char *doubt, *wrong = advance(&((Instance *)c)->core, now, length, &doubt);
    (void)no_way_back;
    return !wrong && doubt ? say(c, fmi2Warning, doubt) : ended(c, wrong);
}

EXPORTED fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference of[], size_t m,
                                                 const fmi2ValueReference by[], size_t n, const fmi2Real d[], fmi2Real to[])
{
    return ended(c, slope(&((Instance *)c)->core, of, m, by, n, d, to));
}

EXPORTED fmi2Status fmi2CancelStep(fmi2Component c) { return say(c, fmi2Error, "fmi2CancelStep: no step is pending"); }

/* ---- state ---- */

EXPORTED fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    Instance *s = c;
    if (!*state) {
        void *whole = s->callbacks->allocateMemory(1, sizeof(Core) + 64);
        if (!whole)
            return say(s, fmi2Error, "fmi2GetFMUstate: no memory");
        Core *made = aligned(whole);
        made->whole = whole;
        *state = made;
    }
    keep(*state, &s->core);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    keep(&((Instance *)c)->core, state);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (*state)
        ((Instance *)c)->callbacks->freeMemory(((Core *)*state)->whole);
    *state = NULL;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size)
{
    (void)c, (void)state;
    *size = KEPT;
    return fmi2OK;
}

EXPORTED fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    if (size < KEPT)
        return say(c, fmi2Error, "fmi2SerializeFMUstate: too few bytes");
    write_out(bytes, state);
    return fmi2OK;
}

EXPORTED fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    if (!is_own(bytes, size))
        return say(c, fmi2Error, "fmi2DeSerializeFMUstate: these are not the bytes of a state of this FMU");
    fmi2Status status = *state ? fmi2OK : fmi2GetFMUstate(c, state);
    if (status != fmi2OK)
        return status;
    read_in(*state, bytes);
    return fmi2OK;
}

/* ---- what there is none of ---- */

EXPORTED fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Integer value[])
{
    (void)at, (void)value;
    return n ? say(c, fmi2Error, "there are no integers") : fmi2OK;
}
EXPORTED fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2Boolean value[])
{
    (void)at, (void)value;
    return n ? say(c, fmi2Error, "there are no booleans") : fmi2OK;
}
EXPORTED fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference at[], size_t n, fmi2String value[])
{
    (void)at, (void)value;
    return n ? say(c, fmi2Error, "there are no strings") : fmi2OK;
}
EXPORTED fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Integer value[])
{
    (void)at, (void)value;
    return n ? say(c, fmi2Error, "there are no integers") : fmi2OK;
}
EXPORTED fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2Boolean value[])
{
    (void)at, (void)value;
    return n ? say(c, fmi2Error, "there are no booleans") : fmi2OK;
}
EXPORTED fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference at[], size_t n, const fmi2String value[])
{
    (void)at, (void)value;
    return n ? say(c, fmi2Error, "there are no strings") : fmi2OK;
}
EXPORTED fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference at[], size_t n,
                                                const fmi2Integer order[], const fmi2Real value[])
{
    (void)at, (void)order, (void)value;
    return n ? say(c, fmi2Error, "inputs are held over a step") : fmi2OK;
}
EXPORTED fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference at[], size_t n,
                                                 const fmi2Integer order[], fmi2Real value[])
{
    (void)at, (void)order, (void)value;
    return n ? say(c, fmi2Error, "outputs have no derivatives") : fmi2OK;
}
EXPORTED fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
EXPORTED fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = ((Instance *)c)->core.time;
    return fmi2OK;
}
EXPORTED fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
EXPORTED fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
EXPORTED fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value)
{
    (void)c, (void)kind, (void)value;
    return fmi2Discard;
}
