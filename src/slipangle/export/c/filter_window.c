/* What a moving horizon estimator does with a sample. The same estimates as those of `MovingHorizon`, but for the
   tolerance of the problem's solution. */

typedef struct {
    double at[NZ], later[NZ], F[NZ * NZ], y[NY], H[NY * NZ];
} Told;

/* What the model says at a state: that a sample later, outputs, their derivatives. */
static void look_at(const Filter *f, int k, const double *z, const Row *row, Told *to)
{
    const Row *later = k + 1 < f->samples ? f->past.window.rows + k + 1 : NULL;
    memcpy(to->at, z, sizeof to->at);
    look(z, later ? later->before : row->u, row->u, to->later, to->F, to->y, to->H);
}

/* An estimate and its covariance a sample later, with the model linearised where it was looked at. */
static void predict(double *mean, double *P, const Told *told)
{
    double off[NZ], by[NZ * NZ];
    for (int a = 0; a < NZ; a++)
        off[a] = mean[a] - told->at[a];
    for (int a = 0; a < NZ; a++) {
        mean[a] = told->later[a];
        for (int b = 0; b < NZ; b++) {
            mean[a] += told->F[a * NZ + b] * off[b];
            by[a * NZ + b] = 0;
            for (int c = 0; c < NZ; c++)
                by[a * NZ + b] += told->F[a * NZ + c] * P[c * NZ + b];
        }
    }
    for (int a = 0; a < NZ; a++)
        for (int b = 0; b < NZ; b++) {
            double sum = a == b ? WANDER[a] * WANDER[a] : 0;
            for (int c = 0; c < NZ; c++)
                sum += by[a * NZ + c] * told->F[b * NZ + c];
            P[a * NZ + b] = sum;
        }
}

/* The same after a sample, one output after the other. */
static void correct(double *mean, double *P, const Row *row, const Told *told)
{
    for (int i = 0; i < NY; i++) {
        double by[NZ], gain[NZ], error = row->y[i] - told->y[i], variance = NOISE[i] * NOISE[i];
        if (!(row->seen[i] > 0))
            continue;
        for (int a = 0; a < NZ; a++) {
            by[a] = 0;
            for (int b = 0; b < NZ; b++)
                by[a] += P[a * NZ + b] * told->H[i * NZ + b];
        }
        for (int a = 0; a < NZ; a++) {
            error -= told->H[i * NZ + a] * (mean[a] - told->at[a]);
            variance += told->H[i * NZ + a] * by[a];
        }
        for (int a = 0; a < NZ; a++) {
            gain[a] = by[a] / variance;
            mean[a] += gain[a] * error;
        }
        for (int a = 0; a < NZ; a++) { /* Joseph's form, which stays positive */
            double rest = 0;
            for (int b = 0; b < NZ; b++) {
                P[a * NZ + b] -= gain[a] * by[b];
                rest += P[a * NZ + b] * told->H[i * NZ + b];
            }
            for (int b = 0; b < NZ; b++)
                P[a * NZ + b] += (NOISE[i] * NOISE[i] * gain[a] - rest) * gain[b];
        }
    }
}

/* Kalman filter through the window, linearised at the states found, which become its means if these are asked for. */
static void filter_through(Filter *f, int means)
{
    Window *w = &f->past.window;
    double mean[NZ], P[NZ * NZ];
    Told told;
    memcpy(mean, w->mean, sizeof mean);
    memcpy(P, w->P, sizeof P);
    for (int k = 0; k < f->samples; k++) {
        if (k > 0)
            predict(mean, P, &told);
        memcpy(w->priors[k], P, sizeof P);
        look_at(f, k, w->found[k], w->rows + k, &told);
        correct(mean, P, w->rows + k, &told);
        if (means)
            memcpy(w->found[k], mean, sizeof mean);
    }
    for (int a = 0; a < NZ; a++)
        for (int b = 0; b < NZ; b++)
            f->P[a * NZ + b] = 0.5 * (P[a * NZ + b] + P[b * NZ + a]);
}

