/* Real numbers: what a controller is given, in the order of its input struct, and inputs that were applied; then what it
   decided. */
#define NOT_KNOWN 1e300

typedef struct {
    car_controller controller;
    car_input given;
    car_output out;
} Part;

static void fmuStart(Part *p)
{
    (void)car_start(&p->controller, sizeof p->controller);
    p->out.status = -1; /* nothing was planned yet */
}

static void fmuOutput(Part *p, double *v)
{
    double *to = v + OUTPUTS;
    memcpy(to, p->out.command, sizeof p->out.command);
    to[CAR_CONTROLS] = p->out.status, to[CAR_CONTROLS + 1] = p->out.age, to[CAR_CONTROLS + 2] = p->out.stopping;
    to[CAR_CONTROLS + 3] = (double)p->out.health.fallbacks;
}

static int fmuStep(Part *p, double *v)
{
    const double *applied = v + OUTPUTS - CAR_CONTROLS;
    memcpy(&p->given, v, sizeof(double) * (OUTPUTS - CAR_CONTROLS));
    memcpy(p->given.applied, applied, sizeof p->given.applied);
    p->given.applied_known = 1;
    for (int j = 0; j < CAR_CONTROLS; j++)
        p->given.applied_known &= fabs(applied[j]) < NOT_KNOWN;
    (void)car_plan(&p->controller, &p->given, &p->out);
    return 1; /* a command always is a number */
}

static int fmuSlope(const Part *p, const double *v, const double *along, double *to)
{
    (void)p, (void)v, (void)along, (void)to;
    return 0;
}
