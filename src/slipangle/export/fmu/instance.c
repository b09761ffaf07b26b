/* What both versions of FMI have: REALS numbers in one array, of which those from OUTPUTS on are computed and the PARAMETERS
   before these stay within ranges, and of which DOUBTS are said if they do not go together; then the time, where it HAS_TIME
   as a variable. `fmuStart`, `fmuOutput`, `fmuStep`, which says whether it led to numbers, `fmuSlope` and `fmuDoubt` stand
   before this. */

#include <stdio.h>

#if defined _WIN32
#define EXPORTED __declspec(dllexport)
#elif defined __GNUC__
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

typedef struct {
    Part part; /* first, as it may hold vectors */
    double real[REALS];
    double time;
    int stale;       /* outputs are to be computed */
    int changed;     /* parameters are, since it was last asked whether they go together */
    void *whole;     /* the memory in which this lies, where its vectors may */
    char said[160];  /* the last sentence with numbers */
} Core;

#define KEPT (sizeof(GUID) + sizeof(Core)) /* bytes of a state that is written out, after whose state it is */

static void begin(Core *s)
{
    memset(&s->part, 0, sizeof s->part);
    memcpy(s->real, STARTS, sizeof s->real);
    s->time = 0, s->stale = 1, s->changed = 0;
    fmuStart(&s->part);
}

/* Where in memory with 64 bytes to spare an object begins. */
static void *aligned(void *whole) { return (char *)whole + (64 - (uintptr_t)whole % 64); }

/* What goes wrong, or nothing. */
static const char *get(Core *s, const unsigned int *at, size_t n, double *value)
{
    if (s->stale)
        fmuOutput(&s->part, s->real);
    s->stale = 0;
    for (size_t i = 0; i < n; i++) {
        if (at[i] >= REALS + HAS_TIME)
            return "there is no such variable";
        value[i] = at[i] == REALS ? s->time : s->real[at[i]];
    }
    return NULL;
}

static const char *set(Core *s, const unsigned int *at, size_t n, const double *value)
{
    for (size_t i = 0; i < n; i++) {
        if (at[i] >= OUTPUTS)
            return "outputs cannot be set";
#if PARAMETERS > 0
        unsigned int first = OUTPUTS - PARAMETERS;
        double low = at[i] >= first ? LEAST[at[i] - first] : 0, high = at[i] >= first ? MOST[at[i] - first] : 0;
        if (at[i] >= first && !(value[i] >= low && value[i] <= high)) {
            snprintf(s->said, sizeof s->said, "the parameter of value reference %u is %g; expected %g to %g, as in "
                     "modelDescription.xml: nothing was set", at[i], value[i], low, high);
            return s->said;
        }
#endif
    }
    for (size_t i = 0; i < n; i++) {
        s->real[at[i]] = value[i];
        s->changed |= at[i] >= OUTPUTS - PARAMETERS;
    }
    s->stale = 1;
    return NULL;
}

/* Steps of DT each, all or none: what is no whole number of them, or leads to states that are no numbers, is refused. `doubt`
   is where the step does not go on from where the one before ended, else what is wrong with parameters that were changed. */
static const char *advance(Core *s, double now, double length, const char **doubt)
{
    double before[REALS], steps = floor(length / DT + 0.5);
    *doubt = NULL;
    if (!(steps >= 1 && steps < 1e6 && fabs(length - steps * DT) <= 1e-6 * DT)) {
        snprintf(s->said, sizeof s->said, "the step is %g s; expected a whole number of %g s, the step size in "
                 "modelDescription.xml", length, DT);
        return s->said;
    }
    memcpy(before, s->real, sizeof before);
    for (int i = 0; i < (int)steps; i++)
        if (!fmuStep(&s->part, s->real)) {
            memcpy(s->real, before, sizeof before);
            return "the step leads to states that are no finite numbers, so it was not taken: check inputs, states and "
                   "parameters";
        }
    if (!(fabs(now - s->time) <= 0.5 * DT)) {
        snprintf(s->said, sizeof s->said, "the step begins at %.9g s, the FMU was at %.9g s: it was taken from the state there",
                 now, s->time);
        *doubt = s->said;
    }
#if DOUBTS > 0
    else if (s->changed) /* a parameter at a time is set, of which two may belong together */
        *doubt = fmuDoubt(s->real), s->changed = 0;
#endif
    s->time = now + length, s->stale = 1;
    return NULL;
}

/* Change of the outputs `of` along a change of the variables `by`. */
static const char *slope(Core *s, const unsigned int *of, size_t m, const unsigned int *by, size_t n, const double *change,
                         double *to)
{
    double along[REALS] = {0}, made[REALS] = {0};
    for (size_t i = 0; i < n; i++) {
        if (by[i] >= OUTPUTS)
            return "derivatives are by inputs, parameters and states";
        along[by[i]] += change[i];
    }
    if (!fmuSlope(&s->part, s->real, along, made))
        return "there are no directional derivatives";
    for (size_t i = 0; i < m; i++) {
        if (of[i] < OUTPUTS || of[i] >= REALS)
            return "derivatives are those of outputs";
        to[i] = made[of[i] - OUTPUTS];
    }
    return NULL;
}

static void keep(Core *to, const Core *from)
{
    void *whole = to->whole;
    *to = *from;
    to->whole = whole;
}

static void write_out(char *bytes, const Core *from)
{
    const void *nowhere = NULL;
    memcpy(bytes, GUID, sizeof(GUID));
    memcpy(bytes + sizeof(GUID), from, sizeof *from);
    memcpy(bytes + sizeof(GUID) + offsetof(Core, whole), &nowhere, sizeof nowhere);
}

static int is_own(const char *bytes, size_t size) { return size == KEPT && memcmp(bytes, GUID, sizeof(GUID)) == 0; }

static void read_in(Core *to, const char *bytes)
{
    void *whole = to->whole;
    memcpy(to, bytes + sizeof(GUID), sizeof *to);
    to->whole = whole;
}
