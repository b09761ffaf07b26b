/* What both versions of FMI have: REALS numbers in one array, of which those from OUTPUTS on are computed and the PARAMETERS
   before these stay within ranges; then the time, where it HAS_TIME as a variable. `fmuStart`, `fmuOutput`, `fmuStep` and
   `fmuSlope` stand before this. */

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
    int stale;   /* outputs are to be computed */
    void *whole; /* the memory in which this lies, where its vectors may */
} Core;

static void begin(Core *s)
{
    memset(&s->part, 0, sizeof s->part);
    memcpy(s->real, STARTS, sizeof s->real);
    s->time = 0, s->stale = 1;
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
        if (at[i] >= first && !(value[i] >= LEAST[at[i] - first] && value[i] <= MOST[at[i] - first]))
            return "the parameter is outside its range in modelDescription.xml";
#endif
        s->real[at[i]] = value[i];
    }
    s->stale = 1;
    return NULL;
}

/* Steps of DT each; what is no whole number of them is refused. */
static const char *advance(Core *s, double now, double length)
{
    double steps = floor(length / DT + 0.5);
    if (!(steps >= 1 && steps < 1e6 && fabs(length - steps * DT) <= 1e-6 * DT))
        return "the step must be a whole number of the step size in modelDescription.xml";
    for (int i = 0; i < (int)steps; i++)
        fmuStep(&s->part, s->real);
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
