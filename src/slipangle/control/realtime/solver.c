/* Preparation, feedback, line search: the algorithm on the struct of work.c and the functions of stages.c. */

#define MAT(name) ((double *)s->name)

/* ---- problem data of a row of the QP -------------------------------------------------------------------------- */

static const double *limit_of(const Work *s, int row, int *stage, int *which)
{
    *stage = LIMIT_STAGE[row], *which = LIMIT_WHICH[row];
    return s->bounds + (*stage * NL + *which) * 2;
}

/* ---- linearisation -------------------------------------------------------------------------------------------- */

static int all_finite(const double *values, int n)
{
    V sum = {0}, v;
    int i = 0, all = 1;
    for (; i + LANES <= n; i += LANES) {
        memcpy(&v, values + i, sizeof v);
        sum += 0 * v;
    }
    for (; i < n; i++)
        all &= 0 * values[i] == 0;
    return all && !v_any(sum != 0.0);
}

static int linearise(Work *s)
{
    for (int i = 0; i < NS; i += LANES)
        evaluate_dynamics(s, i, LANES);
    if (s->open_end)
        memcpy(s->x + NS * NX, s->next + (NS - 1) * NX, sizeof s->x0);
    s->open_end = 0;
    for (int i = 0; i <= N; i += LANES)
        evaluate_stage(s, i);
    return all_finite(s->next, NS * NX) && all_finite(s->e, (N + 1) * NE) && all_finite(s->l, (N + 1) * NL) &&
           all_finite(s->A, NS * NX * NX);
}

/* Correct H along a step by the change of the gradient seen there (BFGS, damped after Powell). */
static void secant(Work *s, double *H, const double *step, const double *change)
{
    double *z = s->product, old, seen, keep = 1;
    memset(z, 0, sizeof s->product);
    for (int a = 0; a < N * NU; a++) {
        z[a] += dot(H + a * QL + a, step + a, N * NU - a);
        add(z + a + 1, step[a], H + a * QL + a + 1, N * NU - a - 1);
    }
    old = dot(z, step, N * NU), seen = dot(change, step, N * NU);
    if (!(old > 0))
        return;
    if (seen < 0.2 * old)
        keep = 0.8 * old / (old - seen);
    double mixed = keep * seen + (1 - keep) * old;
    for (int a = 0; a < N * NU; a++) {
        double y = keep * change[a] + (1 - keep) * z[a], za = z[a];
        for (int b = a; b < N * NU; b++)
            H[a * QL + b] += y * (keep * change[b] + (1 - keep) * z[b]) / mixed - za * z[b] / old;
    }
}

/* Gradient of the Lagrangian by the inputs, with the multipliers of the last QP. */
static void gradient(Work *s, double *into)
{
    Qp *q = &s->qp;
    memcpy(into, q->g, sizeof q->g);
    for (int row = 0; row < N_LIMITS; row++)
        if (q->lambda[QN + QR + row] != 0)
            add(into, q->lambda[QN + QR + row], (const double *)q->C + row * QL, N * NU);
}

/* Remember the last step and the change of the gradient over it. */
static void remember(Work *s)
{
    if (s->pairs == PAIRS) {
        memmove(s->pair_s, s->pair_s + QL, sizeof(double) * (PAIRS - 1) * QL);
        memmove(s->pair_y, s->pair_y + QL, sizeof(double) * (PAIRS - 1) * QL);
        s->pairs--;
    }
    double *step = s->pair_s + s->pairs * QL, *change = s->pair_y + s->pairs * QL;
    gradient(s, change);
    add(change, -1.0, s->g_from, N * NU);
    double size = 0;
    for (int a = 0; a < N * NU; a++) {
        step[a] = (s->u[a] - s->u_from[a]) / SCALE[a % NU];
        size = fmax(size, fabs(step[a]));
    }
    s->pairs += size > 0;
}

