/* Long: one algorithm on one struct, in the order of its steps. */
/* Preparation, feedback, line search: the algorithm on the struct of work.c and the functions of stages.c. */

#define MAT(name) ((double *)s->name)

#ifdef RICCATI
static int by_stages_now(const Work *s), prepare_stages(Work *s), solve_long(Work *s, int warm), solve_inside(Work *s);
static void expect(Work *s, int many, int later), bend_stages(Work *s);
static const double *force(Work *s);
#ifdef CURVED
static int solve_saddle(Work *s), leave_saddle(Work *s, int status);
#endif
#endif

/* ---- problem data of a row of the QP -------------------------------------------------------------------------- */

static const double *limit_of(const Work *s, int row, int *stage, int *which)
{
    *stage = LIMIT_STAGE[row], *which = LIMIT_WHICH[row];
    return s->bounds + (*stage * NL + *which) * 2;
}

#ifdef EDGES
/* Limits of the distance from the path by the corridor's edges; where it is narrower than the vehicle, its middle. */
static void keep_between_edges(Work *s)
{
    for (int i = 0; i <= N; i++) {
        double right = s->corridor[2 * i], left = s->corridor[2 * i + 1], low = HALF_WIDTH - right, high = left - HALF_WIDTH;
        if (low > high)
            low = high = fabs(left) < INFINITY && fabs(right) < INFINITY ? 0.5 * (left - right) : 0;
        s->bounds[(i * NL + EDGES) * 2] = larger(low, EDGE_LOW);
        s->bounds[(i * NL + EDGES) * 2 + 1] = smaller(high, EDGE_HIGH);
    }
}
#endif

/* ---- linearisation -------------------------------------------------------------------------------------------- */

#if AHEAD
/* Whether LANES columns are those that the plan before ended with, which are linearised already. */
static int at_hand(const Work *s, int first)
{
    size_t many = (size_t)(first + LANES < NS ? LANES : NS - first);
    return !memcmp(s->x + first * NX, s->ahead_x + first * NX, sizeof(double) * NX * many) &&
           !memcmp(s->u + first * NU, s->ahead_u + first * NU, sizeof(double) * NU * many) &&
           !memcmp(s->w + first * NW, s->ahead_w + first * NW, sizeof(double) * NW * many) &&
           !memcmp(s->k + first * NK, s->ahead_k + first * NK, sizeof(double) * NK * many);
}
#endif

/* The last states are where the last steps end. */
static void fill_ends(Work *s)
{
#if JUMPS > 0
    for (int j = 0; j < (int)(sizeof END / sizeof *END); j++)
        memcpy(s->x + END[j] * NX, s->next + (END[j] - 1) * NX, sizeof s->x0);
    take_jumps(s, 0, NS, 1);
#else
    memcpy(s->x + NS * NX, s->next + (NS - 1) * NX, sizeof s->x0);
#endif
}

static int linearise(Work *s)
{
    int64_t ahead = s->ahead && s->from == FROM;
    s->spared = 0;
    for (int i = 0; i < NS; i += LANES) {
#if AHEAD
        if (ahead && at_hand(s, i)) {
            size_t many = (size_t)(i + LANES < NS ? LANES : NS - i);
            memcpy(s->k + i * NK, s->ahead_slopes + i * NK, sizeof(double) * NK * many);
            s->spared++;
            continue;
        }
#endif
        evaluate_dynamics(s, i, LANES);
    }
    s->ahead = ahead && s->spared == GROUPS;
    if (NK > 0) /* of a step after the last; `evaluate_ends` may know better */
        memcpy(s->k + NS * NK, s->k + (NS - 1) * NK, sizeof(double) * NK);
    if (s->open_end)
        fill_ends(s);
    s->open_end = 0;
    for (int i = 0; i <= N; i += LANES)
        evaluate_stage(s, i);
#ifdef CURVED
    curve(s);
#endif
    return moderate(s->next, NS * NX) && moderate(s->e, (N + 1) * NE) && moderate(s->l, (N + 1) * NL) &&
           moderate(s->A, NS * NX * NX);
}

/* What is kept of the curvature seen along a step where the old one is another (Powell); 0 where that is no curvature. */
static int damped(double old, double seen, double *keep, double *mixed)
{
    *keep = seen < 0.2 * old ? 0.8 * old / (old - seen) : 1;
    *mixed = *keep * seen + (1 - *keep) * old;
    return old > 0 && *mixed > 0;
}

/* Correct H along a step by the change of the gradient seen there (BFGS). */
static void secant(Work *s, double *H, const double *step, const double *change)
{
    double *z = s->product, keep, mixed;
    memset(z, 0, sizeof s->product);
    add_product(z, 1, H, step, N * NU);
    double old = dot(z, step, N * NU);
    if (!damped(old, dot(change, step, N * NU), &keep, &mixed))
        return;
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
#ifdef RICCATI
    if (s->by_stages) {
        add(into, 1, force(s), N * NU);
        return;
    }
#endif
    for (int row = 0; row < N_LIMITS; row++)
        if (q->lambda[QN + QR + row] != 0)
            add(into, q->lambda[QN + QR + row], (const double *)q->C + row * QL, N * NU);
}

static void feed(Work *s);

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
        size = larger(fabs(step[a]), size);
    }
    s->pairs += size > BY_ROUNDING; /* else states moved alone, which changes the gradient but is no curvature */
}

/* Column `at` of the identity, from the lane of `first` on. */
INLINE V unit_lanes(int at, int first)
{
    static const double one[2 * LANES] = {[LANES] = 1};
    V lanes = {0};
    if (at >= first && at < first + LANES)
        memcpy(&lanes, one + LANES - (at - first), sizeof lanes);
    return lanes;
}

/* A quantity by the inputs before the first one of a stage, which is `width`, from its derivatives x by the states there,
   G, and u by the inputs of that stage, if these count; zero behind. */
INLINE void by_inputs(double *to, const double *x, const int *at, int count, const double *G, const double *u, int width)
{
    for (int b = 0; b < QL; b += LANES) {
        V sum = {0};
        for (int c = 0; b < width && c < count; c++)
            sum += x[at[c]] * *(const V *)(G + at[c] * QL + b);
        for (int j = 0; u && b < width + NU && j < NU; j++)
            sum += SCALE[j] * u[j] * unit_lanes(width + j, b);
        *(V *)(to + b) = sum;
    }
}

/* Products of rows, and of their weights, into the Hessian. */
INLINE void add_squares(double *H, const double *rows, const double *weighted, int wide)
{
    for (int a = 0; a < wide; a++)
        for (int b = a / LANES * LANES; b < wide; b += LANES) {
            V sum = *(V *)(H + a * QL + b);
            for (int k = 0; k < NE; k++)
                sum += weighted[k * QL + a] * *(const V *)(rows + k * QL + b);
            *(V *)(H + a * QL + b) = sum;
        }
}

/* What the inputs themselves cost, into the Hessian. */
static void add_inputs(const Work *s, double *H)
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            int a = i * NU + j;
            double c = SCALE[j] * SCALE[j];
            H[a * QL + a] += c * (s->wr[a] + s->ws[a] + (i + 1 < N ? s->ws[a + NU] : 0));
            if (i + 1 < N)
                H[a * QL + a + NU] -= c * s->ws[a + NU];
        }
}

/* Hessian and dense rows: everything that does not depend on the state now. */
static void eliminate_states(Work *s)
{
    Qp *q = &s->qp;
    double *H = (double *)q->H, *G = MAT(G), *old = G, *new = G + NX * QL, *rows = MAT(R), *weighted = rows + M1(NE) * QL;
    memset(H, 0, sizeof q->H);
    memset(G, 0, sizeof s->G);
    int limit = 0;
    for (int i = 0; i <= N; i++) {
        int own = (i < N ? i : N - 1) * NU, width = i * NU, wide = width;
        for (int k = 0; k < NE; k++) {
            const double *x = s->E + (i * NE + k) * NX, *u = E_INPUT[k] ? s->D + (i * NE + k) * NU : NULL;
            double *row = rows + k * QL, weight = s->q[i * NE + k];
            int counts = weight > 0;
            by_inputs(row, x, E_AT + E_FIRST[k], counts ? E_FIRST[k + 1] - E_FIRST[k] : 0, old, counts && i < N ? u : NULL, width);
            for (int j = 0; counts && i == N && u && j < NU; j++)
                row[own + j] += SCALE[j] * u[j];
            for (int b = 0; b < QL; b += LANES)
                *(V *)(weighted + k * QL + b) = weight * *(V *)(row + b);
            wide = counts && u ? own + NU : wide;
        }
        add_squares(H, rows, weighted, wide);
        for (; limit < N_LIMITS && LIMIT_STAGE[limit] == i; limit++) {
            int k = LIMIT_WHICH[limit];
            double *row = (double *)q->C + limit * QL;
            const double *x = s->LX + (i * NL + k) * NX, *u = s->LU + (i * NL + k) * NU;
            by_inputs(row, x, L_AT + L_FIRST[k], L_FIRST[k + 1] - L_FIRST[k], old, i < N ? u : NULL, width);
            for (int j = 0; i == N && j < NU; j++)
                row[own + j] += SCALE[j] * u[j];
        }
        for (int m = i < N ? NODE(i) : NS; i < N && m < NODE(i + 1); m++) {
            const double *A = s->A + m * NX * NX, *B = s->B + m * NX * NU;
            for (int b = 0; b < width + NU; b += LANES) {
                chained(A, (const V *)(old + b), (V *)(new + b), QL / LANES);
                for (int j = 0; b + LANES > width && j < NU; j++) {
                    V unit = unit_lanes(width + j, b);
                    for (int a = 0; a < NX; a++)
                        *(V *)(new + a * QL + b) += SCALE[j] * B[a * NU + j] * unit;
                }
            }
            double *swap = old;
            old = new, new = swap;
        }
    }
    add_inputs(s, H);
}

