/* What is known of the models after a sample, and what the supervisor makes of it: as `AdaptiveMultiARXMPC.learn`. */

#define EACH (PAST + NB)      /* regressors of a model */
#define NZ (NJ * EACH + 1)    /* of all models, and the constant */

typedef struct {
    double theta[NZ * NY], P[NZ * NZ], spread[NY], x[NS], u, change;
    int64_t samples;
    int known, lesson; /* known: x and u are those of the sample before */
} Learner;

static void begin_learning(Learner *l, Work *s)
{
    memset(l, 0, sizeof *l);
    memcpy(l->theta, THETA, sizeof l->theta);
    for (int a = 0; a < NZ; a++)
        l->P[a * NZ + a] = UNSURE[a];
    for (int o = 0; o < NY; o++)
        l->spread[o] = NOISE * NOISE;
    l->lesson = CAR_WAITING;
    memcpy(s->A, OF_OUTPUTS, sizeof s->A);
    memcpy(s->B, OF_INPUTS, sizeof s->B);
    memcpy(s->c, CONSTANTS, sizeof s->c);
}

static int below(const double *v, int n, double most)
{
    int all = 1;
    for (int i = 0; i < n; i++)
        all &= fabs(v[i]) < most;
    return all;
}

/* Outputs of a model some steps after an input of 1 begins. */
static void respond(const double *theta, int j, double *last)
{
    const double *of = theta + j * EACH * NY;
    double y[NA + REACH][NY], held[NY] = {0};
    memset(y, 0, sizeof y);
    for (int k = 0; k < REACH; k++) {
        double *now = y[NA + k];
        for (int o = 0; o < NY; o++) {
            held[o] += k < NB ? of[(PAST + k) * NY + o] : 0;
            now[o] = held[o];
        }
        for (int i = 0; i < NA; i++)
            for (int o = 0; o < NY; o++)
                for (int p = 0; p < NY; p++)
                    now[o] += of[(i * NY + p) * NY + o] * y[NA + k - 1 - i][p];
    }
    memcpy(last, y[NA + REACH - 1], sizeof y[0]);
}

/* Whether the response to the input has kept its sign and about its size. */
static int trusted(const double *theta)
{
    double most = 0, now[NY];
    int good = 1;
    for (int i = 0; i < NJ * NY; i++)
        most = larger(most, fabs(RESPONSE[i]));
    for (int j = 0; j < NJ; j++) {
        respond(theta, j, now);
        for (int o = 0; o < NY; o++) {
            double start = RESPONSE[j * NY + o], ratio = now[o] / start;
            int near = fabs(start) > 0.05 * most;
            good &= fabs(now[o]) < INFINITY && (!near || (ratio < LARGEST_GAIN && ratio > 1 / LARGEST_GAIN));
        }
    }
    return good;
}

/* Coefficients as the program reads them. */
static void hand_over(const Learner *l, Work *s)
{
    for (int j = 0; j < NJ; j++) {
        const double *of = l->theta + j * EACH * NY;
        for (int i = 0; i < NA; i++)
            for (int o = 0; o < NY; o++)
                for (int p = 0; p < NY; p++)
                    s->A[((j * NA + i) * NY + o) * NY + p] = -of[(i * NY + p) * NY + o];
        memcpy(s->B + j * NB * NY, of + PAST * NY, sizeof(double) * NB * NY);
        memcpy(s->c + j * NY, l->theta + (NZ - 1) * NY, sizeof(double) * NY);
    }
}

/* Regressors of all models: lags and inputs of the sample before, times the models' weights at a speed; and 1. */
static void regress(const Learner *l, const Work *s, double *phi)
{
    double w[NJ];
    weights_at(s, s->v[0], w);
    for (int j = 0; j < NJ; j++) {
        double *row = phi + j * EACH;
        for (int i = 0; i < PAST; i++)
            row[i] = w[j] * l->x[i];
        row[PAST] = w[j] * l->u;
        for (int m = 1; m < NB; m++)
            row[PAST + m] = w[j] * l->x[PAST + m - 1];
    }
    phi[NZ - 1] = 1;
}

/* The lesson of a sample that may be learned from: phi are its regressors. */
static int lesson_of(Learner *l, const double *x, const double *phi)
{
    double gain[NZ], theta[NZ * NY], error[NY], information = 0;
    int far = 0;
    for (int a = 0; a < NZ; a++) {
        gain[a] = 0;
        for (int b = 0; b < NZ; b++)
            gain[a] += l->P[a * NZ + b] * phi[b];
    }
    for (int a = 0; a < NZ; a++)
        information += phi[a] * gain[a];
    if (information < EXCITATION || l->change < LEAST_CHANGE)
        return CAR_QUIET;
    for (int o = 0; o < NY; o++) {
        double said = 0;
        for (int a = 0; a < NZ; a++)
            said += phi[a] * l->theta[a * NY + o];
        error[o] = x[o] - said;
        far |= error[o] * error[o] > SURPRISE * SURPRISE * (l->spread[o] * (1 + information));
    }
    for (int o = 0; far && o < NY; o++) /* so that a lasting change is believed */
        l->spread[o] = smaller(l->spread[o] * 1.05, 100 * NOISE * NOISE);
    if (far)
        return CAR_SURPRISING;
    for (int a = 0; a < NZ; a++)
        for (int o = 0; o < NY; o++)
            theta[a * NY + o] = l->theta[a * NY + o] + gain[a] * error[o] / (1 + information);
    if (!trusted(theta))
        return CAR_DOUBTFUL;
    double share = FORGETTING - (1 - FORGETTING) / information; /* Kulhavy: forget along phi alone */
    double factor = share / (1 + share * information);
    for (int a = 0; a < NZ; a++)
        for (int b = 0; b < NZ; b++)
            l->P[a * NZ + b] -= gain[a] * gain[b] * factor;
    for (int o = 0; o < NY; o++) {
        double spread = l->spread[o] + 0.02 * (error[o] * error[o] / (1 + information) - l->spread[o]);
        l->spread[o] = larger(spread, 0.1 * NOISE * (0.1 * NOISE));
    }
    memcpy(l->theta, theta, sizeof l->theta);
    l->samples++;
    return CAR_LEARNED;
}

/* Learn from the state and the speed that the work area holds. */
static void learn(Learner *l, Work *s)
{
    double v = s->v[0], before = NB > 1 ? l->x[PAST] : l->u, phi[NZ];
    if (!(below(l->theta, NZ * NY, ANY_INPUT) && below(l->P, NZ * NZ, ANY_INPUT) && below(l->spread, NY, ANY_INPUT)))
        begin_learning(l, s);
    l->lesson = CAR_WAITING;
    if (!l->known || !plausible(s->x, 1, NS, s->lowest, s->highest) || !(fabs(v) < FASTEST))
        return;
    l->change += 0.05 * ((l->u - before) * (l->u - before) - l->change);
    l->lesson = CAR_OUTSIDE;
    if (!(v >= s->speeds[0] && v <= s->speeds[NJ - 1] && v >= SLOWEST))
        return;
    l->lesson = CAR_SATURATED;
#ifdef YAW_RATE
    if (larger(fabs(s->x[YAW_RATE]), fabs(l->x[YAW_RATE])) * v > LATERAL)
        return;
#endif
    regress(l, s, phi);
    l->lesson = lesson_of(l, s->x, phi);
    if (l->lesson == CAR_LEARNED)
        hand_over(l, s);
}
