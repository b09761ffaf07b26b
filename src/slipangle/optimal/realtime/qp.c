/* Long: one algorithm; its events share the factors that they update. */
/* Strictly convex quadratic program with limits of rows, hard or at a price, by a dual active-set method:

       minimise  1/2 u'Hu + g'u + sum_i phi_i(excess of row i over its limits)
       phi_i(e) = infinite for hard rows, plain_i e + square_i e^2 / 2 for soft ones.

   Rows are the inputs themselves, differences of two inputs, and dense rows. Starting from the unconstrained
   optimum, the most violated row enters while stationarity is kept (Goldfarb, Idnani, Math. Program. 27, 1983). A soft
   row is one more kind of event: its multiplier may rise to `plain` with the limit kept (KEPT); beyond, the limit is
   exceeded by (multiplier - plain) / square (PAID), or by whatever is needed when square is zero (SPENT). */

#define QT (QN + QR + QD)                             /* rows */
#define QL ((QN + LANES - 1) / LANES * LANES)         /* inputs, padded */
#define QLT ((QT + LANES - 1) / LANES * LANES)

#define MANY 60 /* stages, over which states of a plant that is not stable lose their digits where they are eliminated */
#ifdef RICCATI
#define OTHERS (N >= MANY) /* whether an interior point follows where this leads nowhere */
#else
#define OTHERS 0
#endif
enum { FREE, KEPT, PAID, SPENT };
enum { QP_SOLVED, QP_INFEASIBLE, QP_LIMIT, QP_LATE, QP_NUMBER };

typedef struct {
    V H[QN * QL / LANES];  /* upper triangle by row; below it anything */
    V U[QN * QL / LANES];  /* factor, H = U'U, without its diagonal, and by column: nothing else is in their rows */
    V L[QN * QL / LANES];
    V Y[QT * QL / LANES];  /* rows times the inverse of U, where `have` says so */
    V C[(QD + 1) * QL / LANES];
    double g[QL], u[QL], start[QL], xi[QL], cancel[QL], inverse[QN];
    double lo[QT], hi[QT], square[QT], plain[QT]; /* plain: infinite for hard rows */
    double kept_lo[QT], kept_hi[QT];              /* limits before a perturbation */
    double lambda[QT];                            /* positive at an upper limit */
    double lam[QT], sign[QT], limit[QT], step[QT], rhs[QT];
    double G[QT * QLT], F[QT * QLT];
    double kkt, until, dependent; /* a row that depends on the others up to this share counts as dependent */
    int after[QR + 1], before[QR + 1]; /* differences u[after] - u[before]; before < 0: u[after] alone */
    int n, rates, dense, k, iterations, limit_iterations;
    int row[QT], mode[QT];
    char have[QT];
#ifdef CALLERS_CLOCK
    double (*clock)(void *);
    void *clock_of;
#endif
} Qp;

#ifdef QP_ANY_SIZE
#define Q_N (q->n)
#define Q_R (q->rates)
#define Q_D (q->dense)
#else
#define Q_N QN
#define Q_R QR
#define Q_D QD
#endif

/* The time that counts [s]: the caller's clock, if it has one, or the system's. */
static double now(const Qp *q)
{
#ifdef CALLERS_CLOCK
    return q->clock ? q->clock(q->clock_of) : 0;
#else
    (void)q;
    return monotonic();
#endif
}

INLINE double larger(double a, double b) /* b where a is no number */
{
    return a > b ? a : b;
}
INLINE double smaller(double a, double b) { return a < b ? a : b; }
INLINE double dot(const double *a, const double *b, int n)
{
    V sum = {0}, x, y;
    int i = 0;
    for (; i + LANES <= n; i += LANES) {
        memcpy(&x, a + i, sizeof x);
        memcpy(&y, b + i, sizeof y);
        sum += x * y;
    }
    double total = 0;
    for (int j = 0; j < LANES; j++)
        total += v_lane(sum, j);
    for (; i < n; i++)
        total += a[i] * b[i];
    return total;
}
INLINE void add(double *restrict y, double a, const double *restrict x, int n)
{
    for (int i = 0; i < n; i++)
        y[i] += a * x[i];
}

