/* The controller around the quadratic program: what it is given is judged, and where there is no solution the plan
   before is shifted or the stop law takes over. The same decisions as those of `MultiARXMPC.plan`. */

enum { DECIDED, IMPOSSIBLE = CAR_NOT_FINITE, NO_PLAN = CAR_FAILED };

@LEARNS@typedef struct {
    Work work; /* first, as its vectors are aligned */
    double u[NH], x[(NH + 1) * NS], offset[NY];
    Around around;
    int plans, age, stopping, handed; /* handed: the plan before is another controller's */
@LEARNER@} Controller;

#define ALIGNED sizeof(V)

static int set_up(Controller *c)
{
    Work *s = &c->work;
    memcpy(s->speeds, SPEEDS, sizeof s->speeds);
    memcpy(s->A, OF_OUTPUTS, sizeof s->A);
    memcpy(s->B, OF_INPUTS, sizeof s->B);
    memcpy(s->c, CONSTANTS, sizeof s->c);
    memcpy(s->q, OF_ERRORS, sizeof(double) * NT);
    memcpy(s->end, OF_END, sizeof(double) * NT);
    s->r[0] = OF_INPUT, s->s[0] = OF_CHANGE;
    memcpy(s->bounds, BOUNDS, sizeof s->bounds);
    memcpy(s->steps, STEPS, sizeof s->steps);
    memcpy(s->lowest, LOWEST, sizeof s->lowest);
    memcpy(s->highest, HIGHEST, sizeof s->highest);
#if CAR_LEARNS
    begin_learning(&c->learner, s);
#endif
    return CAR_OK;
}

/* The number of events of the quadratic program is bounded as it was exported; a clock counts overruns. */
static void set_bound(Controller *c, int iterations)
{
    (void)iterations;
    c->work.qp.clock = c->around.clock ? elapsed : NULL;
}

static int numbers(const double *v, int n)
{
    int all = 1;
    for (int i = 0; i < n; i++)
        all &= fabs(v[i]) <= 1e150;
    return all;
}

static int fault(const Work *s)
{
    const double *low = s->lowest, *high = s->highest;
    if (plausible(s->x, 1, NS, low, high) && plausible(s->path, NH + 1, 3, low + NS, high + NS) &&
        plausible(s->v, NH, 1, low + NS + 3, high + NS + 3))
        return DECIDED;
    return numbers(s->x, NS) && numbers(s->path, (NH + 1) * 3) && numbers(s->v, NH) ? CAR_IMPLAUSIBLE : IMPOSSIBLE;
}

static double within(double v, double low, double high) { return smaller(larger(v, low), high); }

/* The input over the step before, within bounds: as said, else as planned, if, else that at rest. */
static void applied_before(const double *planned, const car_input *in, double *to)
{
    double said = in->applied[0];
    int believed = in->applied_known && fabs(said) <= ANY_INPUT;
    *to = within(believed ? said : planned ? planned[0] : 0.0, BOUNDS[0], BOUNDS[1]);
}

/* Sum of the believed prediction errors, from a fresh plan one step ago; zero after anything else. */
static void believe(Controller *c)
{
    double sum[NY];
    int good = INTEGRAL > 0 && c->plans && c->age == 0 && !c->handed;
    for (int o = 0; o < NY; o++) {
        volatile double part = INTEGRAL * (c->work.x[o] - c->x[NS + o]);
        sum[o] = c->offset[o] + part;
        good &= fabs(sum[o]) < FARTHEST;
    }
    for (int o = 0; o < NY; o++)
        c->offset[o] = good ? sum[o] : 0;
    memcpy(c->work.offset, c->offset, sizeof c->offset);
}

/* The plan before shifted, the wheels where they are (`standing`), or the stop law; into c->u and c->x. */
static void fall_back(Controller *c, double before, int standing)
{
    const Work *s = &c->work;
    int left = c->plans && !c->stopping ? (FALLBACK < NH - 1 ? FALLBACK : NH - 1) : 0;
    c->age = c->plans ? c->age + 1 : 1;
    c->stopping = !standing && c->age > left;
    double last = before, safe = within(SAFE, s->bounds[0], s->bounds[1]);
    for (int i = 0; i < NH; i++) {
        double v = before;
        if (!standing && (c->stopping || !c->plans)) {
            volatile double part = RELAXING[i] * (before - safe);
            v = safe + part;
        } else if (!standing)
            v = c->u[i + 1 < NH ? i + 1 : NH - 1];
        v = within(v, last + s->steps[0], last + s->steps[1]);
        c->u[i] = last = within(v, s->bounds[0], s->bounds[1]);
    }
    if (standing)
        for (int i = 0; i <= NH; i++)
            memcpy(c->x + i * NS, s->x, sizeof s->x);
    else if (c->plans)
        memmove(c->x, c->x + NS, sizeof(double) * NH * NS);
    memset(c->offset, 0, sizeof c->offset);
}

static int decide(Controller *c, const car_input *in, car_output *out)
{
    static const int outcomes[] = {CAR_SOLVED, CAR_NOT_FINITE, CAR_FAILED, CAR_INFEASIBLE};
    Work *s = &c->work;
    double before;
    applied_before(c->plans ? c->u : NULL, in, &before);
    memcpy(s->x, in->x, sizeof s->x);
    memcpy(s->path, in->tracked, sizeof s->path);
    memcpy(s->v, in->exogenous, sizeof s->v);
    s->applied[0] = before;
    s->qp.clock_of = c;
#if CAR_LEARNS
    learn(&c->learner, s);
    out->lesson = c->learner.lesson, out->samples = c->learner.samples;
#endif
    int status = fault(s), fell = 1, standing = 0;
    if (status == DECIDED && s->v[0] < SLOWEST)
        status = NO_PLAN, standing = 1;
    if (status == DECIDED) {
        believe(c);
        status = outcomes[marx_plan(s)];
        if (status == CAR_SOLVED && !(moderate(s->u, NH) && moderate(s->states, (NH + 1) * NS)))
            status = NO_PLAN;
        fell = status != CAR_SOLVED;
    }
    if (fell)
        fall_back(c, before, standing);
    else {
        memcpy(c->u, s->u, sizeof c->u);
        memcpy(c->x, s->states, sizeof c->x);
        c->age = c->stopping = 0;
    }
#if CAR_LEARNS
    c->learner.known = status != CAR_NOT_FINITE && status != CAR_IMPLAUSIBLE;
    memcpy(c->learner.x, s->x, sizeof s->x);
    c->learner.u = c->u[0];
#endif
    c->handed = 0;
    memcpy(out->x, c->x, sizeof c->x);
    out->iterations = fell ? 0 : (int)s->iterations[0];
    out->cost = fell ? NAN : s->cost[0], out->residual = fell ? NAN : s->residual[0], out->violation = NAN;
    return status;
}
