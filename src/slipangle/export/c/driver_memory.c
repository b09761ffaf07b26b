/* What drivers and racers do alike with their memory, the planner's clock, a state and the path. */

#define WINDOW 15 /* m around the last place on the path, in which the next one is looked for */
#define LATEST ((car_seconds)1e10)
#define STARTED 0x51195a17 /* of memory that car_start has made a driver of */
#define TOGETHER ((car_seconds)1e-9)

typedef char car_bytes_are_enough[sizeof(Driver) <= CAR_BYTES ? 1 : -1];

static Driver *own(car_driver *memory)
{
    Driver *d = (Driver *)(void *)memory->memory;
#ifdef HORIZON
    d->filter.past.solver = &memory->window;
#endif
    return d;
}

/* What there is to be done where nothing is known. */
static void say_nothing(car_commands *c)
{
    memset(c, 0, sizeof *c);
    c->reason = CAR_LOST;
    for (int a = 0; a < NX; a++)
        c->state_std[a] = INFINITY;
    for (int i = 0; i < NY; i++)
        c->age[i] = NAN;
}

/* Whether car_start has made a driver of the memory; else that is said. */
static int begun_with(const Driver *d, car_commands *c)
{
    if (d->started != STARTED)
        say_nothing(c);
    return d->started == STARTED;
}

static double within(double v, double low, double high)
{
    double raised = low > v ? low : v;
    return high < raised ? high : raised;
}

void car_deadline(car_driver *memory, int iterations, car_seconds seconds, car_seconds (*clock)(void *), void *of)
{
    Driver *d = own(memory);
    d->iterations = iterations, d->seconds = (double)seconds, d->clock = clock, d->of = of;
    car_planner_deadline(&memory->planner, iterations, seconds, clock, of);
}

const car_planner_output *car_last_plan(const car_driver *memory)
{
    return &((const Driver *)(const void *)memory->memory)->plan;
}

/* A planner that knows of no plan before. */
static void plan_anew(car_driver *memory, const Driver *d)
{
    (void)car_planner_start(&memory->planner, sizeof memory->planner);
    car_planner_deadline(&memory->planner, d->iterations, d->seconds, d->clock, d->of);
}

/* Whether a call may be at this time. */
static int in_order(const Driver *d, car_seconds t)
{
    return t >= -LATEST && t <= LATEST && !(d->begun && t < d->now - TOGETHER);
}

static int plausible(const double *x)
{
    int all = 1;
    for (int a = 0; a < NX; a++)
        all &= x[a] >= STATE_LOW[a] && x[a] <= STATE_HIGH[a];
    return all;
}

/* Finds the place on the path, how far to its left a point is and the heading there: [m, m, rad]. */
static void project(Driver *d, double X, double Y, double *found)
{
    int near = is_finite(d->s);
    foot(LINE, SHAPE, SIZE, X, Y, near ? d->s : 0, near ? WINDOW : -1, found);
    d->s = found[0];
}

/* The state and how sure it is. */
static void say_state(const Driver *d, car_commands *c)
{
    for (int a = 0; a < NX; a++) {
        c->state[a] = d->filter.now.z[a];
        c->state_std[a] = sqrt(d->filter.now.P[a * NZ + a]);
    }
}

/* How the last plan was found, if there is one. */
static void say_plan(const Driver *d, car_commands *c)
{
    c->planned = d->planned;
    if (d->planned) {
        c->status = d->plan.status, c->plan_age = d->plan.age, c->stopping = d->plan.stopping;
        c->health = d->plan.health;
    }
}