/* The same for entries `from` to `to` of aligned rows, rounded outwards to whole vectors. */
INLINE void add_rows(double *restrict y, double a, const double *restrict x, int from, int to)
{
    for (int i = from / LANES; i * LANES < to; i++)
        ((V *)y)[i] += a * ((const V *)x)[i];
}

/* The product of x and the symmetric matrix whose upper triangle H holds, times `sign`, added to z. */
static void add_product(double *z, double sign, const double *H, const double *x, int n)
{
    for (int a = 0; a < n; a++) {
        z[a] += sign * dot(H + a * QL + a, x + a, n - a);
        add(z + a + 1, sign * x[a], H + a * QL + a + 1, n - a - 1);
    }
}

/* U'y = c in place, c zero before `first`; U x = y in place. What is found stands beside until the end, as a vector that
   was stored in parts must be waited for before it can be read as one. */
static void forward(const Qp *q, double *c, int first)
{
    const double *U = (const double *)q->U;
    double found[QL];
    for (int j = first; j < Q_N; j++) {
        found[j] = c[j] * q->inverse[j];
        add_rows(c, -found[j], U + j * QL, j + 1, Q_N);
    }
    for (int j = first; j < Q_N; j++)
        c[j] = found[j];
}
static void backward(const Qp *q, double *y)
{
    const double *L = (const double *)q->L;
    double found[QL];
    for (int j = Q_N - 1; j >= 0; j--) {
        found[j] = y[j] * q->inverse[j];
        add_rows(y, -found[j], L + j * QL, 0, j);
    }
    for (int j = 0; j < Q_N; j++)
        y[j] = found[j];
}

/* Factor of H, whose pivots wait for no square root, two at a time, so that rows below are passed half as often; 0 where
   one is too small for its column. */
static int qp_factor(Qp *q)
{
    const double *H = (const double *)q->H;
    double *U = (double *)q->U, *L = (double *)q->L, *part = q->cancel, *part_next = q->xi, top = 0;
    for (int j = 0; j < Q_N; j++)
        top = larger(H[j * QL + j], top);
    for (int j = 0; j < Q_N; j += 2) {
        int two = j + 1 < Q_N;
        const double *from = j ? U : H, *old = from + j * QL, *old_next = two ? old + QL : old;
        double *row = U + j * QL, *next = two ? row + QL : row;
        double d = old[j], off = two ? old[j + 1] : 0, both = two ? d * old_next[j + 1] - off * off : d;
        double inverse = 1 / d, inverse_next = d / both, share = off * inverse, d_next = both * inverse;
        if (!(d > 1e-13 * H[j * QL + j] && d > 1e-30 * top))
            return 0;
        if (two && !(d_next > 1e-13 * H[(j + 1) * QL + j + 1] && d_next > 1e-30 * top))
            return 0;
        for (int b = j / LANES; b * LANES < Q_N; b++) {
            V here = ((const V *)old)[b], there = ((const V *)old_next)[b] - share * here;
            ((V *)part)[b] = here * inverse, ((V *)part_next)[b] = there * inverse_next;
            ((V *)row)[b] = here;
            if (two)
                ((V *)next)[b] = there;
        }
        for (int b = (j + 2) / LANES; b * LANES < Q_N; b++) {
            V here = ((V *)row)[b], there = ((V *)next)[b];
            for (int a = j + 2; a < Q_N && a < (b + 1) * LANES; a++)
                ((V *)(U + a * QL))[b] = ((const V *)(from + a * QL))[b] - (part[a] * here + part_next[a] * there);
        }
        q->inverse[j] = sqrt(inverse);
        if (two)
            q->inverse[j + 1] = sqrt(inverse_next);
        for (int b = j / LANES; b * LANES < Q_N; b++) {
            ((V *)row)[b] *= q->inverse[j];
            if (two)
                ((V *)next)[b] *= q->inverse[j + 1];
        }
        for (int b = j / LANES * LANES; b <= j; b++)
            row[b] = next[b] = 0;
        if (!two)
            break;
        L[(j + 1) * QL + j] = row[j + 1], next[j + 1] = 0;
        for (int b = j + 2; b < Q_N; b++) {
            double pair[2] = {row[b], next[b]};
            memcpy(L + b * QL + j, pair, sizeof pair);
        }
    }
    memset(q->have, 0, sizeof q->have);
    return 1;
}