/* Hessian, its factor, and the dense rows: everything that does not depend on the state now. */
static int condense(Work *s)
{
    Qp *q = &s->qp;
    double *H = (double *)q->H, *G = MAT(G), *old = G, *new = G + NX * QL, *row = MAT(R);
    memset(H, 0, sizeof q->H);
    memset(G, 0, sizeof s->G);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            int a = i * NU + j;
            double c = SCALE[j] * SCALE[j];
            H[a * QL + a] += c * (s->wr[a] + s->ws[a] + (i + 1 < N ? s->ws[a + NU] : 0));
            if (i + 1 < N)
                H[a * QL + a + NU] -= c * s->ws[a + NU];
        }
    int limit = 0;
    for (int i = 0; i <= N; i++) {
        int at = i < N ? i : N - 1, width = i * NU;
        const double *weight = s->q + i * NE;
        for (int k = 0; k < NE; k++) {
            const double *ex = s->E + i * NE * NX + k * NX, *eu = s->D + i * NE * NU + k * NU;
            int wide = width;
            memset(row, 0, sizeof s->R);
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                add_rows(row, ex[E_AT[c]], old + E_AT[c] * QL, 0, width);
            if (E_INPUT[k]) {
                for (int j = 0; j < NU; j++)
                    row[at * NU + j] += SCALE[j] * eu[j];
                wide = (at + 1) * NU > wide ? (at + 1) * NU : wide;
            }
            if (weight[k] > 0)
                for (int a = 0; a < wide; a++)
                    add_rows(H + a * QL, weight[k] * row[a], row, a, wide);
        }
        for (; limit < N_LIMITS && LIMIT_STAGE[limit] == i; limit++) {
            int k = LIMIT_WHICH[limit];
            double *c = (double *)q->C + limit * QL;
            const double *lx = s->LX + i * NL * NX + k * NX, *lu = s->LU + i * NL * NU + k * NU;
            memset(c, 0, sizeof(double) * QL);
            for (int b = 0; b < NX; b++)
                if (lx[b] != 0)
                    add_rows(c, lx[b], old + b * QL, 0, width);
            for (int j = 0; j < NU; j++)
                c[at * NU + j] += SCALE[j] * lu[j];
        }
        if (i == N)
            break;
        for (int m = NODE(i); m < NODE(i + 1); m++) {
            const double *A = s->A + m * NX * NX, *B = s->B + m * NX * NU;
            for (int a = 0; a < NX; a++) {
                double *to = new + a * QL;
                memset(to, 0, sizeof(double) * QL);
                for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                    add_rows(to, A[a * NX + A_AT[c]], old + A_AT[c] * QL, 0, m > NODE(i) ? width + NU : width);
                for (int j = 0; j < NU; j++)
                    to[width + j] += SCALE[j] * B[a * NU + j];
            }
            double *swap = old;
            old = new, new = swap;
        }
    }
    for (int k = 0; k < s->pairs; k++)
        secant(s, H, s->pair_s + k * QL, s->pair_y + k * QL);
    double top = 0;
    for (int a = 0; a < N * NU; a++)
        top = fmax(top, H[a * QL + a]);
    if (!(top < INFINITY))
        return 0;
    for (double more = 1e-12; more < 1; more *= 100) { /* an input without effect stays where it is */
        for (int a = 0; a < N * NU; a++)
            H[a * QL + a] += more * (top > 0 ? top : 1);
        if (qp_factor(q))
            return 1;
    }
    return 0;
}

