/* Two controllers and a criterion that says which one plans: as `SwitchedMPC.plan`. */

#define NH CAR_HORIZON
#define ALIKE (CAR_CALM_STATES == CAR_LIMIT_STATES)
#define SHORTEST 1e-3 /* m, the least length of a step along the path */

typedef struct {
    Around around;
    double u[NH], heading[NH + 1]; /* as planned before, and the last of its states */
    int64_t calm_steps;            /* in a row, with little demand */
    int plans, age, stopping, active;
} Controller;

#define ALIGNED sizeof(double)
#define NEEDED sizeof(car_controller)

static car_controller *whole(Controller *c) { return (car_controller *)(void *)c; }

static int set_up(Controller *c)
{
    car_controller *all = whole(c);
    int code = car_calm_start(&all->calm, sizeof all->calm);
    return code ? code : car_limit_start(&all->limit, sizeof all->limit);
}

static void set_bound(Controller *c, int iterations)
{
    Around *a = &c->around;
    double seconds = a->seconds > 0 ? a->seconds < INFINITY ? a->seconds : 0 : -1;
    car_calm_deadline(&whole(c)->calm, iterations, (car_seconds)seconds, a->clock, a->clock_of);
    car_limit_deadline(&whole(c)->limit, iterations, (car_seconds)seconds, a->clock, a->clock_of);
}

static double larger(double a, double b) { return a > b ? a : b; }

/* The input over the step before, within bounds: as said, else as planned, if, else that at rest. */
static void applied_before(const double *planned, const car_input *in, double *to)
{
    double said = in->applied[0], u = in->applied_known && fabs(said) <= 1e12 ? said : planned ? planned[0] : 0.0;
    *to = u < LOWEST ? LOWEST : u > HIGHEST ? HIGHEST : u;
}

/* Share of grip that is needed: on the path ahead, by the yaw rate now, and in the plan before; infinite if anything is
   not finite. */
static double demand_of(const Controller *c, const car_input *in)
{
    double needed = 0, sum = 0;
    for (int i = 0; i < NH; i++) {
        const double *at = in->tracked[i], *next = in->tracked[i + 1];
        double v = fabs(in->exogenous[i][0]), length = hypot(next[0] - at[0], next[1] - at[1]);
        double bend = fabs(next[2] - at[2]) / (length < SHORTEST ? SHORTEST : length) * (v * v);
        double turned = c->plans ? fabs(c->heading[i + 1] - c->heading[i]) / PERIOD * v : 0;
        needed = larger(needed, larger(bend, turned));
        sum += bend + turned;
    }
#ifdef YAW_RATE
    double now = fabs(in->exogenous[0][0]) * fabs(in->x[YAW_RATE]);
    needed = larger(needed, now), sum += now;
#endif
    double share = needed / GRIP;
    return sum < INFINITY && share < INFINITY ? share : INFINITY;
}

/* Which one plans: the one for the limit from `ENTER` on, until the demand has long been below `LEAVE`. */
static int chosen(Controller *c, double demand)
{
    c->calm_steps = demand < LEAVE ? c->calm_steps + 1 : 0;
    if (demand > ENTER)
        return 1;
    return c->active && c->calm_steps <= DWELL;
}

@PARTS@
static int decide(Controller *c, const car_input *in, car_output *out)
{
    double demand = demand_of(c, in);
    int to = chosen(c, demand);
    if (c->plans && to != c->active) { /* it is told what the other one planned last */
        car_calm_handed calm = {in->x, c->u, 0, 0, 0, c->age, c->stopping, 0};
        car_limit_handed limit = {in->x + CAR_CALM_STATES, c->u, 0, 0, 0, c->age, c->stopping, 0};
        if (to) {
            car_calm_leave(&whole(c)->calm, &calm);
            limit.x = ALIKE ? calm.x : NULL, limit.kept_x = ALIKE ? calm.kept_x : NULL;
            limit.kept_u = calm.kept_u, limit.kept_age = calm.kept_age;
            car_limit_take_over(&whole(c)->limit, &limit);
        } else {
            car_limit_leave(&whole(c)->limit, &limit);
            calm.x = ALIKE ? limit.x : NULL, calm.kept_x = ALIKE ? limit.kept_x : NULL;
            calm.kept_u = limit.kept_u, calm.kept_age = limit.kept_age;
            car_calm_take_over(&whole(c)->calm, &calm);
        }
    }
    c->active = to;
    out->demand = demand, out->active = to;
    return to ? ask_limit(c, in, out) : ask_calm(c, in, out);
}
