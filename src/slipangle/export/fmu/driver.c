/* Real numbers: what is measured, in the order of the channels; then what the driver wants and believes. */
typedef struct {
    car_driver driver;
    car_measurements given;
    car_commands out;
    int64_t steps; /* since the start */
} Part;

static void fmuStart(Part *p)
{
    (void)car_start(&p->driver, sizeof p->driver);
    p->out.reason = -1; /* nothing was decided yet */
}

static double *listed(double *to, const double *from, size_t n)
{
    memcpy(to, from, n * sizeof *to);
    return to + n;
}

static void fmuOutput(Part *p, double *v)
{
    const car_commands *c = &p->out;
    double *to = listed(v + OUTPUTS, c->value, CAR_COMMANDS);
    const double place[] = {c->wanted_v_x, c->s, c->e_y};
    const double is[] = {c->reason, c->planned, c->status, c->plan_age, c->stopping, (double)c->health.fallbacks, (double)c->restarts};
    to = listed(to, place, 3);
    to = listed(to, c->state, CAR_STATES);
    to = listed(to, c->state_std, CAR_STATES);
    (void)listed(to, is, sizeof is / sizeof *is);
}

static int fmuStep(Part *p, double *v)
{
    p->given.t = (double)p->steps++ * DT;
    memcpy(p->given.value, v, sizeof p->given.value);
    (void)car_step(&p->driver, &p->given, &p->out);
    return 1; /* commands always are numbers */
}

static int fmuSlope(const Part *p, const double *v, const double *along, double *to)
{
    (void)p, (void)v, (void)along, (void)to;
    return 0;
}