/* Gradient and limits for the state now, relative to the iterate. */
static void feed(Work *s)
{
    Qp *q = &s->qp;
    for (int a = 0; a < NX; a++)
        s->dx[a] = s->x0[a] - s->x[a];
    for (int m = 0; m < NS; m++) {
        const double *A = s->A + m * NX * NX, *dx = s->dx + m * NX;
        for (int a = 0; a < NX; a++) {
            double v = s->next[m * NX + a] - s->x[(m + 1) * NX + a];
            for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                v += A[a * NX + A_AT[c]] * dx[A_AT[c]];
            s->dx[(m + 1) * NX + a] = v;
        }
    }
    double *pi = s->pi;
    memset(pi, 0, sizeof s->pi);
    memset(q->g, 0, sizeof q->g);
    for (int i = N; i >= 0; i--) {
        const double *weight = s->q + i * NE, *dx = s->dx + NODE(i) * NX;
        int at = i < N ? i : N - 1;
        for (int m = i < N ? NODE(i + 1) - 1 : -1; m >= NODE(i); m--) {
            const double *A = s->A + m * NX * NX, *B = s->B + m * NX * NU, *after = pi + (m + 1) * NX;
            for (int a = 0; a < NX; a++) {
                for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                    pi[m * NX + A_AT[c]] += A[a * NX + A_AT[c]] * after[a];
                for (int j = 0; j < NU; j++)
                    q->g[i * NU + j] += SCALE[j] * B[a * NU + j] * after[a];
            }
        }
        for (int k = 0; k < NE; k++) {
            const double *ex = s->E + i * NE * NX + k * NX, *eu = s->D + i * NE * NU + k * NU;
            double v = s->e[i * NE + k];
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                v += ex[E_AT[c]] * dx[E_AT[c]];
            v *= weight[k];
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                pi[NODE(i) * NX + E_AT[c]] += ex[E_AT[c]] * v;
            if (E_INPUT[k])
                for (int j = 0; j < NU; j++)
                    q->g[at * NU + j] += SCALE[j] * eu[j] * v;
        }
    }
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            int a = i * NU + j;
            double before = i ? s->u[a - NU] : s->applied[j], c = SCALE[j];
            double change = s->ws[a] * (s->u[a] - before);
            q->g[a] += c * (s->wr[a] * (s->u[a] - s->r[a]) + change);
            if (i)
                q->g[a - NU] -= c * change;
            q->lo[a] = (INPUT_LOW[j] - s->u[a]) / c, q->hi[a] = (INPUT_HIGH[j] - s->u[a]) / c;
        }
    for (int k = 0; k < QR; k++) {
        int a = q->after[k], j = a % NU;
        double change = s->u[a] - (a < NU ? s->applied[j] : s->u[a - NU]);
        q->lo[QN + k] = (STEP_LOW[a] - change) / SCALE[j], q->hi[QN + k] = (STEP_HIGH[a] - change) / SCALE[j];
    }
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k), *lx = s->LX + i * NL * NX + k * NX;
        double v = s->l[i * NL + k];
        for (int c = 0; c < NX; c++)
            v += lx[c] * s->dx[NODE(i) * NX + c];
        q->lo[QN + QR + row] = b[0] - v, q->hi[QN + QR + row] = b[1] - v;
    }
}

/* Step in inputs and states from the solved QP; adjoints of the dynamics for the merit function. */
static void expand(Work *s)
{
    const Qp *q = &s->qp;
    for (int a = 0; a < N * NU; a++)
        s->du[a] = SCALE[a % NU] * q->u[a];
    for (int a = 0; a < NX; a++)
        s->dx[a] = s->x0[a] - s->x[a];
    for (int m = 0; m < NS; m++) {
        const double *A = s->A + m * NX * NX, *B = s->B + m * NX * NU;
        for (int a = 0; a < NX; a++) {
            double v = s->next[m * NX + a] - s->x[(m + 1) * NX + a];
            for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                v += A[a * NX + A_AT[c]] * s->dx[m * NX + A_AT[c]];
            for (int j = 0; j < NU; j++)
                v += B[a * NU + j] * s->du[STAGE_OF(m) * NU + j];
            s->dx[(m + 1) * NX + a] = v;
        }
    }
}

/* ---- merit ---------------------------------------------------------------------------------------------------- */

static double soft_cost(const Work *s, int row, double excess)
{
    const Qp *q = &s->qp;
    int i = QN + QR + row;
    if (excess <= 0)
        return 0;
    if (!(q->plain[i] < INFINITY))
        return s->hard_penalty * excess;
    return q->plain[i] * excess + 0.5 * q->square[i] * excess * excess;
}