/* Takes the oldest sample out of the window; what it said stays in the estimate before. */
static void leave(Filter *f)
{
    Window *w = &f->past.window;
    Told told;
    look_at(f, 0, w->found[0], w->rows, &told);
    correct(w->mean, w->P, w->rows, &told);
    predict(w->mean, w->P, &told);
    f->samples--;
    memmove(w->rows, w->rows + 1, sizeof(Row) * (size_t)f->samples);
    memmove(w->found, w->found + 1, sizeof *w->found * (size_t)f->samples);
    memmove(w->priors, w->priors + 1, sizeof *w->priors * (size_t)(f->samples - 1));
}

/* Puts late outputs where they belong, those that are no outliers. */
static void place(Filter *f)
{
    Window *w = &f->past.window;
    for (int i = 0; i < NY; i++) {
        int64_t k = f->samples - 1 - LATE[i];
        if (LATE[i] == 0 || !f->fresh[i])
            continue;
        f->taken[i] = 0;
        if (k < 0)
            continue;
        Row *row = w->rows + k;
        const double *P = w->priors[k];
        double variance = NOISE[i] * NOISE[i];
        Told told;
        look_at(f, (int)k, w->found[k], row, &told);
        for (int a = 0; a < NZ; a++)
            for (int b = 0; b < NZ; b++)
                variance += told.H[i * NZ + a] * P[a * NZ + b] * told.H[i * NZ + b];
        f->error[i] = f->now.y[i] - told.y[i], f->variance[i] = variance;
        if (fabs(f->error[i]) <= sqrt(f->now.gate[i] * variance))
            row->y[i] = f->now.y[i], row->seen[i] = 1, f->taken[i] = 1;
    }
}

/* A lower triangular factor of a covariance, which may be singular. */
static void factor(const double *P, double *L)
{
    double rest[NZ * NZ];
    memcpy(rest, P, sizeof rest);
    memset(L, 0, sizeof rest);
    for (int j = 0; j < NZ; j++) {
        double pivot = rest[j * NZ + j];
        if (!(pivot > 1e-14 * P[j * NZ + j] && pivot > 0))
            continue;
        for (int a = j; a < NZ; a++)
            L[a * NZ + j] = rest[a * NZ + j] / sqrt(pivot);
        for (int a = j; a < NZ; a++)
            for (int b = j; b < NZ; b++)
                rest[a * NZ + b] -= L[a * NZ + j] * L[b * NZ + j];
    }
}

/* Columns of what is known at a node: inputs ahead and now, outputs, their weights, and so on. */
enum { NOW = NU, MEASURED = 2 * NU, WEIGHT = MEASURED + NY, MOVES = WEIGHT + NY, INSIDE, LED, COLUMNS = LED + NZ * WIDTH };
#define NODES (ARRIVAL + HORIZON + 1)

/* What is known at each node of the problem: first the estimate before is brought in, then nothing moves until the first
   sample, then the samples. */
static void know(const Filter *f, const double *L, double *given)
{
    const Window *w = &f->past.window;
    int first = NODES - (int)f->samples;
    memset(given, 0, sizeof(double) * NODES * COLUMNS);
    for (int k = 0; k < NODES; k++) {
        double *at = given + k * COLUMNS;
        const Row *row = w->rows + (k > first ? k - first : 0);
        memcpy(at, k < first || k + 1 == NODES ? row->u : row[1].before, sizeof row->u);
        memcpy(at + NOW, row->u, sizeof row->u);
        for (int c = k * WIDTH; k < ARRIVAL && c < (k + 1) * WIDTH && c < NZ; c++)
            for (int a = 0; a < NZ; a++)
                at[LED + a * WIDTH + c - k * WIDTH] = L[a * NZ + c];
        if (k < first)
            continue;
        for (int i = 0; i < NY; i++)
            at[MEASURED + i] = row->y[i], at[WEIGHT + i] = row->seen[i] / NOISE[i];
        at[INSIDE] = 1;
        if (k + 1 == NODES)
            continue;
        at[MOVES] = 1;
        for (int j = 0; j < N_SHAKEN; j++)
            at[LED + SHAKEN[j] * WIDTH + j] = WANDER[SHAKEN[j]];
    }
}