INLINE double row_value(const Qp *q, int i, const double *u)
{
    if (i < Q_N)
        return u[i];
    i -= Q_N;
    if (i < Q_R)
        return u[q->after[i]] - (q->before[i] < 0 ? 0 : u[q->before[i]]);
    return dot((const double *)q->C + (i - Q_R) * QL, u, Q_N);
}
static void row_add(const Qp *q, int i, double a, double *into)
{
    if (i < Q_N) {
        into[i] += a;
        return;
    }
    i -= Q_N;
    if (i < Q_R) {
        into[q->after[i]] += a;
        if (q->before[i] >= 0)
            into[q->before[i]] -= a;
        return;
    }
    add(into, a, (const double *)q->C + (i - Q_R) * QL, Q_N);
}
static const double *row_y(Qp *q, int i)
{
    double *y = (double *)q->Y + i * QL;
    if (!q->have[i]) {
        memset(y, 0, sizeof(double) * QL);
        row_add(q, i, 1.0, y);
        int first = i < Q_N ? i : 0;
        forward(q, y, first);
        q->have[i] = 1;
    }
    return y;
}

INLINE double softness(const Qp *q, int a) { return q->mode[q->row[a]] == PAID ? 1 / q->square[q->row[a]] : 0.0; }
static void refactor(Qp *q, int from)
{
    for (int a = from; a < q->k; a++)
        for (int b = 0; b <= a; b++) {
            double v = q->G[a * QLT + b] - dot(q->F + a * QLT, q->F + b * QLT, b);
            if (b < a)
                q->F[a * QLT + b] = v / q->F[b * QLT + b];
            else {
                v += softness(q, a);
                double least = 1e-14 * (q->G[a * QLT + a] + softness(q, a));
                q->F[a * QLT + a] = sqrt(v > least ? v : least);
            }
        }
}
static void solve_working(const Qp *q, double *r)
{
    for (int a = 0; a < q->k; a++)
        r[a] = (r[a] - dot(q->F + a * QLT, r, a)) / q->F[a * QLT + a];
    for (int a = q->k - 1; a >= 0; a--) {
        r[a] /= q->F[a * QLT + a];
        for (int b = 0; b < a; b++)
            r[b] -= q->F[a * QLT + b] * r[a];
    }
}
static void enter(Qp *q, int p, double sign, double limit, double lam, int mode)
{
    int k = q->k;
    const double *y = row_y(q, p);
    q->row[k] = p, q->sign[k] = sign, q->limit[k] = limit, q->lam[k] = lam, q->mode[p] = mode;
    for (int a = 0; a <= k; a++)
        q->G[k * QLT + a] = dot(row_y(q, q->row[a]), y, Q_N) * sign * q->sign[a];
    q->k = k + 1;
    refactor(q, k);
}
static void leave(Qp *q, int a, int mode)
{
    q->mode[q->row[a]] = mode;
    for (int b = a; b + 1 < q->k; b++) {
        q->row[b] = q->row[b + 1], q->sign[b] = q->sign[b + 1];
        q->limit[b] = q->limit[b + 1], q->lam[b] = q->lam[b + 1];
        for (int c = 0; c <= b; c++)
            q->G[b * QLT + c] = q->G[(b + 1) * QLT + c + (c >= a)];
    }
    q->k--;
    refactor(q, a);
}