/* Half the cost plus penalties; `linear` for the model of the cost after the step, with the dynamics kept. */
static double merit(const Work *s, int linear, double *cost, double *violation)
{
    double sum = 0, defects = 0, worst = 0;
    for (int i = 0; i <= N; i++) {
        const double *weight = s->q + i * NE;
        const double *dx = s->dx + NODE(i) * NX, *du = s->du + (i < N ? i : N - 1) * NU;
        for (int k = 0; k < NE; k++) {
            double v = s->e[i * NE + k];
            if (linear) {
                const double *ex = s->E + i * NE * NX + k * NX;
                const double *eu = s->D + i * NE * NU + k * NU;
                for (int c = 0; c < NX; c++)
                    v += ex[c] * dx[c];
                for (int j = 0; j < NU; j++)
                    v += eu[j] * du[j];
            }
            sum += 0.5 * weight[k] * v * v;
        }
    }
    for (int a = 0; a < N * NU; a++) {
        int j = a % NU;
        double u = s->u[a] + (linear ? s->du[a] : 0);
        double before = a < NU ? s->applied[j] : s->u[a - NU] + (linear ? s->du[a - NU] : 0);
        sum += 0.5 * (s->wr[a] * (u - s->r[a]) * (u - s->r[a]) + s->ws[a] * (u - before) * (u - before));
    }
    double hard = 0;
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k);
        double v = s->l[i * NL + k];
        if (linear) {
            const double *lx = s->LX + i * NL * NX + k * NX;
            const double *lu = s->LU + i * NL * NU + k * NU;
            for (int c = 0; c < NX; c++)
                v += lx[c] * s->dx[NODE(i) * NX + c];
            for (int j = 0; j < NU; j++)
                v += lu[j] * s->du[(i < N ? i : N - 1) * NU + j];
        }
        double excess = fmax(v - b[1], b[0] - v);
        if (s->qp.plain[QN + QR + row] < INFINITY)
            sum += soft_cost(s, row, excess);
        else if (!linear && excess > 0) {
            hard += soft_cost(s, row, excess);
            worst = fmax(worst, excess);
        }
    }
    if (!linear) {
        for (int i = 0; i < NS * NX; i++) {
            double d = fabs(s->next[i] - s->x[NX + i]);
            defects += s->penalty[NX + i] * d;
            worst = fmax(worst, d);
        }
        for (int a = 0; a < NX; a++) {
            double d = fabs(s->x[a] - s->x0[a]);
            defects += s->penalty[a] * d;
            worst = fmax(worst, d);
        }
    }
    if (cost)
        *cost = sum;
    if (violation)
        *violation = worst;
    return sum + defects + hard;
}

/* Penalties above the multipliers of the dynamics and of hard limits at the step. */
static void raise_penalties(Work *s)
{
    const Qp *q = &s->qp;
    double *pi = s->pi;
    memset(pi, 0, sizeof s->pi);
    for (int i = N; i >= 0; i--) {
        const double *weight = s->q + i * NE, *dx = s->dx + NODE(i) * NX;
        const double *du = s->du + (i < N ? i : N - 1) * NU;
        for (int m = i < N ? NODE(i + 1) - 1 : -1; m >= NODE(i); m--) {
            const double *A = s->A + m * NX * NX;
            for (int a = 0; a < NX; a++)
                for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                    pi[m * NX + A_AT[c]] += A[a * NX + A_AT[c]] * pi[(m + 1) * NX + a];
        }
        for (int k = 0; k < NE; k++) {
            const double *ex = s->E + i * NE * NX + k * NX, *eu = s->D + i * NE * NU + k * NU;
            double v = s->e[i * NE + k];
            for (int c = 0; c < NX; c++)
                v += ex[c] * dx[c];
            for (int j = 0; j < NU; j++)
                v += eu[j] * du[j];
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                pi[NODE(i) * NX + E_AT[c]] += ex[E_AT[c]] * weight[k] * v;
        }
        for (int row = 0; row < N_LIMITS; row++)
            if (LIMIT_STAGE[row] == i && q->lambda[QN + QR + row] != 0) {
                const double *lx = s->LX + i * NL * NX + LIMIT_WHICH[row] * NX;
                for (int c = 0; c < NX; c++)
                    pi[NODE(i) * NX + c] += lx[c] * q->lambda[QN + QR + row];
            }
    }
    for (int i = 0; i < (NS + 1) * NX; i++)
        s->penalty[i] = fmax(s->penalty[i], 1.5 * fabs(pi[i]));
    for (int row = 0; row < N_LIMITS; row++)
        if (!(q->plain[QN + QR + row] < INFINITY))
            s->hard_penalty = fmax(s->hard_penalty, 1.5 * fabs(q->lambda[QN + QR + row]));
}