/* A guess: the states found so far, and what leads along them as far as it can. */
static void guess(const Filter *f, const double *L, double *u, double *x)
{
    const Window *w = &f->past.window;
    int n = (int)f->samples, first = NODES - n;
    double v[ARRIVAL * WIDTH] = {0};
    Told told;
    memset(u, 0, sizeof(double) * (NODES - 1) * WIDTH);
    memcpy(x, w->mean, sizeof w->mean);
    for (int k = ARRIVAL; k < NODES; k++)
        memcpy(x + k * NZ, w->found[k > first ? k - first : 0], sizeof w->mean);
    for (int j = 0; j < NZ; j++) {
        double left = x[ARRIVAL * NZ + j] - w->mean[j];
        for (int b = 0; b < j; b++)
            left -= L[j * NZ + b] * v[b];
        v[j] = L[j * NZ + j] > 0 ? left / L[j * NZ + j] : 0;
    }
    memcpy(u, v, sizeof v);
    for (int k = 1; k <= ARRIVAL; k++)
        for (int a = 0; a < NZ; a++) {
            x[k * NZ + a] = w->mean[a];
            for (int b = 0; b < k * WIDTH && b < NZ; b++)
                x[k * NZ + a] += L[a * NZ + b] * v[b];
        }
    for (int k = 0; k + 1 < n; k++) {
        look_at(f, k, w->found[k], w->rows + k, &told);
        for (int j = 0; j < N_SHAKEN; j++)
            u[(first + k) * WIDTH + j] = (w->found[k + 1][SHAKEN[j]] - told.later[SHAKEN[j]]) / WANDER[SHAKEN[j]];
    }
}

/* States over the window, and the covariance of the last. */
static void solve(Filter *f)
{
    Window *w = &f->past.window;
    car_window_parts parts = car_window_at(f->past.solver);
    const double *states = parts.x + (NODES - f->samples) * NZ;
    double L[NZ * NZ];
    factor(w->P, L);
    memcpy(parts.before, w->mean, sizeof w->mean);
    know(f, L, parts.given);
    guess(f, L, parts.u, parts.x);
    int solved = car_window_solve(f->past.solver);
    for (int a = 0; a < f->samples * NZ; a++)
        solved &= is_finite(states[a]);
    if (solved)
        memcpy(w->found, states, sizeof(double) * NZ * (size_t)f->samples);
    else
        f->past.failures++, filter_through(f, 1);
    filter_through(f, 0);
    memcpy(f->z, w->found[f->samples - 1], sizeof f->z);
}

/* Takes in a sample; 0, with the past as before, where that leaves the finite numbers. */
static int again(Filter *f)
{
    Window *w = &f->past.window;
    int64_t before = f->samples;
    for (int i = 0; i < NY; i++)
        if (LATE[i] > 0)
            f->now.seen[i] = 0;
    if (f->samples == 0) {
        memcpy(w->mean, f->now.z, sizeof w->mean);
        memcpy(w->P, f->now.P, sizeof w->P);
    }
    run(f); /* judges outliers, and is a first guess */
    if (!stays_finite(f))
        return 0;
    f->past.spare = *w;
    Row *row = w->rows + f->samples;
    memcpy(row->u, f->now.u, sizeof row->u);
    memcpy(row->before, f->now.before, sizeof row->before);
    memcpy(row->y, f->now.y, sizeof row->y);
    memcpy(row->seen, f->taken, sizeof row->seen); /* a late one is not */
    memcpy(w->found[f->samples], f->z, sizeof f->z);
    if (++f->samples > HORIZON + 1)
        leave(f);
    place(f);
    solve(f);
    if (stays_finite(f))
        return 1;
    *w = f->past.spare, f->samples = before;
    return 0;
}