/* The Hessian with its factor. If it is to `learn`, the last step is remembered. */
static int condense(Work *s, int learn)
{
    Qp *q = &s->qp;
    double *H = (double *)q->H;
    eliminate_states(s);
    if (learn)
        feed(s), remember(s);
    for (int k = 0; k < s->pairs; k++)
        secant(s, H, s->pair_s + k * QL, s->pair_y + k * QL);
    double top = 0;
    for (int a = 0; a < N * NU; a++)
        top = larger(s->own[a] = H[a * QL + a], top);
    s->top = top, s->blur = 0;
    if (!(top < INFINITY))
        return 0;
    if (s->damp > 0)
        for (int a = 0; a < N * NU; a++)
            H[a * QL + a] += s->damp * H[a * QL + a];
    for (double more = 1e-12; more < 1; more *= 100) { /* an input without effect stays where it is */
        s->blur += more * (top > 0 ? top : 1);
        for (int a = 0; a < N * NU; a++)
            H[a * QL + a] += more * (top > 0 ? top : 1);
        if (qp_factor(q))
            return 1;
    }
    return 0;
}

/* Multipliers of the dynamics carried from the end of a step of the model to its beginning, added to those there: whole
   rows of A, as what is stored by element must be waited for before it can be read again, in two sums. */
INLINE void carry_back(const double *restrict A, const double *restrict after, double *restrict before)
{
    double sum[NX] __attribute__((aligned(32))); /* or GCC 12 stores 16 bytes at a time where the stack is not so aligned */
    double other[NX] __attribute__((aligned(32)));
    for (int c = 0; c < NX; c++)
        sum[c] = before[c], other[c] = 0;
    for (int a = 0; a + 1 < NX; a += 2)
        for (int c = 0; c < NX; c++) {
            sum[c] += A[a * NX + c] * after[a];
            other[c] += A[(a + 1) * NX + c] * after[a + 1];
        }
    for (int c = 0; c < NX; c++)
        before[c] = sum[c] + other[c] + (NX % 2 ? A[(NX - 1) * NX + c] * after[NX - 1] : 0);
}

/* Where the states move in the linear model from s->x0 on: gaps closed, the inputs moved by du or, without `inputs`, not. */
INLINE void move_states(Work *s, int inputs)
{
    for (int a = 0; a < NX; a++)
        s->dx[a] = s->x0[a] - s->x[a];
    for (int m = 0; m < NS; m++) {
        const double *B = s->B + m * NX * NU, *du = s->du + STAGE_OF(m) * NU;
        double v[NX];
        for (int a = 0; a < NX; a++) {
            v[a] = s->next[m * NX + a] - s->x[(m + 1) * NX + a];
            for (int j = 0; inputs && j < NU; j++)
                v[a] += B[a * NU + j] * du[j];
        }
        follow_on(s->A + m * NX * NX, s->dx + m * NX, v, s->dx + (m + 1) * NX);
    }
}

