/* The controller around the steering law: what it is given is judged, and where there is no angle the wheels stay where
   they are. The same decisions as those of `PathFollower.plan`. */

typedef struct {
    double u[CAR_HORIZON], last;
    double seconds;
    int64_t health[5];
    double (*clock)(void *);
    void *clock_of;
    int plans, age;
} Controller;

typedef char car_bytes_are_enough[sizeof(Controller) <= CAR_BYTES ? 1 : -1];

static Controller *own(car_controller *c) { return (Controller *)(void *)c->memory; }

int car_start(car_controller *memory, size_t bytes)
{
    Controller *c = own(memory);
    if (bytes < sizeof(Controller))
        return CAR_TOO_SMALL;
    if ((uintptr_t)c % sizeof(double))
        return CAR_MISALIGNED;
    memset(c, 0, sizeof *c);
    c->seconds = INFINITY;
    return CAR_OK;
}

/* A law has no iterations; a clock counts overruns. */
void car_deadline(car_controller *memory, int iterations, double seconds, double (*clock)(void *), void *of)
{
    Controller *c = own(memory);
    (void)iterations;
    c->clock = clock, c->clock_of = of;
    c->seconds = clock && seconds > 0 ? seconds : INFINITY;
}

static double within(double v, double low, double high)
{
    double raised = v > low ? v : low;
    return raised < high ? raised : high;
}

/* Whether rows lie within the ranges of their columns, and whether all are numbers. */
static int judged(const double *v, int rows, int n, const double *low, const double *high, int *finite)
{
    int good = 1;
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < n; j++) {
            good &= v[i * n + j] >= low[j] && v[i * n + j] <= high[j];
            *finite &= fabs(v[i * n + j]) <= 1e150;
        }
    return good;
}

static int fault(const car_input *in)
{
    int finite = 1, nx = CAR_STATES, np = CAR_REFERENCES;
    int good = judged(in->x, 1, nx, LOWEST, HIGHEST, &finite);
    good &= judged(in->tracked[0], CAR_NODES, np, LOWEST + nx, HIGHEST + nx, &finite);
    good &= judged(in->exogenous[0], CAR_EXOGENOUS_ROWS, 1, LOWEST + nx + np, HIGHEST + nx + np, &finite);
    return good ? CAR_SOLVED : finite ? CAR_IMPLAUSIBLE : CAR_NOT_FINITE;
}

int car_plan(car_controller *memory, const car_input *in, car_output *out)
{
    Controller *c = own(memory);
    double begin = c->clock ? c->clock(c->clock_of) : 0, said = in->applied[0];
    int believed = in->applied_known && fabs(said) <= 1e12, status = fault(in);
    double before = within(believed ? said : c->plans ? c->u[0] : 0.0, -LIMIT, LIMIT), angle = before, last = before;
    if (status == CAR_SOLVED) {
        double road = steer(in->x, in->tracked, in->exogenous[0][0], GAIN * (before - OFFSET));
        angle = road / GAIN + OFFSET;
        if (!(fabs(angle) < INFINITY))
            angle = before, status = CAR_FAILED;
    }
    for (int i = 0; i < CAR_HORIZON; i++) {
        double moved = within(angle, last - MOST, last + MOST);
        c->u[i] = last = within(moved, -LIMIT, LIMIT);
        out->u[i][0] = last;
    }
    for (int i = 0; i < CAR_NODES; i++)
        for (int a = 0; a < CAR_STATES; a++)
            out->x[i][a] = fabs(in->x[a]) < 1e150 ? in->x[a] : 0;
    int fell = status != CAR_SOLVED;
    c->age = fell ? c->age + 1 : 0;
    c->plans = 1;
    double took = (c->clock ? c->clock(c->clock_of) : 0) - begin;
    int late = took > c->seconds;
    c->health[0]++;
    c->health[1] += fell;
    c->health[2] = fell ? c->health[2] + 1 : 0;
    c->health[3] += late;
    c->health[4] = late ? c->health[4] + 1 : 0;
    out->command[0] = c->u[0];
    out->status = status, out->age = c->age, out->stopping = 0, out->iterations = 0;
    out->cost = out->residual = out->violation = NAN, out->seconds = took;
    out->health.plans = c->health[0];
    out->health.fallbacks = c->health[1], out->health.fallbacks_in_a_row = c->health[2];
    out->health.overruns = c->health[3], out->health.overruns_in_a_row = c->health[4];
    return status;
}