/* ---- iterations ----------------------------------------------------------------------------------------------- */

static void move(Work *s, double t)
{
    for (int a = 0; a < N * NU; a++)
        s->u[a] = s->u_from[a] + t * s->du[a];
    for (int a = 0; a < (NS + 1) * NX; a++)
        s->x[a] = s->x_from[a] + t * s->dx[a];
}

/* Inputs within bounds and rates, unless they are no numbers. */
static void keep_inputs(Work *s)
{
    if (!all_finite(s->u, N * NU))
        return;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            int a = i * NU + j;
            double before = i ? s->u[a - NU] : s->applied[j], u = s->u[a];
            u = fmin(fmax(u, before + STEP_LOW[a]), before + STEP_HIGH[a]);
            s->u[a] = fmin(fmax(u, INPUT_LOW[j]), INPUT_HIGH[j]);
        }
}

static void roll_out(Work *s)
{
    memcpy(s->x, s->x0, sizeof s->x0);
    memset(s->k, 0, sizeof s->k);
    for (int m = 0; m < NS; m++) {
        evaluate_dynamics(s, m, 1);
        memcpy(s->x + (m + 1) * NX, s->next + m * NX, sizeof s->x0);
    }
}

/* Largest change of an input, in units of its range. */
static double step_size(const Work *s)
{
    double worst = 0;
    for (int a = 0; a < N * NU; a++)
        worst = fmax(worst, fabs(s->qp.u[a]));
    return worst;
}

static int prepare(Work *s)
{
    double begin = now();
    int ok = linearise(s) && condense(s);
    s->seconds_prepare = now() - begin;
    return ok ? SOLVED : NOT_FINITE;
}

/* The rows that the last quadratic program ended with travel with the plan: another work area starts from the same. */
static void keep_rows(Work *s)
{
    const Qp *q = &s->qp;
    s->working[0] = q->k;
    for (int a = 0; a < q->k; a++) {
        s->working[1 + 2 * a] = q->row[a];
        s->working[2 + 2 * a] = q->sign[a] * (1 + q->mode[q->row[a]]);
    }
}

static void recall_rows(Work *s)
{
    Qp *q = &s->qp;
    q->k = (int)s->working[0];
    for (int a = 0; a < q->k; a++) {
        double how = s->working[2 + 2 * a];
        q->row[a] = (int)s->working[1 + 2 * a];
        q->sign[a] = how > 0 ? 1 : -1;
        q->mode[q->row[a]] = (int)fabs(how) - 1;
    }
}

static int solve_qp(Work *s, int warm)
{
    feed(s);
    int status = qp_solve(&s->qp, warm);
    keep_rows(s);
    s->qp_iterations += s->qp.iterations;
    static const int outcome[] = {SOLVED, INFEASIBLE, FAILED, TIME_OUT, FAILED};
    if (status == QP_NUMBER && s->qp.kkt <= 1e-6) /* wildly scaled, but good enough for a step; `residual` says it */
        status = QP_SOLVED;
    if (status == QP_SOLVED)
        expand(s);
    return outcome[status];
}

