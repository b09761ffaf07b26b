/* The controller around the steering law: what it is given is judged, and where there is no angle the wheels stay where
   they are. The same decisions as those of `PathFollower.plan`. */

typedef struct {
    Around around;
    double u[CAR_HORIZON];
    int plans, age, stopping;
} Controller;

#define ALIGNED sizeof(double)

static int set_up(Controller *c)
{
    (void)c;
    return CAR_OK;
}

/* A law has no iterations; a clock counts overruns. */
static void set_bound(Controller *c, int iterations) { (void)c, (void)iterations; }

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

/* The angle over the step before, within bounds: as said, else as planned, if, else straight ahead. */
static void applied_before(const double *planned, const car_input *in, double *to)
{
    double said = in->applied[0];
    int believed = in->applied_known && fabs(said) <= 1e12;
    *to = within(believed ? said : planned ? planned[0] : 0.0, -LIMIT, LIMIT);
}

static int decide(Controller *c, const car_input *in, car_output *out)
{
    int status = fault(in);
    double before;
    applied_before(c->plans ? c->u : NULL, in, &before);
    double angle = before, last = before;
    if (status == CAR_SOLVED) {
        double road = steer(in->x, in->tracked, in->exogenous[0][0], GAIN * (before - OFFSET));
        angle = road / GAIN + OFFSET;
        if (!(fabs(angle) < INFINITY))
            angle = before, status = CAR_FAILED;
    }
    for (int i = 0; i < CAR_HORIZON; i++) {
        double moved = within(angle, last - MOST, last + MOST);
        c->u[i] = last = within(moved, -LIMIT, LIMIT);
    }
    for (int i = 0; i < CAR_NODES; i++)
        for (int a = 0; a < CAR_STATES; a++)
            out->x[i][a] = fabs(in->x[a]) < 1e150 ? in->x[a] : 0;
    c->age = status != CAR_SOLVED ? c->age + 1 : 0;
    out->iterations = 0;
    out->cost = out->residual = out->violation = NAN;
    return status;
}
