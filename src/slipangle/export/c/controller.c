/* What all controllers have around their decision: memory, the caller's clock, the deadline, health. */

#define STARTED 0x51195a17 /* of memory that car_start has made a controller of */

typedef struct {
    int64_t started;
    double seconds; /* deadline [s] */
    car_seconds begun; /* when the plan began */
    car_seconds (*clock)(void *);
    void *clock_of;
    int64_t health[6]; /* as car_health */
} Around;

static double elapsed(void *controller);

@DECISION@
typedef char car_bytes_are_enough[sizeof(Controller) <= CAR_BYTES ? 1 : -1];

#ifndef NEEDED
#define NEEDED sizeof(Controller)
#endif

static Controller *own(car_controller *c) { return (Controller *)(void *)c->memory; }

static car_seconds clock_of(const Around *a) { return a->clock ? a->clock(a->clock_of) : 0; }

/* Since the plan began [s]; small numbers are exact in single precision too. */
static double elapsed(void *controller)
{
    const Around *a = &((const Controller *)controller)->around;
    return (double)(clock_of(a) - a->begun);
}

int car_start(car_controller *memory, size_t bytes)
{
    Controller *c = own(memory);
    if (bytes < NEEDED)
        return CAR_TOO_SMALL;
    if ((uintptr_t)c % ALIGNED)
        return CAR_MISALIGNED;
    memset(c, 0, sizeof *c);
    c->around.seconds = INFINITY;
    int code = set_up(c);
    c->around.started = code == CAR_OK ? STARTED : 0;
    return code;
}

void car_deadline(car_controller *memory, int iterations, car_seconds seconds, car_seconds (*clock)(void *), void *of)
{
    Controller *c = own(memory);
    c->around.clock = clock, c->around.clock_of = of;
    c->around.seconds = !clock || (seconds >= 0 && seconds <= 0) ? INFINITY : seconds > 0 ? (double)seconds : 0;
    set_bound(c, iterations);
}

static void count(Around *a, int fell, int anew, double took)
{
    int late = took > a->seconds;
    a->health[0]++;
    a->health[1] += fell;
    a->health[2] = fell ? a->health[2] + 1 : 0;
    a->health[3] += late;
    a->health[4] = late ? a->health[4] + 1 : 0;
    a->health[5] += anew;
}

/* What is said before car_start: inputs stay where they are, as a fallback, and nothing is known of what follows. */
static int say_nothing(const car_input *in, car_output *out)
{
    memset(out, 0, sizeof *out);
    applied_before(NULL, in, out->command);
    for (int i = 0; i < CAR_HORIZON; i++)
        memcpy(out->u[i], out->command, sizeof out->command);
    for (int i = 0; i < CAR_NODES; i++)
        for (int a = 0; a < CAR_STATES; a++)
            out->x[i][a] = NAN;
#if CAR_DECIDED > 0
    for (int i = 0; i < CAR_DECIDED; i++)
        out->decided[i] = NAN;
#endif
    out->cost = out->residual = out->violation = NAN;
    out->age = out->stopping = 1;
    return out->status = CAR_NOT_STARTED;
}

int car_plan(car_controller *memory, const car_input *in, car_output *out)
{
    Controller *c = own(memory);
    if (c->around.started != STARTED)
        return say_nothing(in, out);
    c->around.begun = clock_of(&c->around);
    out->begun_anew = 0;
    int status = decide(c, in, out);
    c->plans = 1;
    double took = elapsed(c);
    count(&c->around, c->age > 0, out->begun_anew, took);
    memcpy(out->command, c->u, sizeof out->command);
    memcpy(out->u, c->u, sizeof c->u);
    out->status = status, out->age = c->age, out->stopping = c->stopping, out->seconds = took;
    out->health.plans = c->around.health[0];
    out->health.fallbacks = c->around.health[1], out->health.fallbacks_in_a_row = c->around.health[2];
    out->health.overruns = c->around.health[3], out->health.overruns_in_a_row = c->around.health[4];
    out->health.begun_anew = c->around.health[5];
    return status;
}