/* Gradient and limits for the state now, relative to the iterate. */
static void feed(Work *s)
{
    Qp *q = &s->qp;
    move_states(s, 0);
    double *pi = s->pi;
    memset(pi, 0, sizeof s->pi);
    memset(q->g, 0, sizeof q->g);
    for (int i = N; i >= 0; i--) {
        const double *weight = s->q + i * NE, *dx = s->dx + NODE(i) * NX;
        int at = i < N ? i : N - 1;
        for (int m = i < N ? NODE(i + 1) - 1 : -1; m >= NODE(i); m--) {
            const double *B = s->B + m * NX * NU, *after = pi + (m + 1) * NX;
            double sum[NU] = {0};
            carry_back(s->A + m * NX * NX, after, pi + m * NX);
            for (int a = 0; a < NX; a++)
                for (int j = 0; j < NU; j++)
                    sum[j] += B[a * NU + j] * after[a];
            for (int j = 0; j < NU; j++)
                q->g[i * NU + j] += SCALE[j] * sum[j];
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
            q->lo[a] = larger((INPUT_LOW[j] - s->u[a]) / c, -s->reach);
            q->hi[a] = smaller((INPUT_HIGH[j] - s->u[a]) / c, s->reach);
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
        for (int c = L_FIRST[k]; c < L_FIRST[k + 1]; c++)
            v += lx[L_AT[c]] * s->dx[NODE(i) * NX + L_AT[c]];
        q->lo[QN + QR + row] = b[0] - v, q->hi[QN + QR + row] = b[1] - v;
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

/* Half the cost of these errors and inputs. */
INLINE double half_cost(const Work *s, const double *e, const double *u)
{
    double sum = 0;
    for (int i = 0; i < (N + 1) * NE; i++)
        sum += 0.5 * s->q[i] * e[i] * e[i];
    for (int a = 0; a < N * NU; a++) {
        double miss = u[a] - s->r[a], change = u[a] - (a < NU ? s->applied[a] : u[a - NU]);
        sum += 0.5 * (s->wr[a] * miss * miss + s->ws[a] * change * change);
    }
    return sum;
}

/* Half the cost plus penalties. */
static double merit(const Work *s, double *cost, double *violation)
{
    double sum = half_cost(s, s->e, s->u), defects = 0, worst = 0, hard = 0;
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k);
        double v = s->l[i * NL + k], excess = larger(v - b[1], b[0] - v);
        if (s->qp.plain[QN + QR + row] < INFINITY)
            sum += soft_cost(s, row, excess);
        else if (excess > 0) {
            hard += soft_cost(s, row, excess);
            worst = larger(excess, worst);
        }
    }
    for (int i = 0; i < NS * NX; i++) {
        double d = fabs(s->next[i] - s->x[NX + i]);
        defects += s->penalty[NX + i] * d;
        worst = larger(d, worst);
    }
    for (int a = 0; a < NX; a++) {
        double d = fabs(s->x[a] - s->x0[a]);
        defects += s->penalty[a] * d;
        worst = larger(d, worst);
    }
    *cost = sum, *violation = worst;
    return sum + defects + hard;
}

/* Penalties above the multipliers of the dynamics and of hard limits at the step. */
static void raise_penalties(Work *s)
{
    const Qp *q = &s->qp;
    double kept = s->step <= SETTLED ? 0 : 0.8; /* those of early, wild steps are slowly forgotten, and at once at the end */
    for (int i = 0; i < (NS + 1) * NX; i++) {
        double least = 1.5 * fabs(s->pi[i]);
        s->penalty[i] = larger(kept * s->penalty[i] + (1 - kept) * least, least);
    }
    for (int row = 0; row < N_LIMITS; row++)
        if (!(q->plain[QN + QR + row] < INFINITY))
            s->hard_penalty = larger(1.5 * fabs(q->lambda[QN + QR + row]), s->hard_penalty);
}

/* ---- truth ---------------------------------------------------------------------------------------------------- */

/* What the linear model makes of the step: errors and limited quantities after it, multipliers of the dynamics, and the
   curvature of the cost along it. */
static void promise(Work *s)
{
    const Qp *q = &s->qp;
    double *pi = s->pi, bend = 0;
    int row = N_LIMITS - 1;
    memset(pi, 0, sizeof s->pi);
    for (int i = N; i >= 0; i--) {
        const double *weight = s->q + i * NE, *dx = s->dx + NODE(i) * NX;
        const double *du = s->du + (i < N ? i : N - 1) * NU;
        for (int m = i < N ? NODE(i + 1) - 1 : -1; m >= NODE(i); m--)
            carry_back(s->A + m * NX * NX, pi + (m + 1) * NX, pi + m * NX);
        for (int k = 0; k < NE; k++) {
            const double *ex = s->E + i * NE * NX + k * NX, *eu = s->D + i * NE * NU + k * NU;
            double v = 0;
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                v += ex[E_AT[c]] * dx[E_AT[c]];
            if (E_INPUT[k])
                for (int j = 0; j < NU; j++)
                    v += eu[j] * du[j];
            bend += weight[k] * v * v;
            v += s->e[i * NE + k];
            s->e_after[i * NE + k] = v;
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                pi[NODE(i) * NX + E_AT[c]] += ex[E_AT[c]] * weight[k] * v;
        }
        for (; row >= 0 && LIMIT_STAGE[row] == i; row--) {
            int k = LIMIT_WHICH[row];
            const double *lx = s->LX + i * NL * NX + k * NX, *lu = s->LU + i * NL * NU + k * NU;
            double v = s->l[i * NL + k], lambda = q->lambda[QN + QR + row];
            for (int c = L_FIRST[k]; c < L_FIRST[k + 1]; c++)
                v += lx[L_AT[c]] * dx[L_AT[c]];
            for (int j = 0; j < NU; j++)
                v += lu[j] * du[j];
            s->l_after[row] = v;
            if (lambda != 0)
                for (int c = L_FIRST[k]; c < L_FIRST[k + 1]; c++)
                    pi[NODE(i) * NX + L_AT[c]] += lx[L_AT[c]] * lambda;
        }
    }
    for (int a = 0; a < N * NU; a++) {
        double change = s->du[a] - (a < NU ? 0 : s->du[a - NU]);
        bend += s->wr[a] * s->du[a] * s->du[a] + s->ws[a] * change * change;
    }
    s->bend = bend;
}

/* Largest change of an input, in units of its range. */
static double step_size(const Work *s)
{
    double worst = 0;
    for (int a = 0; a < N * NU; a++)
        worst = larger(worst, fabs(s->qp.u[a]));
    return worst;
}

/* One over 1 + the mean change of each column from row to row, which does not depend on where zero is. */
INLINE void units(const double *rows, int count, int wide, double *to)
{
    for (int a = 0; a < wide; a++)
        to[a] = 0;
    for (int i = 0; i + 1 < count; i++)
        for (int a = 0; a < wide; a++)
            to[a] += fabs(rows[(i + 1) * wide + a] - rows[i * wide + a]);
    for (int a = 0; a < wide; a++)
        to[a] = 1 / (1 + to[a] / (double)(count - 1));
}

/* How good the iterate is after a full step, from the values there: its cost, the largest defect of the dynamics or
   excess over a hard limit, and a residual, the largest of these in `units` and of what is left of stationarity. For
   the last: terms of the Lagrangian beyond the model that the step was computed with, over the curvature of that model
   along the step, are about the share of the step by which the next one corrects it. Ends of steps are where
   `look_ahead` leaves them, or each in its place. */
static void judge(Work *s, int ahead)
{
    const Qp *q = &s->qp;
    double half = half_cost(s, s->e, s->u), beyond = 0, worst = 0, off = 0, reach = s->step, of_x[NX], of_l[M1(NL)];
    units(s->x, NS + 1, NX, of_x);
    if (NL > 0)
        units(s->l, N + 1, NL, of_l);
    for (int i = 0; i < (N + 1) * NE; i++)
        beyond += fabs(s->q[i] * s->e[i] * (s->e[i] - s->e_after[i]));
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k);
        double v = s->l[i * NL + k], excess = larger(v - b[1], b[0] - v);
        beyond += fabs(q->lambda[QN + QR + row] * (v - s->l_after[row]));
        if (q->plain[QN + QR + row] < INFINITY)
            half += soft_cost(s, row, excess);
        else if (excess > 0)
            worst = larger(excess, worst), off = larger(excess * of_l[k], off);
    }
    double part[NX] = {0}, most[NX] = {0}, moved[NX] = {0}; /* of each state; `beyond` shows what is no number */
    for (int m = 0; m < NS; m++) {
        const double *end = s->next + (!ahead ? m : m ? m - 1 : NS) * NX;
        for (int a = 0; a < NX; a++) {
            double d = fabs(end[a] - s->x[NX + m * NX + a]);
            part[a] += fabs(s->pi[NX + m * NX + a]) * d;
            most[a] = larger(most[a], d);
            moved[a] = larger(moved[a], fabs(s->dx[NX + m * NX + a]));
        }
    }
    for (int a = 0; a < NX; a++) {
        beyond += part[a], worst = larger(worst, most[a]);
        off = larger(off, most[a] * of_x[a]), reach = larger(reach, moved[a] * of_x[a]);
    }
    s->cost = 2 * half, s->violation = worst;
    s->residual = larger(reach * (2 * beyond < s->bend ? 2 * beyond / s->bend : 1), larger(q->kkt, off));
    if (!(half < INFINITY && worst < INFINITY && beyond * 0 == 0))
        s->violation = s->residual = INFINITY;
}

/* Inputs decided some steps ago, for the stages from now on: the mean over each, the last one going on. */
static void inputs_after(const double *from, int later, double *to)
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            double sum = 0;
            for (int m = NODE(i); m < NODE(i + 1); m++)
                sum += from[STAGE_OF(m + later < NS ? m + later : NS - 1) * NU + j];
            to[i * NU + j] = sum / (double)(NODE(i + 1) - NODE(i));
        }
}

/* The same after the values, without derivatives, have been found. */
static void check(Work *s)
{
    if (NS > N)
        inputs_after(s->u, 1, s->u_later);
    for (int i = (NS - !(NK > 0 && SPARE)) / LANES * LANES; i >= 0; i -= LANES) /* the step after the last one first */
        evaluate_ends(s, i);
    for (int i = 0; i <= N; i += LANES)
        evaluate_errors(s, i);
    judge(s, 0);
}

#if AHEAD
/* The same from the linearisation at the iterate, a step later, with which the next plan starts. */
static void look_ahead(Work *s)
{
#if DYNAMICS == RADAU
    double along[NS + 1];
    for (int i = NS / LANES * LANES; i >= 0; i -= LANES) /* the step after the last one first, from where that was */
        move_slopes(s, i, along);
    for (int i = 0; i <= NS; i += 8)
        correct_slopes(s, i, along);
#endif
    int good = 1;
    s->from = FROM;
    for (int i = 0; i <= NS; i += LANES)
        good &= evaluate_later(s, i);
    s->from = 0;
    memcpy(s->ahead_x, s->x + NX, sizeof s->ahead_x);
    inputs_after(s->u, 1, s->ahead_u);
    memcpy(s->ahead_w, s->w + NW, sizeof(double) * N * NW);
    memcpy(s->ahead_k, s->k + NK, sizeof(double) * NS * NK);
    s->ahead = good;
    for (int i = 0; i <= N; i += LANES)
        evaluate_errors(s, i);
    judge(s, 1);
}
#endif

static int accepted(const Work *s) { return s->residual <= s->accept; }

/* ---- time ----------------------------------------------------------------------------------------------------- */

/* Whether a part of an iteration can still be finished, if it takes as long as the last time. */
static int begins(Work *s, int part)
{
    if (!(s->qp.until < INFINITY))
        return 1;
    s->since = now(&s->qp);
    if (s->since + s->took[part] <= s->qp.until)
        return 1;
    s->took[part] *= 0.8; /* that may have been an exception */
    return 0;
}
static void ends(Work *s, int part)
{
    if (!(s->qp.until < INFINITY)) /* a look at the clock takes a hundredth of a short plan's time */
        return;
    double took = now(&s->qp) - s->since; /* much longer than ever: another program had the processor */
    s->took[part] = s->took[part] > 0 ? smaller(took, 2 * s->took[part]) : took;
}

/* Whether the next step is tried with all curvature of the Lagrangian, negative one too, which has an answer where that of
   the rows that are held is positive. */
INLINE int all_curvature(const Work *s)
{
#ifdef CURVED
    return s->saddle && s->damp == 0;
#else
    (void)s;
    return 0;
#endif
}

/* The quadratic program at the iterate, without what depends on the state now: condensed or, if that may be, by stages.
   If it is to `learn`, the last step is remembered. */
