/* An estimator, one sample at a time. The same numbers as those of `RecursiveVehicle`. */

#define FULL_TURN 6.283185307179586

typedef struct {
    double z[NZ], P[NZ * NZ]; /* states, parameters, offsets of sensors; their covariance */
    double before[NU], u[NU]; /* inputs since the sample before, and at this one */
    double y[NY], seen[NY], gate[NY], dt;
} Sample;

@PAST@
typedef struct {
    Sample now;
    double z[NZ], P[NZ * NZ], error[NY], variance[NY], taken[NY]; /* what a step makes of it */
    int64_t outliers[NY]; /* in a row on one side, negative below the prediction */
    int fresh[NY]; /* measured at this sample */
    Past past;
    int64_t samples; /* of which there is a past */
} Filter;

static int is_finite(double v) { return fabs(v) < INFINITY; }

/* Begins at a state. */
static void filter_begin(Filter *f, const double *x)
{
#ifdef HORIZON
    car_window *solver = f->past.solver;
    memset(f, 0, sizeof *f);
    f->past.solver = solver;
#else
    memset(f, 0, sizeof *f);
#endif
    memcpy(f->now.P, AT_START, sizeof f->now.P);
    for (int a = 0; a < NX; a++)
        f->now.z[a] = is_finite(x[a]) ? x[a] : 0;
    for (int i = 0; i < NY; i++)
        f->now.gate[i] = GATE;
}

static void run(Filter *f)
{
    Sample *s = &f->now;
    filter_step(s->z, s->P, s->before, s->u, s->y, s->seen, s->gate, &s->dt, f->z, f->P, f->error, f->variance, f->taken);
}

static int stays_finite(const Filter *f)
{
    int all = 1;
    for (int a = 0; a < NZ; a++)
        all &= is_finite(f->z[a]);
    for (int a = 0; a < NZ * NZ; a++)
        all &= is_finite(f->P[a]);
    return all;
}

@AGAIN@
/* Takes in outputs, NaN for what is not measured now, and inputs; 0, with the estimate as before, where that leaves the
   finite numbers. */
static int filter_take(Filter *f, const double *y, const double *u)
{
    Sample *s = &f->now;
    for (int i = 0; i < NY; i++) {
        f->fresh[i] = is_finite(y[i]);
        s->y[i] = f->fresh[i] ? y[i] : 0;
        s->seen[i] = (double)f->fresh[i];
        if (HEADINGS[i] >= 0 && f->fresh[i] && s->dt > 0) /* said from -180 to 180 degrees or 0 to 360 */
            s->y[i] += FULL_TURN * floor((s->z[HEADINGS[i]] - s->y[i]) / FULL_TURN + 0.5);
    }
    memcpy(s->u, u, sizeof s->u);
    if (!again(f))
        return 0;
    memcpy(s->z, f->z, sizeof s->z);
    memcpy(s->P, f->P, sizeof s->P);
    memcpy(s->before, s->u, sizeof s->before);
    s->dt = CAR_DT;
    for (int i = 0; i < NY; i++)
        if (f->fresh[i]) {
            double error = f->error[i];
            int above = error > 0, refused = !(f->taken[i] > 0) && error != 0; /* of one before the first sample: 0 */
            int off = s->gate[i] < INFINITY ? refused : error * error > GATE * f->variance[i];
            int64_t before = (f->outliers[i] > 0) == above ? f->outliers[i] : 0;
            f->outliers[i] = off ? before + (above ? 1 : -1) : 0;
            s->gate[i] = (above ? f->outliers[i] : -f->outliers[i]) >= PATIENCE ? INFINITY : GATE;
        }
    return 1;
}
