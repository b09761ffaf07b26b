/* What all controllers have around their decision: memory, the caller's clock, the deadline, health. */

typedef struct {
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
    return set_up(c);
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

int car_plan(car_controller *memory, const car_input *in, car_output *out)
{
    Controller *c = own(memory);
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