/* One step of iterative refinement of u and the multipliers of the working rows. */
static void refine(Qp *q)
{
    double *z = q->xi;
    for (int a = 0; a < QL; a++)
        z[a] = a < Q_N ? -q->g[a] : 0;
    add_product(z, -1, (const double *)q->H, q->u, Q_N);
    for (int i = 0; i < QT; i++)
        if (q->mode[i] == SPENT)
            row_add(q, i, -q->lambda[i], z);
    for (int a = 0; a < q->k; a++)
        row_add(q, q->row[a], -q->lam[a] * q->sign[a], z);
    forward(q, z, 0);
    for (int a = 0; a < q->k; a++) {
        int i = q->row[a];
        double miss = q->sign[a] * row_value(q, i, q->u) - q->limit[a];
        if (q->mode[i] == PAID)
            miss -= (q->lam[a] - q->plain[i]) / q->square[i];
        q->rhs[a] = q->sign[a] * dot(row_y(q, i), z, Q_N) + miss;
    }
    solve_working(q, q->rhs);
    for (int a = 0; a < q->k; a++) {
        q->lam[a] += q->rhs[a];
        add(z, -q->rhs[a] * q->sign[a], row_y(q, q->row[a]), Q_N);
    }
    backward(q, z);
    add(q->u, 1.0, z, Q_N);
}

/* The largest force that a price has on one input. Such forces may balance each other to the last digit, where inputs
   themselves cost next to nothing; multipliers of hard rows, which may be anything, are no measure. */
static double dearest_row(const Qp *q)
{
    double most = 0;
    for (int i = 0; i < Q_N + Q_R + Q_D; i++) {
        double part = i < Q_N + Q_R ? 1 : 0;
        if (!(q->plain[i] < INFINITY) || q->lambda[i] == 0)
            continue;
        for (int a = 0; i >= Q_N + Q_R && a < Q_N; a++)
            part = larger(fabs(((const double *)q->C)[(i - Q_N - Q_R) * QL + a]), part);
        most = larger(part * fabs(q->lambda[i]), most);
    }
    return most;
}

/* Largest violation of the optimality conditions, relative to the size of their terms: gradient, Hessian times step,
   and multipliers. Where tracking is exact the first is zero. */
static double qp_residual(Qp *q)
{
    double *z = q->xi, *forces = q->cancel, size = 1e-300, worst = 0;
    for (int a = 0; a < QL; a++)
        z[a] = forces[a] = 0;
    for (int a = 0; a < Q_N; a++)
        if (!(fabs(q->u[a]) < INFINITY && fabs(q->g[a]) < INFINITY))
            return INFINITY;
    add_product(z, 1, (const double *)q->H, q->u, Q_N);
    for (int i = 0; i < Q_N + Q_R + Q_D; i++)
        if (q->lambda[i] != 0)
            row_add(q, i, q->lambda[i], forces);
    for (int a = 0; a < Q_N; a++)
        size = larger(fabs(q->g[a]) + fabs(z[a]) + fabs(forces[a]), size);
    for (int a = 0; a < Q_N; a++)
        worst = larger(fabs(z[a] + q->g[a] + forces[a]), worst);
    if (worst > 1e-8 * size)
        size = larger(dearest_row(q), size);
    worst /= size;
    for (int i = 0; i < Q_N + Q_R + Q_D; i++) {
        double v = row_value(q, i, q->u), l = q->lambda[i];
        double over = larger(v - q->hi[i], q->lo[i] - v), paid = 0;
        if (l != 0) {
            double e = l > 0 ? v - q->hi[i] : q->lo[i] - v, m = fabs(l);
            if (m > q->plain[i] && q->square[i] > 0)
                paid = (m - q->plain[i]) / q->square[i];
            if (m < q->plain[i] || q->square[i] > 0 || e < 0) /* else it may be exceeded by any amount */
                worst = larger(fabs(e - paid) / (1 + fabs(l > 0 ? q->hi[i] : q->lo[i]) + fabs(v)), worst);
        } else if (over > 0 && !(q->plain[i] <= 0 && q->square[i] <= 0))
            worst = larger(over / (1 + fabs(v)), worst);
        if (!(worst < INFINITY))
            return INFINITY;
    }
    return worst;
}