static int pose(Work *s, int by_stages, int learn)
{
#ifdef RICCATI
    s->by_stages = by_stages && (s->damp == 0 || N >= MANY) && s->pairs + learn <= FEW &&
                   (GROWS || s->unstable || by_stages_now(s));
    s->by_stages |= by_stages && all_curvature(s);
    if (s->by_stages) {
        if (!begins(s, BY_STAGES))
            return TIME_OUT;
        s->by_stages = prepare_stages(s);
        if (s->by_stages && learn)
            feed(s), remember(s), learn = 0;
        if (s->by_stages && !all_curvature(s))
            bend_stages(s);
        ends(s, BY_STAGES);
        if (s->by_stages)
            return SOLVED;
    }
#endif
    (void)by_stages;
    if (!begins(s, CONDENSE))
        return TIME_OUT;
    int good = condense(s, learn);
    ends(s, CONDENSE);
    return good ? SOLVED : FAILED;
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
    if (!moderate(s->u, N * NU))
        return;
    for (int i = 0; i < N; i++)
        for (int j = 0; j < NU; j++) {
            int a = i * NU + j;
            double before = i ? s->u[a - NU] : s->applied[j], u = s->u[a];
            u = smaller(larger(u, before + STEP_LOW[a]), before + STEP_HIGH[a]);
            s->u[a] = smaller(larger(u, INPUT_LOW[j]), INPUT_HIGH[j]);
        }
}

/* States that the inputs lead to; where time runs out, they stay as they are. */
static void roll_out(Work *s)
{
    memcpy(s->x, s->x0, sizeof s->x0);
    memset(s->k, 0, sizeof s->k);
    for (int m = 0, late = 0; m < NS; m++) {
        late = late || (s->qp.until < INFINITY && now(&s->qp) > s->qp.until);
        if (!late)
            evaluate_dynamics(s, m, 1);
        memcpy(s->x + (m + 1) * NX, late ? s->x + m * NX : s->next + m * NX, sizeof s->x0);
    }
}

/* States that stay where the vehicle is now, but for jumps. */
static void stay(Work *s)
{
    memcpy(s->x, s->x0, sizeof s->x0);
    memset(s->k, 0, sizeof s->k);
    for (int m = 0; m < NS; m++) {
        memcpy(s->next + m * NX, s->x + m * NX, sizeof s->x0);
        take_jumps(s, m, 1, 0);
        memcpy(s->x + (m + 1) * NX, s->next + m * NX, sizeof s->x0);
    }
}

static int prepare(Work *s)
{
    int status = TIME_OUT;
    if (s->ahead || begins(s, LINEARISE)) {
        s->from = FROM;
        status = linearise(s) ? SOLVED : NOT_FINITE;
        s->from = 0;
        if (!s->spared)
            ends(s, LINEARISE);
    }
    if (status == SOLVED)
        status = pose(s, 1, 0);
    return status == FAILED ? NOT_FINITE : status;
}

/* The rows that the last quadratic program ended with travel with the plan: another work area starts from the same. */
static void keep_rows(Work *s)
{
    const Qp *q = &s->qp;
    int many = 0;
    for (int a = 0; a < q->k; a++) {
        s->working[1 + 2 * many] = (double)q->row[a];
        s->working[2 + 2 * many++] = q->sign[a] * (double)(1 + q->mode[q->row[a]]);
    }
#ifdef RICCATI
    for (int i = 0; i < QT; i++)
        if (q->mode[i] == SPENT) {
            s->working[1 + 2 * many] = (double)i;
            s->working[2 + 2 * many++] = (double)((q->lambda[i] > 0 ? 1 : -1) * (1 + SPENT));
        }
    expect(s, many, 0);
#endif
    s->working[0] = (double)many;
}

static void recall_rows(Work *s)
{
    Qp *q = &s->qp;
    char seen[QT] = {0};
    int most = QN;
    q->k = 0;
#ifdef RICCATI
    most = QT;
    s->stages.expected = 0;
#endif
    if (!(s->working[0] >= 0 && s->working[0] <= (double)most))
        return;
#ifdef RICCATI
    expect(s, (int)s->working[0], NS == N);
#endif
    for (int a = 0, many = (int)s->working[0]; a < many; a++) {
        double row = s->working[1 + 2 * a], how = s->working[2 + 2 * a];
        if (!(row >= 0 && row < QT && fabs(how) >= 1 + KEPT && fabs(how) < 2 + PAID) || q->k == QN || seen[(int)row]++)
            continue; /* whoever wrote that */
        q->row[q->k] = (int)row;
        q->sign[q->k++] = how > 0 ? 1 : -1;
        q->mode[(int)row] = fabs(how) >= 1 + PAID && q->square[(int)row] > 0 ? PAID : KEPT;
    }
}

static void forget_rows(Work *s)
{
    s->qp.k = 0;
#ifdef RICCATI
    s->stages.expected = 0;
#endif
}

#ifdef RICCATI
#define FRAIL 1e10 /* curvature of states that inputs only steer, over that where they also hold them: the digits lost */

/* By stages, as long as it is posed so: with all curvature, with what is remembered of earlier steps, and without. What is
   condensed in the end, as that one says why or solves it, is QP_NUMBER; whether it could be is `posed`. */
static int solve_by_stages(Work *s, int warm, int *posed)
{
    int status = QP_NUMBER;
#ifdef CURVED
    s->tried = s->saddle = s->by_stages && all_curvature(s);
    if (s->tried) {
        status = solve_saddle(s);
        s->saddle = status == QP_SOLVED;
        if (status == QP_NUMBER)
            *posed = pose(s, 1, 0);
    }
#endif
    while (s->by_stages && status == QP_NUMBER && *posed == SOLVED) {
        status = solve_long(s, warm);
        if (status == QP_NUMBER) {
            int again = N >= MANY && s->stages.bends.count > 0;
            s->pairs = again ? 0 : s->pairs;
            *posed = pose(s, again, 0);
            s->frail = !s->by_stages && s->top > FRAIL * s->stages.top;
        }
    }
    return status;
}

/* What condensing does not solve, by an interior point; or still so. */
static int solve_otherwise(Work *s, int status)
{
    if (!prepare_stages(s))
        return status;
    int other = solve_inside(s);
    s->by_stages = other == QP_SOLVED;
    return other == QP_SOLVED || other == QP_LATE ? other : status;
}
#endif

#define THICKEST 1e-5

/* What rounding keeps from an answer, as where two inputs do the same and neither has a weight, with more curvature by
   each input: a shorter step, whose end is the same. */
static int solve_thicker(Work *s, int status)
{
    double *H = (double *)s->qp.H;
    for (double more = 1e-10; more < THICKEST && (status == QP_NUMBER || status == QP_LIMIT); more *= 100) {
        s->blur += more * s->top;
        for (int a = 0; a < N * NU; a++)
            H[a * QL + a] += more * s->top;
        if (!qp_factor(&s->qp))
            continue;
        status = qp_solve(&s->qp, 0);
        s->qp_iterations += s->qp.iterations;
    }
    return status;
}

static int solve_condensed(Work *s, int warm)
{
#ifdef RICCATI
    if (s->frail) {
        int status = solve_otherwise(s, QP_NUMBER);
        s->frail = status == QP_NUMBER;
        if (!s->frail)
            return status;
    }
#endif
    int status = qp_solve(&s->qp, warm);
    s->qp_iterations += s->qp.iterations;
    if (status == QP_NUMBER && s->qp.kkt <= 1e-6) /* wildly scaled, but good enough for a step; `residual` says it */
        return QP_SOLVED;
#ifdef RICCATI
    if ((status == QP_NUMBER || status == QP_LIMIT) && !s->frail)
        status = solve_otherwise(s, status);
    if (s->by_stages || s->frail)
        return status;
#endif
    return solve_thicker(s, status);
}

#ifdef RICCATI
#define ASTRAY 1e5 /* times that a step goes farther without its inputs: its digits are lost by the square, and one more is due */

/* Largest change of a state over the horizon, in `units`. */
static double farthest(const Work *s)
{
    double of_x[NX], most = 0;
    units(s->x, NS + 1, NX, of_x);
    for (int i = 0; i < (NS + 1) * NX; i++)
        most = larger(fabs(s->dx[i]) * of_x[i % NX], most);
    return most;
}
#endif

static int solve_qp(Work *s, int warm)
{
    int status = QP_NUMBER;
    s->frail = 0;
    feed(s);
#ifdef RICCATI
    int posed = SOLVED;
    double unheld = s->by_stages ? farthest(s) : 0;
    status = solve_by_stages(s, warm, &posed);
    if (posed != SOLVED)
        return posed;
#endif
    if (status == QP_NUMBER)
        status = solve_condensed(s, warm);
    keep_rows(s);
    static const int outcome[] = {SOLVED, INFEASIBLE, FAILED, TIME_OUT, FAILED};
    if (status == QP_SOLVED) {
        for (int a = 0; a < N * NU; a++)
            s->du[a] = SCALE[a % NU] * s->qp.u[a];
        move_states(s, 1);
#ifdef RICCATI
        s->astray |= s->by_stages && unheld > ASTRAY * farthest(s);
#endif
        promise(s);
        s->step = step_size(s);
        memcpy(s->u_from, s->u, sizeof s->u);
        memcpy(s->x_from, s->x, sizeof s->x);
        memcpy(s->k_from, s->k, sizeof s->k);
    }
    return outcome[status];
}