/* Full step of the prepared problem from the state now. */
int rt_feedback(Work *s)
{
    double begin = now();
    s->qp.until = begin + s->time_limit;
    s->qp_iterations = 0;
    int status = solve_qp(s, !s->fresh);
    if (status == SOLVED) {
        memcpy(s->u_from, s->u, sizeof s->u);
        memcpy(s->x_from, s->x, sizeof s->x);
        s->cost = 2 * merit(s, 1, NULL, NULL);
        move(s, 1);
        keep_inputs(s);
        s->step = step_size(s);
        s->residual = s->qp.kkt;
        s->iterations = 1;
    }
    s->seconds_feedback = now() - begin;
    return status == SOLVED ? ITERATED : status;
}

/* Iterate to convergence with a line search on an exact penalty function (weights per state, three steps of memory). */
static int converge(Work *s)
{
    double past[3] = {INFINITY, INFINITY, INFINITY}, cost, violation;
    int status = ITERATION_LIMIT;
    memset(s->penalty, 0, sizeof s->penalty);
    s->hard_penalty = 0;
    s->iterations = 0, s->qp_iterations = 0;
    if (!linearise(s))
        return NOT_FINITE;
    for (s->pairs = 0; s->iterations < s->max_iterations;) {
        if (!condense(s))
            return FAILED;
        if (s->iterations >= 3) { /* Gauss-Newton steps alone are slow where errors remain large */
            feed(s);
            remember(s);
            if (!condense(s))
                return FAILED;
        }
        int done = solve_qp(s, s->iterations > 0 || !s->fresh);
        if (done != SOLVED)
            return s->iterations > 0 && done == TIME_OUT ? TIME_OUT : done;
        s->iterations++;
        gradient(s, s->g_from);
        raise_penalties(s);
        double here = merit(s, 0, &cost, &violation), wanted = merit(s, 1, NULL, NULL), t = 1, there = here;
        double predicted = fmax(here - wanted, 0);
        memcpy(s->u_from, s->u, sizeof s->u);
        memcpy(s->x_from, s->x, sizeof s->x);
        memcpy(s->k_from, s->k, sizeof s->k);
        s->step = step_size(s);
        int last = violation <= 1e-6 && (s->step <= s->tolerance ||
                                         (s->step <= 1e3 * s->tolerance && predicted <= 1e-12 * fabs(here)));
        past[s->iterations % 3] = here;
        double allowed = fmax(fmax(past[0] < INFINITY ? past[0] : here, past[1] < INFINITY ? past[1] : here),
                              past[2] < INFINITY ? past[2] : here);
        for (;;) {
            move(s, t);
            int finite = linearise(s);
            there = finite ? merit(s, 0, &cost, &violation) : INFINITY;
            if (there <= allowed - 1e-4 * t * predicted + 1e-13 * fabs(here))
                break;
            if (last || t < 1e-6 || now() > s->qp.until)
                break;
            t *= 0.5;
            memcpy(s->k, s->k_from, sizeof s->k);
        }
        s->cost = 2 * cost, s->violation = violation;
        if (!(there < INFINITY))
            return NOT_FINITE;
        if (last) {
            status = SOLVED;
            break;
        }
        if (t < 1e-6) {
            status = STALLED;
            break;
        }
        if (now() > s->qp.until)
            return TIME_OUT;
    }
    s->residual = s->step;
    return status;
}

/* Half the cost of constant inputs, from their roll-out. */
static double try_inputs(Work *s, const double *u)
{
    double cost;
    for (int i = 0; i < N; i++)
        memcpy(s->u + i * NU, u, sizeof s->applied);
    keep_inputs(s);
    roll_out(s);
    if (!linearise(s))
        return INFINITY;
    merit(s, 0, &cost, NULL);
    return cost;
}

/* The inputs held as they are, or brought to zero, whichever promises less. */
static void start_from_nothing(Work *s)
{
    static const double zero[NU];
    double relaxed = try_inputs(s, zero);
    memcpy(s->u_from, s->u, sizeof s->u);
    memcpy(s->x_from, s->x, sizeof s->x);
    memcpy(s->k_from, s->k, sizeof s->k);
    if (try_inputs(s, s->applied) > relaxed) {
        memcpy(s->u, s->u_from, sizeof s->u);
        memcpy(s->x, s->x_from, sizeof s->x);
        memcpy(s->k, s->k_from, sizeof s->k);
    }
}

