/* The controller around the solver: what it is given is judged, the solver starts from the plan before, and where there
   is no solution that plan is shifted or the stop law takes over. The same decisions as those of `MPC.plan`. */

#define MOST_ATTEMPTS 50 /* solves in a row that go on from an unfinished one; then another start is better */
#define WHOLE_TURN 6.283185307179586

typedef struct {
    Work work; /* first, as its vectors are aligned */
    double u[N * NU], x[(N + 1) * NX], kept_u[N * NU], kept_x[(N + 1) * NX];
    Around around;
    double pace; /* what a fallback has needed lately [s] */
    int64_t attempts;
    int plans, age, stopping, found, kept, kept_age, stuck, misses; /* stuck: see `stuck`; misses: of the next solve, see Work */
} Controller;

#define ALIGNED sizeof(V)

#ifdef CAR_JOINED_H /* the problem has several parts, and a solver of its own for all of them */
#define NEEDED sizeof(car_controller)

static car_joined *joined_of(Controller *c) { return &((car_controller *)(void *)c)->joined; }
#endif

static int set_up(Controller *c)
{
    Work *s = &c->work;
    begin_solver(s);
    memcpy(s->lowest, LOWEST, sizeof s->lowest);
    memcpy(s->highest, HIGHEST, sizeof s->highest);
    memcpy(s->safe, SAFE, sizeof s->safe);
    memcpy(s->relaxing, RELAXING, sizeof s->relaxing);
#ifdef CAR_JOINED_H
    return car_joined_start(joined_of(c), sizeof(car_joined));
#else
    return CAR_OK;
#endif
}

/* What a deadline means to the solver. */
static void set_bound(Controller *c, int iterations)
{
    c->work.max_iterations = iterations > 0 ? iterations : MAX_ITERATIONS;
    c->work.qp.clock = c->around.clock ? elapsed : NULL;
    c->pace = smaller(5e-5, 0.5 * c->around.seconds);
}

static int all_finite(const double *v, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += v[i] * v[i];
    return sum < INFINITY;
}

static int numbers(const double *v, int n)
{
    int all = 1;
    for (int i = 0; i < n; i++)
        all &= fabs(v[i]) <= 1e150;
    return all;
}

/* What is wrong with what is given, which the work area holds; SOLVED where nothing is. */
static int fault(const Work *s, const car_input *in)
{
    const double *low = s->lowest, *high = s->highest;
    int state = plausible(s->x0, 1, NX, low, high);
    if (!(state && plausible(s->p, N + 1, NP, low + NX, high + NX) &&
          plausible(s->w, N + 1, NW, low + NX + NP, high + NX + NP))) {
        int good = numbers(s->x0, NX) && numbers(s->p, (N + 1) * NP) && numbers(s->w, (N + 1) * NW);
        return good ? CAR_IMPLAUSIBLE : CAR_NOT_FINITE;
    }
#ifdef EDGES
    for (int i = 0; i < 2 * (N + 1); i++)
        if (s->corridor[i] != s->corridor[i])
            return CAR_NOT_FINITE;
#endif
    return all_finite(in->inputs[0], N * NU) ? SOLVED : CAR_NOT_FINITE;
}

/* The wanted heading on the turn nearest to the vehicle's. */
static void unwind(Work *s)
{
#ifdef HEADING
    volatile double turns = rint((s->x0[HEADING] - s->p[HEADING_WANTED]) / WHOLE_TURN), angle = WHOLE_TURN * turns;
    if (turns != 0)
        for (int i = 0; i <= N; i++)
            s->p[i * NP + HEADING_WANTED] += angle;
#else
    (void)s;
#endif
}

/* Inputs applied over the step before, within bounds: as said, else as planned, if, else those at rest. */
static void applied_before(const double *planned, const car_input *in, double *to)
{
    double size = 0;
    for (int j = 0; j < NU; j++)
        size += in->applied[j] * in->applied[j];
    int said = in->applied_known && size <= ANY_INPUT * ANY_INPUT;
    for (int j = 0; j < NU; j++) {
        double u = said ? in->applied[j] : planned ? planned[j] : 0.0;
        to[j] = smaller(larger(u, INPUT_LOW[j]), INPUT_HIGH[j]);
    }
}

/* Whether the next solve had better leave a fallback after such an outcome alone: every other one in a row. */
static int stuck(int status, int age)
{
    return age > 0 && age % 2 == 0 && (status == STALLED || status == INFEASIBLE || status == FAILED);
}

@SOLVE@
/* The stop law where nothing was planned and the state is not known. */
static void stop_blindly(const Work *s, const double *before, double *u)
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            double last = i ? u[(i - 1) * NU + j] : before[j];
            volatile double left = s->relaxing[i] * (before[j] - s->safe[j]);
            double v = s->safe[j] + left;
            v = smaller(larger(v, last + STEP_LOW[i * NU + j]), last + STEP_HIGH[i * NU + j]);
            u[i * NU + j] = smaller(larger(v, INPUT_LOW[j]), INPUT_HIGH[j]);
        }
}