/* The same with the multipliers of the working rows; of all others only those of SPENT ones are not zero. */
static double working_residual(Qp *q)
{
    for (int i = 0; i < Q_N + Q_R + Q_D; i++)
        if (q->mode[i] != SPENT)
            q->lambda[i] = 0;
    for (int a = 0; a < q->k; a++)
        q->lambda[q->row[a]] = q->sign[a] * larger(q->lam[a], 0);
    return qp_residual(q);
}

#define CLOSE 1e-10    /* a row counts as violated beyond this, relative to its limit */
#define ROUNDING 1e-14 /* residual that refinement hardly lowers */

/* The row that is violated most; `back` says that a SPENT row does not exceed its limit any more. */
static int most_violated(const Qp *q, double *sign, int *back)
{
    double worst = 0;
    int p = -1;
    for (int i = 0; i < Q_N + Q_R + Q_D; i++) {
        if (q->mode[i] == KEPT || q->mode[i] == PAID)
            continue;
        double v = row_value(q, i, q->u), e, s;
        if (q->mode[i] == SPENT) {
            s = q->lambda[i] > 0 ? 1 : -1;
            double b = s > 0 ? q->hi[i] : -q->lo[i];
            e = (b - s * v) / (1 + fabs(b));
        } else {
            double over = v - q->hi[i], under = q->lo[i] - v;
            if (over <= 0 && under <= 0)
                continue;
            s = over > under ? 1 : -1;
            e = s > 0 ? over / (1 + fabs(q->hi[i])) : under / (1 + fabs(q->lo[i]));
            if (q->plain[i] <= 0 && q->square[i] <= 0)
                continue;
        }
        if (e > worst) {
            worst = e, p = i, *sign = s;
            *back = q->mode[i] == SPENT;
        }
    }
    return worst > CLOSE ? p : -1;
}

/* Multipliers of the working rows from scratch; rows whose multiplier has left its range change their mode. */
static int settle(Qp *q)
{
    for (int round = 0; round <= 2 * QT; round++) {
        memcpy(q->u, q->start, sizeof q->u);
        for (int a = 0; a < q->k; a++)
            q->lam[a] = 0;
        refine(q);
        int a = -1, to = FREE;
        double worst = 0;
        for (int b = 0; b < q->k; b++) {
            int i = q->row[b];
            double low = q->mode[i] == PAID ? q->plain[i] : 0, high = q->mode[i] == KEPT ? q->plain[i] : INFINITY;
            double e = larger(low - q->lam[b], q->lam[b] - high);
            if (e > worst)
                worst = e, a = b, to = q->lam[b] > high ? PAID : q->mode[i] == PAID && q->plain[i] > 0 ? KEPT : FREE;
        }
        if (a < 0)
            return 1;
        if (to == FREE)
            leave(q, a, FREE);
        else if (to == PAID && q->square[q->row[a]] <= 0)
            return 0;
        else {
            q->mode[q->row[a]] = to;
            refactor(q, a);
        }
    }
    return 0;
}

/* Whether hard rows, weighted so that they cancel, have limits that do not: no u of moderate size keeps them all.
   Row p has weight 1 and working rows -rhs; without a row p, the weights are the multipliers, grown beyond bounds. */
static int contradicts(Qp *q, int p, double sign, double limit)
{
    double *z = q->cancel, bound = 0, left = 0, size = 0, top = 1;
    memset(z, 0, sizeof q->cancel);
    if (p >= 0) {
        row_add(q, p, sign, z);
        bound = limit, size = fabs(limit);
    } else
        for (int a = 0; a < q->k; a++)
            if (!(q->plain[q->row[a]] < INFINITY))
                top = larger(q->lam[a], top);
    for (int a = 0; a < q->k; a++) {
        int i = q->row[a];
        double y = p >= 0 ? -q->rhs[a] : q->lam[a] / top;
        if (q->plain[i] < INFINITY || !(y > 0))
            continue;
        row_add(q, i, y * q->sign[a], z);
        bound += y * q->limit[a], size += fabs(y * q->limit[a]);
    }
    for (int a = 0; a < Q_N; a++)
        left += fabs(z[a]);
    return bound < -1e-10 * size && left * 1e4 < -bound;
}