/* Inputs as they were planned a step ago, the mean over each stage. */
static void shift_inputs(Work *s)
{
    for (int i = 0; i + 1 < N; i++) {
        double length = NODE(i + 1) - NODE(i);
        for (int j = 0; j < NU; j++) {
            double *u = s->u + i * NU + j;
            u[0] = ((length - 1) * u[0] + u[NU]) / length;
        }
    }
}

/* Start from the plan of the step before (CONTINUE: u, x, k as it left them), from nothing (FROM_NOTHING: constant
   inputs, states rolled out), from inputs and states (GIVEN), or from inputs (GIVEN_INPUTS: states rolled out). Only the first
   takes a fixed number of iterations. */
static void start(Work *s)
{
    for (int row = 0; row < N_LIMITS; row++) {
        s->qp.plain[QN + QR + row] = s->plain[row];
        s->qp.square[QN + QR + row] = s->square[row];
    }
    if (s->fresh == CONTINUE) {
        recall_rows(s);
        shift_inputs(s);
        memmove(s->x, s->x + NX, sizeof(double) * NS * NX);
        if (NK > 0)
            memmove(s->k, s->k + NK, sizeof(double) * (size_t)((NS - 1) * NK));
    } else {
        s->qp.k = 0;
        memset(s->k, 0, sizeof s->k);
    }
    if (s->fresh == FROM_NOTHING)
        start_from_nothing(s);
    else
        keep_inputs(s);
    if (s->fresh == GIVEN_INPUTS || N == 1)
        roll_out(s);
    else if (s->fresh == CONTINUE)
        memcpy(s->x, s->x0, sizeof s->x0);
    s->open_end = s->fresh == CONTINUE;
}

/* Everything that can be done before the state is known: shift the plan, expect its next state, linearise, condense. */
int rt_prepare(Work *s)
{
    memcpy(s->x0, s->x + NX, sizeof s->x0);
    s->fresh = CONTINUE;
    start(s);
    return prepare(s);
}

int rt_solve(Work *s)
{
    double begin = now();
    s->qp.until = begin + s->time_limit;
    start(s);
    int status;
    double limit = s->time_limit;
    if (s->fresh || s->fixed == 0) {
        status = converge(s);
        keep_inputs(s);
        s->pairs = 0;
    } else {
        status = NOT_FINITE;
        for (int64_t i = 0; i < s->fixed; i++) {
            status = prepare(s);
            s->time_limit -= now() - begin;
            if (status == SOLVED)
                status = rt_feedback(s);
            s->time_limit = limit;
            if (status != ITERATED)
                break;
            s->iterations = i + 1;
        }
        s->violation = 0;
    }
    s->seconds = now() - begin;
    return status;
}

/* ---- life ----------------------------------------------------------------------------------------------------- */

Work *rt_new(void)
{
    void *at = NULL;
    if (posix_memalign(&at, 64, sizeof(Work)))
        return NULL;
    Work *s = at;
    memset(s, 0, sizeof *s);
    Qp *q = &s->qp;
    q->n = QN, q->rates = QR, q->dense = QD;
    for (int i = 0; i < QT; i++)
        q->plain[i] = INFINITY;
    for (int k = 0, i = 0; i < N; i++)
        for (int j = 0; j < NU; j++)
            if (STEP_LOW[i * NU + j] > -INFINITY || STEP_HIGH[i * NU + j] < INFINITY) {
                q->after[k] = i * NU + j;
                q->before[k++] = i * NU + j - NU;
            }
    s->time_limit = INFINITY;
    s->tolerance = 1e-9;
    s->max_iterations = 50;
    return s;
}
void rt_free(Work *s)
{
    free(s);
}