#define BLURRED 1e-9   /* of half an input's range, and of the cost, that may be left */

/* Whether a condensed program whose step is all but none may leave cost: what was added to the curvature so that there is
   a factor is more than the weights of the inputs, as where states grow much over the horizon. */
static int blurred(const Work *s, double cost)
{
    double left = 0;
    for (int a = 0; a < N * NU && !s->by_stages; a++) {
        double weight = SCALE[a % NU] * SCALE[a % NU] * (s->wr[a] + s->ws[a]), push = s->blur * fabs(s->qp.u[a]);
        double own = weight > 0 ? weight : s->own[a];
        if (own > 0 && push > BLURRED * own)
            left += push * push / own;
    }
    return left > BLURRED * cost;
}

#define GROWN 1e13 /* times that a state grows over the horizon, after which rounding leaves no digit of where inputs lead */

/* Whether the model multiplies some state by so much, from the first step on or from after a jump. */
static int outgrown(const Work *s)
{
    double by[NX * NX] = {0}, next[NX * NX];
    for (int m = 0, anew = 1; m < NS; m++, anew = 0) {
#if JUMPS > 0
        int skip = 0;
        for (int j = 0; j < JUMPS; j++)
            skip |= JUMP[j] == m, anew |= JUMP[j] == m - 1;
        if (skip)
            continue;
#endif
        const double *A = s->A + m * NX * NX;
        memset(next, 0, sizeof next);
        for (int a = 0; a < NX && !anew; a++)
            for (int c = 0; c < NX; c++)
                add(next + a * NX, A[a * NX + c], by + c * NX, NX);
        memcpy(by, anew ? A : next, sizeof by);
        for (int a = 0; a < NX; a++)
            if (!(fabs(by[a * NX + a]) <= GROWN))
                return 1;
    }
    return 0;
}

/* Whether digits are lost that no further step brings back. */
static int hidden(const Work *s)
{
#ifdef RICCATI
    return (GROWS || s->astray) && outgrown(s);
#else
    (void)s;
    return 0;
#endif
}

/* Full step of the prepared problem from the state now; what it led to is linearised if it is the `last` one. */
static int feedback(Work *s, int last)
{
    int status = solve_qp(s, !s->fresh);
    if (status == SOLVED) {
        move(s, 1);
        memcpy(s->x, s->x0, sizeof s->x0);
        keep_inputs(s);
#if AHEAD
        if (last && begins(s, LINEARISE)) {
            look_ahead(s);
            ends(s, LINEARISE);
        } else
#endif
            check(s);
        (void)last;
        s->iterations++;
    }
    return status == SOLVED ? ITERATED : status;
}

/* Half the cost, and soft excess, after the step by the linear model. */
static double promised(const Work *s)
{
    double u[N * NU];
    for (int a = 0; a < N * NU; a++)
        u[a] = s->u_from[a] + s->du[a];
    double sum = half_cost(s, s->e_after, u);
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k);
        if (s->qp.plain[QN + QR + row] < INFINITY)
            sum += soft_cost(s, row, larger(s->l_after[row] - b[1], b[0] - s->l_after[row]));
    }
    return sum;
}

/* No time to linearise after the step: take it whole, or a quarter of it if the values there are worse. */
static int step_late(Work *s, double t, double allowed)
{
    double cost, violation;
    move(s, t);
    if (t < 1)
        return TIME_OUT;
    check(s);
    if (accepted(s))
        return ITERATED;
    if (!(merit(s, &cost, &violation) <= allowed)) {
        memcpy(s->k, s->k_from, sizeof s->k);
        move(s, 0.25);
        s->violation = s->residual = INFINITY;
    }
    return TIME_OUT;
}

/* Hard limits at a price, where no step keeps them, or, without one, hard again. */
static void price_limits(Work *s, double price)
{
    for (int row = 0; row < N_LIMITS; row++)
        if (!(s->plain[row] < INFINITY))
            s->qp.plain[QN + QR + row] = price > 0 ? price : INFINITY;
}

static int has_hard(const Work *s)
{
    int many = 0;
    for (int row = 0; row < N_LIMITS; row++)
        many += !(s->plain[row] < INFINITY);
    return many > 0;
}

/* What hard limits cost at first: more than any input gains by missing them here. */
static double first_price(const Work *s)
{
    double most = 0;
    for (int a = 0; a < N * NU; a++)
        most = larger(most, fabs(s->qp.g[a]));
    return 10 * (1 + most);
}

/* Largest excess over a hard limit of these values of the rows, or, without, of those at the iterate. */
static double largest_excess(const Work *s, const double *values)
{
    double worst = 0;
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k);
        double v = values ? values[row] : s->l[i * NL + k];
        if (!(s->plain[row] < INFINITY))
            worst = larger(worst, larger(v - b[1], b[0] - v));
    }
    return worst;
}

/* Largest multiplier of a hard limit without a price at the step. */
static double largest_multiplier(const Work *s)
{
    double most = 0;
    for (int i = QN + QR; i < QN + QR + N_LIMITS; i++)
        if (!(s->qp.plain[i] < INFINITY))
            most = larger(most, fabs(s->qp.lambda[i]));
    return most;
}

/* Whether the step, which may use all that inputs can do, leaves nearly as much excess over hard limits as there is. */
static int leaves_excess(const Work *s)
{
    double here = 0, after = 0;
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        const double *b = limit_of(s, row, &i, &k);
        double v = s->l[i * NL + k], w = s->l_after[row];
        if (s->plain[row] < INFINITY)
            continue;
        here += larger(larger(v - b[1], b[0] - v), 0);
        after += larger(larger(w - b[1], b[0] - w), 0);
    }
    return after >= STAYS * here;
}

/* Back to where the last, useless step began, after one that was no larger than rounding; whether that is an answer. */
static int back(Work *s, double whole)
{
    double cost, violation;
    memcpy(s->u, s->u_from, sizeof s->u);
    memcpy(s->x, s->x_from, sizeof s->x);
    memcpy(s->k, s->k_from, sizeof s->k);
    if (!linearise(s))
        return 0;
    merit(s, &cost, &violation);
    s->cost = 2 * cost, s->violation = larger(violation, largest_excess(s, NULL)), s->residual = whole;
    return 1;
}

#define TELLING 1e-5 /* of the merit, that no last step promises */
#define FIRST 1e-9   /* of the merit at first, which counts where there is nearly none left */
#define HIDDEN 1e-3  /* of the cost, or of the merit at first, that what is missed may cost by its multipliers in the end */

#ifdef CURVED
#define LONGEST 4 /* most steps between two tries of all curvature */

/* All curvature is tried after whole steps; where that led nowhere, one step later, then two, then four. */
static void choose_curvature(Work *s, double t)
{
    if (s->tried) {
        s->failed = s->saddle && t == 1 ? 0 : s->failed + 1;
        s->rest = s->failed > 2 ? LONGEST : s->failed;
    }
    s->saddle = t == 1 && s->rest-- <= 0 && has_negative(s);
}
#endif

/* Steps that promise nothing that tells, one after the other: how many, and the smallest, now and by the last look at them. */
typedef struct {
    int64_t steps;
    double least, before;
} Tail;

/* Whether, at the pace at which they contract, more are to come than there were, `n`, and than patience has. */
static int lingers(const Work *s, Tail *tail, int still, int64_t n)
{
    tail->steps = still ? tail->steps + 1 : 0;
    if (tail->steps <= 1)
        tail->least = tail->before = s->step;
    tail->least = smaller(s->step, tail->least);
    if (tail->steps % IDLE != 1 || tail->steps == 1)
        return 0;
    double pace = log(tail->least / tail->before) / IDLE;
    tail->before = tail->least;
    return log(s->tolerance / tail->least) < pace * (double)(n > PATIENCE ? n : PATIENCE);
}

/* Iterate to convergence with a line search on an exact penalty function (weights per state, three steps of memory),
   damped after short steps; or, if `loose`, until the iterate is accepted. An unfinished iterate stays where it is. */