/* Bring row p to its limit (or, if it is SPENT and back inside, lower its multiplier until it is on the limit). */
static int bring(Qp *q, int p, double sign, int back)
{
    double limit = sign > 0 ? q->hi[p] : -q->lo[p], plain = q->plain[p], square = q->square[p];
    double lam = back ? plain : 0, way = back ? -1 : 1;
    int mode = plain <= 0 ? PAID : KEPT;
    double *r = q->rhs, *z = q->xi;
    for (;;) {
        if (++q->iterations > q->limit_iterations)
            return QP_LIMIT;
        if ((q->iterations & 15) == 0 && now(q) > q->until)
            return QP_LATE;
        const double *y = row_y(q, p);
        for (int a = 0; a < Q_N; a++)
            z[a] = sign * y[a];
        for (int a = 0; a < q->k; a++)
            r[a] = q->sign[a] * sign * dot(row_y(q, q->row[a]), y, Q_N);
        solve_working(q, r);
        double own = dot(y, y, Q_N), rate = 0;
        for (int a = 0; a < q->k; a++) {
            add(z, -r[a] * q->sign[a], row_y(q, q->row[a]), Q_N);
            rate += softness(q, a) * r[a] * r[a];
        }
        rate += dot(z, z, Q_N);
        double miss = way * (sign * row_value(q, p, q->u) - limit);
        if (mode == PAID) {
            miss -= (lam - plain) / square;
            rate += 1 / square;
        }
        double full = rate > q->dependent * own ? larger(miss, 0) / rate : INFINITY, t = full;
        int blocks = -1, itself = 0;
        for (int a = 0; a < q->k; a++) {
            int i = q->row[a];
            double d = -way * r[a], to = INFINITY;
            if (full == INFINITY && r[a] * r[a] * q->G[a * QLT + a] < 1e-18 * own)
                continue; /* rounding: this row has no part in the dependence */
            if (d < 0)
                to = (q->lam[a] - (q->mode[i] == PAID ? q->plain[i] : 0)) / -d;
            else if (d > 0 && q->mode[i] == KEPT)
                to = (q->plain[i] - q->lam[a]) / d;
            if (to < t)
                t = larger(to, 0), blocks = a;
        }
        double own_end = way < 0 ? lam : mode == KEPT ? plain - lam : INFINITY;
        if (own_end < t)
            t = own_end, blocks = -1, itself = 1;
        if (!(t < INFINITY))
            return contradicts(q, p, sign, limit) ? QP_INFEASIBLE : QP_NUMBER;
        lam += way * t;
        for (int a = 0; a < q->k; a++)
            q->lam[a] -= way * t * r[a];
        backward(q, z);
        add(q->u, -way * t, z, Q_N);
        if (itself) {
            if (way < 0) {
                q->mode[p] = FREE, q->lambda[p] = 0;
                return QP_SOLVED;
            }
            if (square <= 0) {
                q->mode[p] = SPENT, q->lambda[p] = sign * plain;
                return QP_SOLVED;
            }
            mode = PAID;
        } else if (blocks < 0) {
            q->lambda[p] = 0;
            enter(q, p, sign, limit, lam, mode);
            return QP_SOLVED;
        } else {
            int i = q->row[blocks], up = -way * r[blocks] > 0;
            if (q->mode[i] == PAID && q->plain[i] > 0) {
                q->mode[i] = KEPT;
                refactor(q, blocks);
            } else if (!up)
                leave(q, blocks, FREE);
            else if (q->square[i] > 0) {
                q->mode[i] = PAID;
                refactor(q, blocks);
            } else {
                q->lambda[i] = q->sign[blocks] * q->plain[i];
                leave(q, blocks, SPENT);
            }
        }
    }
}

