/* An extended Kalman filter, one sample at a time. The same numbers as those of `RecursiveVehicle`. */

typedef struct {
    double z[NZ], P[NZ * NZ]; /* states, parameters, offsets of sensors; their covariance */
    double before[NU], u[NU]; /* inputs since the sample before, and at this one */
    double y[NY], seen[NY], gate[NY], dt;
} Sample;

typedef struct {
    Sample now;
    double z[NZ], P[NZ * NZ], error[NY], variance[NY], taken[NY]; /* what a step makes of it */
    int64_t outliers[NY];
    int fresh[NY];            /* measured at this sample */
    Sample kept[DEEPEST + 1]; /* the last samples, for outputs that are late */
    int64_t samples;
} Filter;

static int is_finite(double v) { return fabs(v) < INFINITY; }

/* Begins at a state. */
static void filter_begin(Filter *f, const double *x)
{
    memset(f, 0, sizeof *f);
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

#if DEEPEST > 0
static Sample *ago(Filter *f, int steps) { return &f->kept[(f->samples - 1 - steps) % (DEEPEST + 1)]; }

/* Takes in a sample that was kept, and begins the one after it with what comes out. */
static void run_kept(Filter *f, int age)
{
    f->now = *ago(f, age);
    run(f);
    if (age > 0) {
        memcpy(ago(f, age - 1)->z, f->z, sizeof f->z);
        memcpy(ago(f, age - 1)->P, f->P, sizeof f->P);
    }
}

/* Takes in late outputs where they belong, and what came since once more; 0 where that leaves the finite numbers. */
static int again(Filter *f)
{
    double y[NY], gate[NY], error[NY] = {0}, variance[NY] = {0}, taken[NY] = {0};
    int back = 0;
    memcpy(y, f->now.y, sizeof y);
    memcpy(gate, f->now.gate, sizeof gate);
    for (int i = 0; i < NY; i++)
        if (LATE[i] > 0)
            f->now.seen[i] = 0;
    f->samples++;
    *ago(f, 0) = f->now;
    for (int i = 0; i < NY; i++)
        if (LATE[i] > 0 && f->fresh[i] && LATE[i] < f->samples) {
            ago(f, LATE[i])->y[i] = y[i], ago(f, LATE[i])->seen[i] = 1;
            back = LATE[i] > back ? LATE[i] : back;
        }
    for (int age = back; age >= 0; age--) {
        for (int i = 0; i < NY; i++)
            if (LATE[i] == age && f->fresh[i])
                ago(f, age)->gate[i] = gate[i];
        run_kept(f, age);
        for (int i = 0; i < NY; i++)
            if (LATE[i] == age && f->fresh[i])
                error[i] = f->error[i], variance[i] = f->variance[i], taken[i] = f->taken[i];
    }
    if (!stays_finite(f)) { /* forget this sample, and what of it belonged to samples before */
        for (int i = 0; i < NY; i++)
            if (LATE[i] > 0 && f->fresh[i] && LATE[i] < f->samples)
                ago(f, LATE[i])->seen[i] = 0;
        for (int age = back; age > 0; age--)
            run_kept(f, age);
        f->now = *ago(f, 0);
        f->samples--;
        memcpy(f->now.gate, gate, sizeof gate);
        return 0;
    }
    memcpy(f->now.gate, gate, sizeof gate);
    memcpy(f->error, error, sizeof error);
    memcpy(f->variance, variance, sizeof variance);
    memcpy(f->taken, taken, sizeof taken);
    return 1;
}
#else
static int again(Filter *f)
{
    run(f);
    return stays_finite(f);
}
#endif

/* Takes in outputs, NaN for what is not measured now, and inputs; 0, with the estimate as before, where that leaves the
   finite numbers. */
static int filter_take(Filter *f, const double *y, const double *u)
{
    Sample *s = &f->now;
    for (int i = 0; i < NY; i++) {
        f->fresh[i] = is_finite(y[i]);
        s->y[i] = f->fresh[i] ? y[i] : 0;
        s->seen[i] = (double)f->fresh[i];
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
            f->outliers[i] = f->taken[i] > 0 ? 0 : f->outliers[i] + 1;
            s->gate[i] = f->outliers[i] >= PATIENCE ? INFINITY : GATE;
        }
    return 1;
}