static int converge(Work *s, int64_t most, int loose)
{
    double past[3] = {INFINITY, INFINITY, INFINITY}, cost, violation, least = INFINITY;
    int status = ITERATION_LIMIT, idle = 0, circling = 0; /* circling: small steps in a row that lower the merit no more */
    double lowest = INFINITY;                             /* merit before such steps */
    double price = 0, dearest = 0, miss = 0; /* miss: of limits by the step, at a price */
    int paid = 0;                            /* for that: no plan yet, however small what is left */
    double whole = INFINITY;                 /* size of the last step, if near and taken so */
    double begun = 0;                        /* merit at first */
    memset(s->penalty, 0, sizeof s->penalty);
    s->curved = s->fresh == HANDED_OVER, s->step = INFINITY;
#ifdef CURVED
    s->saddle = s->tried = s->failed = s->rest = 0;
#endif
    s->hard_penalty = 0, s->pairs = 0, s->damp = 0;
    int calm = 0, soft = 0; /* soft: hard limits have their price even where a step keeps them */
    int settled = 0, stays = 0; /* at a lower price, just before; steps in a row that leave the excess at the highest one */
    Tail tail = {0};
    int64_t priced = 0, neared = 0; /* iterations when that price was set, and when the violation was `nearest` to none */
    double nearest = INFINITY;
    if (!begins(s, LINEARISE))
        return TIME_OUT;
    if (!linearise(s))
        return NOT_FINITE;
    ends(s, LINEARISE);
#ifdef CURVED
    s->saddle = s->curved && has_negative(s);
#endif
    for (int64_t n = 0; n < most;) {
        int posed = pose(s, 1, calm >= CALM); /* Gauss-Newton steps alone are slow where errors remain large */
        if (posed != SOLVED)
            return posed;
        if (soft)
            price_limits(s, price);
        int done = solve_qp(s, n > 0 || !s->fresh), whole_price = 1;
        if ((done == INFEASIBLE || done == FAILED) && N_LIMITS > 0) { /* here: limits at a price may lead elsewhere */
            if (price == 0)
                price = first_price(s), dearest = PRICES * price, priced = n;
            double last_part = has_hard(s) ? 1e-3 : 0.5; /* without any, a price changes nothing */
            for (double part = 1; part > last_part && (done == INFEASIBLE || done == FAILED); part *= 0.1) {
                if (N >= MANY && !s->by_stages && (posed = pose(s, 1, 0)) != SOLVED)
                    return posed;
                price_limits(s, part * price);
                whole_price = part == 1;
                forget_rows(s);
                done = solve_qp(s, 0);
            }
        }
        if (done == FAILED && settled && price >= dearest && miss > 1e-6) /* at a price so high that numbers fail */
            return INFEASIBLE;
        if (done != SOLVED)
            return done;
        s->curved = 1;
        miss = N_LIMITS > 0 && price > 0 ? largest_excess(s, s->l_after) : 0;
        paid = miss > 1e-8;
        int all = whole_price && !(s->reach < INFINITY) && (settled || price >= dearest); /* that inputs can do */
        stays = paid && all && leaves_excess(s) ? stays + 1 : 0;
        if (stays >= (settled ? 1 : STAYED)) /* nothing brings the limits nearer */
            return INFEASIBLE;
        settled = 0, n++, s->iterations++, calm++;
        gradient(s, s->g_from);
        raise_penalties(s);
        if (price > 0 && !soft && n >= PATIENCE / 2 && largest_multiplier(s) > STRAINED * price) /* limits are only just kept */
            soft = 1, priced = n;
        double here = merit(s, &cost, &violation), t = 1, there = here, predicted = larger(here - promised(s), 0);
        begun = n == 1 ? here : begun;
        /* where the cost no longer tells steps apart they are taken whole, for as long as they shrink */
        int near = violation <= 1e-6 && s->damp <= 1e-8, flat = near && s->step <= FLAT && predicted <= 1e-12 * fabs(here);
        idle += flat && s->step > 0.9 * least;
        least = flat ? smaller(s->step, least) : least;
        int may_rise = miss > 1e-6 && price < dearest; /* of the price: the last digits are not worth their steps */
        int still = predicted <= TELLING * larger(here, FIRST * begun); /* else curvature of multipliers long gone holds it there */
        int small = near && s->step <= FLAT && still && !paid, lower = here < lowest - 1e-12 * fabs(here);
        circling = small && !lower ? circling + 1 : 0; /* as where a limit that hardly counts comes and goes */
        int around = circling >= 2 * IDLE || (circling >= IDLE && here > lowest + 1e-12 * fabs(here)); /* back to the lowest */
        lowest = small ? smaller(here, lowest) : INFINITY;
        idle = around ? IDLE : idle;
        int slow = lingers(s, &tail, still && violation <= FEASIBLE && !paid, n);
        int last = near && !s->frail && ((may_rise ? s->step <= SETTLED : s->step <= s->tolerance && still) || idle >= IDLE);
        int hazy = last && (blurred(s, cost) || outgrown(s));
#ifdef RICCATI
        if (hazy && !s->unstable)
            s->unstable = 1, hazy = last = idle = 0;
#endif
        past[(int)(n % 3)] = here;
        double allowed = fmax(fmax(past[0] < INFINITY ? past[0] : here, past[1] < INFINITY ? past[1] : here),
                              past[2] < INFINITY ? past[2] : here);
        for (;;) {
            if (!begins(s, LINEARISE)) {
                status = step_late(s, t, allowed);
                if (paid) {
                    s->violation = s->residual = INFINITY;
                    return TIME_OUT;
                }
                return last && !hazy ? SOLVED : status;
            }
            move(s, t);
            int finite = linearise(s);
            ends(s, LINEARISE);
            there = finite ? merit(s, &cost, &violation) : INFINITY;
            if (there <= allowed - 1e-4 * t * predicted + 1e-13 * fabs(here) || last || (flat && there < INFINITY) || t < 1e-6)
                break;
            t *= 0.5;
            s->shortened = 1;
            memcpy(s->k, s->k_from, sizeof s->k);
        }
        if (!(there < INFINITY))
            return NOT_FINITE;
        if (price > 0)
            price_limits(s, 0);
        judge(s, 0);
        if (t < 1)
            s->residual = INFINITY;
        s->cost = 2 * cost, s->violation = price > 0 ? larger(violation, largest_excess(s, NULL)) : violation;
        if (last && !paid && there - cost > HIDDEN * larger(cost, begun)) /* under multipliers beyond all numbers */
            return FAILED;
        if (hazy && !paid)
            return STALLED;
        if (last && !paid) {
            s->residual = s->step;
            return SOLVED;
        }
        if (last || (paid && t < 1e-6)) { /* as near as this price brings it */
            if (price >= dearest)
                return INFEASIBLE;
            price *= 100, priced = n, idle = 0, least = INFINITY, settled = last;
            continue;
        }
        if (loose && accepted(s) && !paid && !blurred(s, cost + 0.5 * s->bend))
            return hidden(s) ? STALLED : ITERATED;
        if (t < 1e-6)
            return !outgrown(s) && near && whole <= ROUNDED && back(s, whole) ? SOLVED : STALLED;
        if (paid && price < dearest && n - priced >= PATIENCE) /* it wanders at this price */
            price *= 100, priced = n;
        if (s->violation < 0.9 * nearest)
            nearest = s->violation, neared = n;
        if (loose && nearest > FEASIBLE && n - neared >= (paid ? NO_NEARER_PAID : NO_NEARER))
            return paid ? INFEASIBLE : ITERATION_LIMIT;
        if (loose && n >= CONTENT && s->violation <= FEASIBLE && !paid)
            return ITERATION_LIMIT;
        if (s->hands_over && (slow || (!paid && nearest > FEASIBLE && n - neared >= 2 * PATIENCE)))
            return ITERATION_LIMIT;
        if (N_LIMITS > 0 && !soft && nearest > FEASIBLE && n - neared >= PATIENCE) { /* or about limits that are just kept */
            price = price > 0 ? price : first_price(s), dearest = dearest > 0 ? dearest : PRICES * price;
            soft = 1, priced = n;
        }
        if (t == 1)
            s->reach = 2 * s->reach < FREE ? 2 * s->reach : INFINITY;
        whole = near && t == 1 && !s->frail ? s->step : INFINITY;
#ifdef CURVED
        choose_curvature(s, t);
#endif
        if (t == 1 && (!soft || here - there >= GAIN * predicted))
            s->damp = s->damp > 1e-4 ? 0.2 * s->damp : 0;
        else if (t <= 0.25 && s->step > FAR) { /* where the model of the step does not hold, nor remembered steps */
            s->damp = fmax(4 * s->damp, 1e-3);
            s->pairs = 0, calm = 0;
        }
    }
    if (stays && nearest > FEASIBLE) /* which nothing is where limits were kept on the way */
        return INFEASIBLE;
    int good = accepted(s) && !paid && (loose || s->fixed > 0) && !outgrown(s); /* fixed 0: to the optimum, as asked */
    return good ? ITERATED : ITERATION_LIMIT;
}