static int qp_attempt(Qp *q, int warm)
{
    int rows = Q_N + Q_R + Q_D, status = QP_SOLVED;
    q->iterations = 0;
    q->limit_iterations = (OTHERS ? 3 : 20) * rows + 50;
    for (int a = 0; a < QL; a++)
        q->start[a] = a < Q_N ? -q->g[a] : 0;
    forward(q, q->start, 0);
    backward(q, q->start);
    int old = warm ? q->k : 0;
    q->k = 0;
    for (int a = 0; a < old; a++) {
        int i = q->row[a], mode = q->mode[i];
        double sign = q->sign[a], limit = sign > 0 ? q->hi[i] : -q->lo[i];
        q->mode[i] = FREE;
        if (a < QN && fabs(limit) < INFINITY)
            enter(q, i, sign, limit, 0, mode);
    }
    if (old) {
        for (int i = 0; i < rows; i++) {
            int kept = 0;
            for (int a = 0; a < q->k; a++)
                kept |= q->row[a] == i;
            if (!kept)
                q->mode[i] = FREE;
        }
        if (!settle(q))
            old = 0;
    }
    if (!old) {
        q->k = 0;
        memset(q->mode, 0, sizeof q->mode);
        memcpy(q->u, q->start, sizeof q->u);
    }
    for (int round = 0; round < 4; round++) {
        double sign = 1;
        int p, back = 0;
        while (status == QP_SOLVED && (p = most_violated(q, &sign, &back)) >= 0)
            status = bring(q, p, sign, back);
        if (status == QP_SOLVED && (q->kkt = working_residual(q)) <= ROUNDING)
            return QP_SOLVED;
        refine(q);
        if (status != QP_SOLVED || most_violated(q, &sign, &back) < 0)
            break;
    }
    q->kkt = working_residual(q);
    if ((status == QP_INFEASIBLE || status == QP_NUMBER) && q->kkt <= 1e-8) /* limits that touch, up to rounding */
        return QP_SOLVED;
    if (!(q->kkt < INFINITY))
        return status == QP_SOLVED ? QP_NUMBER : status;
    return status == QP_SOLVED && q->kkt > 1e-8 ? QP_NUMBER : status;
}

/* Move every limit outwards by a tiny amount of its own, which resolves ties; back to where it was if there is none. */
static void perturb(Qp *q, double amount)
{
    uint32_t state = 1;
    for (int i = 0; i < Q_N + Q_R + Q_D; i++) {
        if (amount > 0) {
            q->kept_lo[i] = q->lo[i], q->kept_hi[i] = q->hi[i];
            state = state * 1664525u + 1013904223u;
            double e = amount * (1 + (double)(state >> 8) * 0x1p-24);
            q->lo[i] -= e * (1 + fabs(q->lo[i]));
            q->hi[i] += e * (1 + fabs(q->hi[i]));
        } else
            q->lo[i] = q->kept_lo[i], q->hi[i] = q->kept_hi[i];
    }
}

/* Solve from the working rows of the solve before (`warm`) or from none; if that fails, again with limits moved by next
   to nothing, whose answer is good enough by itself or gives the working rows to begin with. The answer is u and lambda;
   its residual, kkt, is measured on the problem itself, whatever happened on the way. */
static int qp_solve(Qp *q, int warm)
{
    q->dependent = 1e-12;
    int status = qp_attempt(q, warm);
    if (warm && status != QP_SOLVED && status != QP_LATE)
        status = qp_attempt(q, 0);
    q->dependent = 1e-9;
    for (double amount = 1e-9; amount < 1e-4 && status != QP_SOLVED && status != QP_LATE; amount *= 10) {
        perturb(q, amount);
        int other = qp_attempt(q, 0);
        perturb(q, 0);
        if (other == QP_SOLVED && (q->kkt = qp_residual(q)) > 1e-8)
            other = qp_attempt(q, 1);
        else if (other == QP_INFEASIBLE || (other != QP_LATE && contradicts(q, -1, 0, 0)))
            return QP_INFEASIBLE;
        if (other == QP_SOLVED || other == QP_LATE)
            status = other;
    }
    return status;
}