/* Whether the plan before, shifted, is one for now: not where its stages are longer or shorter than the steps of time. */
static int in_time(Controller *c)
{
#ifdef DURATION
    return fabs(car_joined_decided(joined_of(c))[DURATION] - SPAN) <= 1e-8 + 1e-5 * SPAN;
#else
    (void)c;
    return 1;
#endif
}

/* The last good plan shifted, or the stop law, into c->u and c->x; `known` says that the state is. */
static void fall_back(Controller *c, const double *before, int known)
{
    Work *s = &c->work;
    int most = FALLBACK < NS - 1 ? FALLBACK : NS - 1, later = 1;
    c->age = c->plans ? c->age + 1 : 1;
    if (!c->plans || c->stopping || (c->age == 1 && !in_time(c)))
        c->kept = 0;
    else if (!c->kept) {
        memcpy(c->kept_u, c->u, sizeof c->u);
        memcpy(c->kept_x, c->x, sizeof c->x);
        c->kept = 1, c->kept_age = c->age - 1;
    }
    if (c->age > most)
        c->kept = 0;
    c->stopping = !c->kept;
    memcpy(s->applied, before, sizeof s->applied);
    if (c->kept) {
        later = c->age - c->kept_age;
        memcpy(s->way_u, c->kept_u, sizeof s->way_u);
        memcpy(s->way_x, c->kept_x, sizeof s->way_x);
    } else if (c->plans) {
        memcpy(s->way_u, c->u, sizeof s->way_u);
        memcpy(s->way_x, c->x, sizeof s->way_x);
    } else {
        later = 0;
        memset(s->way_u, 0, sizeof s->way_u);
        for (int i = 0; i <= N; i++)
            memcpy(s->way_x + i * NX, s->x0, sizeof s->x0);
    }
    if ((c->plans || known) && rt_fallback(s, later < NS ? later : NS, c->stopping, known)) {
        memcpy(c->u, s->way_u, sizeof c->u);
        memcpy(c->x, s->way_x, sizeof c->x);
        return;
    }
    stop_blindly(s, before, c->u);
    memset(c->x, 0, sizeof c->x);
}

/* Whether what the solver has is a plan; where the next solve may go on from it, that is in c->found. */
static int is_plan(Controller *c, int status)
{
    const Work *s = &c->work;
    int started = (status == ITERATION_LIMIT || status == STALLED || status == TIME_OUT) && s->iterations > 0 &&
                  s->violation <= FEASIBLE && moderate(s->u, N * NU) && moderate(s->x, (NS + 1) * NX);
    c->found = status == SOLVED || status == ITERATED || started || status == ITERATION_LIMIT || status == TIME_OUT;
    return status == SOLVED || status == ITERATED || started;
}

/* Takes what the solver has for the plan. */
static void keep_plan(Controller *c)
{
    const Work *s = &c->work;
    memcpy(c->u, s->u, sizeof c->u);
    for (int i = 0; i <= N; i++)
        memcpy(c->x + i * NX, s->x + NODE(i) * NX, sizeof s->x0);
    c->age = c->kept = c->stopping = 0;
}

static int decide(Controller *c, const car_input *in, car_output *out)
{
    Work *s = &c->work;
    double before[NU], limit = c->around.seconds;
    s->qp.clock_of = c;
    applied_before(c->plans ? c->u : NULL, in, before);
    memcpy(s->x0, in->x, sizeof s->x0);
    memcpy(s->applied, before, sizeof s->applied);
    memcpy(s->r, in->inputs, sizeof s->r);
#if NP > 0
    memcpy(s->p, in->tracked, sizeof s->p);
#endif
#if NW > 0
    memcpy(s->w, in->exogenous, sizeof s->w);
#endif
#ifdef EDGES
    memcpy(s->corridor, in->corridor, sizeof s->corridor);
#endif
    int status = fault(s, in), known = status == SOLVED || plausible(in->x, 1, NX, s->lowest, s->highest), fell = 1;
    out->iterations = 0;
    if (status == SOLVED) {
        unwind(s);
        s->time_limit = larger(limit - now(&s->qp) - c->pace, 0);
        status = solve(c);
        out->iterations = (int)s->iterations, out->begun_anew = s->anew != 0;
        fell = !is_plan(c, status);
    } else
        c->found = 0;
    if (fell) {
        double start = now(&s->qp);
        s->time_limit = larger(limit - start, 0);
        memcpy(s->x0, in->x, sizeof s->x0);
        fall_back(c, before, known);
        if (limit < INFINITY)
            c->pace = smaller(0.8 * c->pace + 0.2 * smaller(now(&s->qp) - start, 2 * c->pace), 0.5 * limit);
    } else
        keep_plan(c);
    c->stuck = stuck(status, c->age), c->misses = status == INFEASIBLE && c->age > 1 ? c->age - 1 : 0;
    memcpy(out->x, c->x, sizeof c->x);
#if CAR_DECIDED > 0
    for (int i = 0; i < CAR_DECIDED; i++)
        out->decided[i] = fell ? NAN : car_joined_decided(joined_of(c))[i];
#endif
    out->cost = c->age ? NAN : s->cost, out->residual = c->age ? NAN : s->residual;
    out->violation = c->age ? NAN : s->violation;
    return status;
}