/* States that stay go straight to where hard limits want them in the end. */
static void head_for_end(Work *s)
{
    double by[NX] = {0};
    evaluate_stage(s, N / LANES * LANES);
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k, at = -1, parts = 0;
        const double *b = limit_of(s, row, &i, &k), *x = s->LX + (i * NL + k) * NX, *u = s->LU + (i * NL + k) * NU;
        double v = s->l[i * NL + k], way = larger(b[0] - v, 0) - larger(v - b[1], 0);
        for (int a = 0; a < NX; a++)
            if (x[a] != 0)
                at = a, parts++;
        for (int j = 0; j < NU; j++)
            parts += u[j] != 0;
        if (i == N && !(s->plain[row] < INFINITY) && parts == 1 && at >= 0 && fabs(way) < INFINITY)
            by[at] = way / x[at];
    }
    for (int m = 1; m <= NS; m++)
        for (int a = 0; a < NX; a++)
            s->x[m * NX + a] += by[a] * ((double)m / (double)NS);
}

/* States that stay are where tracked ones are wanted from the first step on. A plant that is not stable leaves no other
   states that are sure to be numbers: those that inputs lead to are soon beyond all, and so is what changes of an input
   lead to from where it is now. */
static void take_wanted(Work *s)
{
    for (int i = 0; i <= N; i += LANES)
        evaluate_stage(s, i);
    for (int i = 1; i <= N; i++)
        for (int k = 0; k < NE; k++) {
            const double *x = s->E + (i * NE + k) * NX, *u = s->D + (i * NE + k) * NU;
            int at = -1, parts = !(s->q[i * NE + k] > 0);
            for (int a = 0; a < NX; a++)
                if (x[a] != 0)
                    at = a, parts++;
            for (int j = 0; j < NU; j++)
                parts += u[j] != 0;
            for (int m = NODE(i - 1) + 1; parts == 1 && at >= 0 && m <= NODE(i); m++)
                s->x[m * NX + at] -= s->e[i * NE + k] / x[at];
        }
}

enum { STAY, HEAD_FOR_END, ROLL_OUT, AS_WANTED };

/* Iterate from other inputs, and states that follow from them, or need not yet: they stay, head for the end, or are as
   wanted. */
static int begin_at(Work *s, int states)
{
    keep_inputs(s);
    if (states == ROLL_OUT)
        roll_out(s);
    else
        stay(s);
    if (states == HEAD_FOR_END)
        head_for_end(s);
    if (states == AS_WANTED)
        take_wanted(s);
    forget_rows(s);
    price_limits(s, 0);
    s->fresh = FROM_NOTHING, s->anew = 1, s->open_end = s->ahead = 0;
    s->cost = NAN, s->violation = s->residual = INFINITY;
    return converge(s, s->max_iterations - s->iterations, 0);
}

static int nowhere(const Work *s, int status)
{
    return status == NOT_FINITE || status == FAILED || (status == STALLED && !(s->violation <= FEASIBLE));
}

/* Whether a solve ended at a plan that keeps hard limits, finished or not. */
static int leads_on(const Work *s, int status)
{
    int cut = status == ITERATION_LIMIT || status == TIME_OUT || status == STALLED;
    return status == SOLVED || status == ITERATED || (cut && s->violation <= FEASIBLE);
}

/* A solve that led nowhere, such as from states that a plan before or inputs held lead to beyond all numbers, begins anew:
   the inputs held, and states that need not follow from them yet: they stay, or, where that leads nowhere either, are as
   wanted. */
static int begin_anew(Work *s, int status)
{
    static const int ways[] = {STAY, AS_WANTED};
    for (int way = 0; way < 2 && nowhere(s, status) && s->iterations < s->max_iterations; way++) {
        for (int i = 0; i < N; i++)
            memcpy(s->u + i * NU, s->applied, sizeof s->applied);
        status = begin_at(s, ways[way]);
    }
    return status;
}

/* Whether a start that limits are looked for from, the first being that of input 0, is tried: all of them are, but where
   limits were out of reach just before too they take turns. */
static int has_turn(const Work *s, int start)
{
    return s->misses <= 0 || s->misses % RETRIES == 0 || (s->misses - 1) % (NU + 3) == start;
}

/* Where that led nowhere either, or limits are missed, two last starts: inputs in the middle of their ranges, and states
   that head for the end or stay. */
static int begin_halfway(Work *s, int status)
{
    int64_t anew = s->anew;
    int ended = status;
    for (int states = HEAD_FOR_END; states >= STAY; states--) {
        if ((ended != INFEASIBLE && !nowhere(s, ended)) || s->iterations >= s->max_iterations)
            break;
        if (ended == INFEASIBLE && !has_turn(s, NU + 1 + HEAD_FOR_END - states))
            continue;
        for (int a = 0; a < N * NU; a++) {
            double middle = 0.5 * (INPUT_LOW[a % NU] + INPUT_HIGH[a % NU]);
            s->u[a] = fabs(middle) < INFINITY ? middle : s->applied[a % NU];
        }
        ended = begin_at(s, states);
    }
    if (status != INFEASIBLE || leads_on(s, ended))
        return ended;
    s->anew = anew;
    return status;
}

/* Whole steps of a car that slides from a start where it rolls lead to where no step keeps it on the road. So limits that
   are missed everywhere else are looked for from where the solve began, by steps that change inputs little at first. */
static int begin_gently(Work *s, int status)
{
    int64_t anew = s->anew;
    if (status != INFEASIBLE || !has_hard(s) || !has_turn(s, NU) || s->iterations >= s->max_iterations)
        return status;
    memcpy(s->u, s->begun_u, sizeof s->u);
    s->reach = GENTLE;
    int ended = begin_at(s, ROLL_OUT);
    s->reach = INFINITY;
    if (leads_on(s, ended))
        return ended;
    s->anew = anew;
    return status;
}

/* Hard limits that are missed by least where a solve ended may be kept elsewhere: it begins anew from the inputs there,
   those of one control after the other mirrored about the middle of their range, or a quarter of that off it where they
   are all there, as of a car that heads straight for an obstacle. Where that leads to a plan that keeps them, finished or
   not, they are not out of reach. */
static int look_elsewhere(Work *s, int status)
{
    double *missed = s->way_u;
    int64_t anew = s->anew;
    memcpy(missed, s->u, sizeof s->u);
    for (int j = 0; j < NU && N_LIMITS > 0 && status == INFEASIBLE && s->iterations < s->max_iterations; j++) {
        double both = INPUT_LOW[j] + INPUT_HIGH[j], most = 0;
        if (!has_turn(s, j))
            continue;
        memcpy(s->u, missed, sizeof s->u);
        for (int i = 0; i < N; i++) {
            s->u[i * NU + j] = (fabs(both) < INFINITY ? both : 0) - missed[i * NU + j];
            most = larger(fabs(s->u[i * NU + j] - missed[i * NU + j]), most);
        }
        int same = most <= SETTLED * SCALE[j];
        for (int i = 0; i < N && same; i++)
            s->u[i * NU + j] += 0.5 * SCALE[j];
        int ended = begin_at(s, same ? ROLL_OUT : STAY);
        if (leads_on(s, ended))
            return ended;
    }
    s->anew = anew;
    return status;
}

static void keep_iterate(Work *s)
{
    memcpy(s->left_u, s->u, sizeof s->u);
    memcpy(s->left_x, s->x, sizeof s->x);
    memcpy(s->left_k, s->k, sizeof s->k);
    memcpy(s->left_working, s->working, sizeof s->working);
    s->left_numbers[0] = s->cost, s->left_numbers[1] = s->violation, s->left_numbers[2] = s->residual;
}

static void recall_iterate(Work *s)
{
    memcpy(s->u, s->left_u, sizeof s->u);
    memcpy(s->x, s->left_x, sizeof s->x);
    memcpy(s->k, s->left_k, sizeof s->k);
    memcpy(s->working, s->left_working, sizeof s->working);
    s->cost = s->left_numbers[0], s->violation = s->left_numbers[1], s->residual = s->left_numbers[2];
}

/* Iterate from the inputs and states at hand. */
static int go_on(Work *s)
{
    keep_inputs(s);
    forget_rows(s);
    price_limits(s, 0);
    s->fresh = GIVEN;
    return converge(s, s->max_iterations - s->iterations, 0);
}

static int no_saddle(Work *s, int status)
{
#if defined RICCATI && defined CURVED
    return leave_saddle(s, status);
#else
    (void)s;
    return status;
#endif
}

/* What many steps, or one that was cut short, lead to may be a local optimum, dearer than the inputs that the solve began
   with and the states that these lead to. Then it begins anew from those, and stays there if that is the better one. */
static int begin_cheaper(Work *s, int status)
{
    double cost, violation;
    if (status != SOLVED || s->iterations >= s->max_iterations || !(s->shortened || s->iterations > FEW_STEPS))
        return status;
    keep_iterate(s);
    memcpy(s->u, s->begun_u, sizeof s->u);
    roll_out(s);
    if (begins(s, LINEARISE) && linearise(s)) {
        ends(s, LINEARISE);
        merit(s, &cost, &violation);
        if (violation <= FEASIBLE && 2 * cost < s->cost - DEARER * fabs(s->cost)) {
            if (go_on(s) == SOLVED && s->cost < s->left_numbers[0])
                return no_saddle(s, SOLVED);
            price_limits(s, 0);
        }
    }
    recall_iterate(s);
    return status;
}

/* Half the cost of constant inputs, from their roll-out. */
static double try_inputs(Work *s, const double *u)
{
    double cost, violation;
    for (int i = 0; i < N; i++)
        memcpy(s->u + i * NU, u, sizeof s->applied);
    keep_inputs(s);
    roll_out(s);
    if (!begins(s, LINEARISE) || !linearise(s))
        return INFINITY;
    ends(s, LINEARISE);
    merit(s, &cost, &violation);
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
    if (now(&s->qp) > s->qp.until)
        return;
    if (try_inputs(s, s->applied) > relaxed) {
        memcpy(s->u, s->u_from, sizeof s->u);
        memcpy(s->x, s->x_from, sizeof s->x);
        memcpy(s->k, s->k_from, sizeof s->k);
    }
}

/* Whether the state now is nearer to that a step ahead than to the first, as when the vehicle moves on. */
static int moves_on(const Work *s)
{
    double of_x[NX], here = 0, ahead = 0;
    units(s->x, NS + 1, NX, of_x);
    for (int a = 0; a < NX; a++) {
        double d = (s->x0[a] - s->x[a]) * of_x[a], e = (s->x0[a] - s->x[NX + a]) * of_x[a];
        here += d * d, ahead += e * e;
    }
    return ahead <= here;
}

/* Whether the state now is so near to the first of the plan that derivatives there serve: the step closes the gap. */
static int nearby(const Work *s)
{
    double of_x[NX], square = 0;
    int near = 1;
    for (int a = 0; a < NX; a++)
        square += (s->x0[a] - s->x[a]) * (s->x0[a] - s->x[a]);
    if (square <= NEARBY * NEARBY)
        return 1;
    units(s->x, NS, NX, of_x);
    for (int a = 0; a < NX; a++)
        near &= fabs(s->x0[a] - s->x[a]) * of_x[a] <= NEARBY;
    return near;
}

/* Start from the plan of the step before (CONTINUE: u, x, k as it left them; RESUME: as an unfinished solve left them,
   which may have been about a vehicle that has not moved since), from nothing (FROM_NOTHING: constant inputs, states
   rolled out), from inputs and states (GIVEN; HANDED_OVER: and multipliers), or from inputs (GIVEN_INPUTS: states rolled
   out). Only the first takes a
   fixed number of iterations. RETRY is FROM_NOTHING with what an unfinished solve left put aside. */
static void start(Work *s)
{
    int shifts = s->fresh == CONTINUE || (s->fresh == RESUME && moves_on(s));
#ifdef EDGES
    keep_between_edges(s);
#endif
    for (int row = 0; row < N_LIMITS; row++) {
        s->qp.plain[QN + QR + row] = s->plain[row];
        s->qp.square[QN + QR + row] = s->square[row];
    }
    s->reach = INFINITY;
    s->iterations = s->qp_iterations = s->pairs = s->anew = s->unstable = s->astray = 0, s->damp = 0;
    s->cost = NAN, s->violation = s->residual = INFINITY;
    if (s->fresh == CONTINUE)
        recall_rows(s);
    else
        forget_rows(s);
#if JUMPS > 0
    if (shifts) {
        for (int i = 0; i < N; i++)
            memcpy(s->u_later + i * NU, s->u + U_LATER[i] * NU, sizeof(double) * NU);
        memcpy(s->u, s->u_later, sizeof s->u);
        for (int i = 0; i <= NS; i++) {
            memmove(s->x + i * NX, s->x + X_LATER[i] * NX, sizeof(double) * NX);
            if (NK > 0)
                memmove(s->k + i * NK, s->k + X_LATER[i] * NK, sizeof(double) * NK);
        }
    } else
#endif
    if (shifts) {
        inputs_after(s->u, 1, s->u_later);
        memcpy(s->u, s->u_later, sizeof s->u);
        memmove(s->x, s->x + NX, sizeof(double) * NS * NX);
        if (NK > 0)
            memmove(s->k, s->k + NK, sizeof(double) * (size_t)(NS * NK));
    } else if (s->fresh != RESUME)
        memset(s->k, 0, sizeof s->k);
    if (s->fresh == FROM_NOTHING)
        start_from_nothing(s);
    else
        keep_inputs(s);
    if (s->fresh == GIVEN_INPUTS || N == 1)
        roll_out(s);
    else if ((shifts || s->fresh == RESUME) && !(AHEAD && s->fresh == CONTINUE && s->fixed > 0 && nearby(s)))
        memcpy(s->x, s->x0, sizeof s->x0);
    s->open_end = shifts;
}

/* Everything that can be done before the state is known: shift the plan, expect its next state, linearise, condense. */
int rt_prepare(Work *s)
{
    double begin = now(&s->qp);
    memcpy(s->x0, s->x + NX, sizeof s->x0);
    s->fresh = CONTINUE;
    s->qp.until = INFINITY;
    start(s);
    int status = prepare(s);
    s->seconds_prepare = now(&s->qp) - begin;
    return status;
}

/* Full steps that did not end at an acceptable plan are followed by some with a line search. So is one that the limits do
   not allow, as after a jump of an obstacle: those that follow may miss limits at a price on their way. */
static int finish(Work *s, int status)
{
    int hazy = status == ITERATED && blurred(s, 0.5 * (s->cost + s->bend));
#ifdef RICCATI
    s->unstable |= hazy;
    hazy |= (int)s->astray;
#endif
    if (status == ITERATED && accepted(s) && !hazy)
        return hidden(s) ? STALLED : status;
    if (status == ITERATED || status == INFEASIBLE) {
        int ended = converge(s, s->max_iterations < MORE ? s->max_iterations : MORE, 1);
        status = status == ITERATED || leads_on(s, ended) ? ended : INFEASIBLE;
    }
    status = begin_anew(s, status);
    keep_inputs(s);
    return status;
}

int rt_feedback(Work *s)
{
    double begin = now(&s->qp);
    s->qp.until = begin + s->time_limit;
    int status = finish(s, feedback(s, 0));
    s->seconds = s->seconds_feedback = now(&s->qp) - begin;
    return status;
}

int rt_solve(Work *s)
{
    double begin = now(&s->qp), prepared = 0;
    s->qp.until = begin + s->time_limit;
    int again = s->fresh == RETRY;
    if (again) {
        keep_iterate(s);
        s->fresh = FROM_NOTHING;
    }
    start(s);
    int status = NOT_FINITE;
    if (s->fresh || s->fixed == 0) {
        int given = s->fresh != FROM_NOTHING;
        memcpy(s->begun_u, s->u, sizeof s->u);
        s->shortened = s->fresh == GIVEN; /* by somebody, with any states */
        status = begin_halfway(s, begin_gently(s, look_elsewhere(s, begin_anew(s, converge(s, s->max_iterations, 0)))));
        status = no_saddle(s, status);
        status = given ? begin_cheaper(s, status) : status;
        keep_inputs(s);
        if (again && !leads_on(s, status)) {
            recall_iterate(s);
            s->violation = s->residual = INFINITY; /* now */
        }
    } else {
        for (int64_t i = 0; i < s->fixed; i++) {
            double from = i ? now(&s->qp) : begin;
            status = prepare(s);
            prepared += now(&s->qp) - from;
            if (status == SOLVED)
                status = feedback(s, i + 1 == s->fixed);
            if (status != ITERATED)
                break;
        }
        if (status == TIME_OUT && accepted(s)) /* by an earlier of these iterations */
            status = ITERATED;
        status = finish(s, status);
    }
    s->seconds = now(&s->qp) - begin;
    s->seconds_prepare = prepared, s->seconds_feedback = s->seconds - prepared;
    return status;
}

/* ---- life ----------------------------------------------------------------------------------------------------- */

/* What stays as it is in all solves. */
void rt_begin(Work *s)
{
    Qp *q = &s->qp;
    for (int i = 0; i < QT; i++)
        q->plain[i] = INFINITY;
    for (int k = 0, a = 0; a < N * NU; a++)
        if (STEP_LOW[a] > -INFINITY || STEP_HIGH[a] < INFINITY) {
            q->after[k] = a;
            q->before[k++] = a - NU;
        }
}
