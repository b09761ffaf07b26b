/* The quadratic program of a step without condensing it: the rows that are held are known but for a few, and are found by
   block pivoting on Riccati factors.

   The same problem as in qp.c. Held rows have a slope in the factor, so that they come close to their limits at once, and
   a multiplier, by which they come there exactly (method of multipliers). All rows that are held wrongly, or not held
   wrongly, change at once; where that makes no more of them right, one at a time.

   Rockafellar, Math. Oper. Res. 1, 1976; Judice, Pires, Comput. Oper. Res. 21, 1994. */

#define STIFF (1 / 1e-6)  /* of a held row, relative to the largest curvature by an input */
#define STIFFER 30.0      /* where a row does not come to its limit */
#define STIFFEST (1 / 1e-11)
#define FEW_FACTORS 5     /* after which so many wrong rows say that others are to be held than were expected */
#define MOST_WRONG 10
#define MOST_SWEEPS 60
#define EXACT 1e-12       /* residual, relative to the size of its terms, with which an answer is one at once */
#define ENOUGH 1e-9       /* the same where refinement gains nothing any more */
#define RESTS 1e-13       /* of an input, relative to half its range, by which an answer that is found still moves */
#define BALANCED 1e-11    /* the same where prices may balance each other, which are then the measure of a residual */
#define FEW_DIGITS 1e-6   /* residual with which that is one: its terms cancel, so that the digits that are left are few */
#define TOUCH 1e-12       /* of a multiplier at its bound, relative to that */

/* ---- rows ----------------------------------------------------------------------------------------------------- */

/* Multipliers and slopes of all rows in their modes; whether the slopes are not those of the factor. */
static int price_rows(Work *s)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    int changed = 0;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        double sign = r->sign[i], stiff = r->stiff[i], plain = q->plain[i], slope = 0, price = 0;
        double over = sign * r->price[i] + stiff * (sign > 0 ? r->value[i] - q->hi[i] : q->lo[i] - r->value[i]);
        if (r->mode[i] == KEPT)
            slope = stiff, price = over;
        else if (r->mode[i] == PAID) {
            slope = stiff * q->square[i] / (stiff + q->square[i]);
            price = plain + q->square[i] * (over - plain) / (stiff + q->square[i]);
        } else if (r->mode[i] == SPENT)
            price = plain;
        r->after[i] = r->mode[i] == FREE ? 0 : sign * price;
        changed |= slope != r->slope[i];
        r->wanted[i] = slope;
    }
    return changed;
}

/* The mode that a row should have by its value and its multiplier; how far off it is, as a distance. */
INLINE int better_mode(const Work *s, int i, double *off)
{
    const Stages *r = &s->stages;
    const Qp *q = &s->qp;
    double plain = q->plain[i], price = r->sign[i] * r->after[i], limit = r->sign[i] > 0 ? q->hi[i] : -q->lo[i];
    double over = r->value[i] - q->hi[i], under = q->lo[i] - r->value[i];
    switch (r->mode[i]) {
    case KEPT:
        if (price < 0 && !(q->hi[i] <= q->lo[i] && -price <= plain)) /* a row with one value is held from either side */
            return *off = -price / r->stiff[i], FREE;
        if (price > plain * (1 + TOUCH))
            return *off = (price - plain) / r->stiff[i], q->square[i] > 0 ? PAID : SPENT;
        return KEPT;
    case PAID:
        if (price < plain * (1 - TOUCH))
            return *off = (plain - price) / r->stiff[i], plain > 0 ? KEPT : FREE;
        return PAID;
    case SPENT:
        *off = limit - r->sign[i] * r->value[i];
        return *off > CLOSE * (1 + fabs(limit)) ? KEPT : SPENT;
    default:
        *off = larger(over, under);
        if (over > CLOSE * (1 + fabs(q->hi[i])) || under > CLOSE * (1 + fabs(q->lo[i])))
            return plain > 0 ? KEPT : PAID;
        return FREE;
    }
}

/* How many rows should have another mode; the one among those whose multiplier leaves its range, or else that breaks its
   limit, by the most. */
static int count_wrong(Work *s, int *worst)
{
    Stages *r = &s->stages;
    double most = 0, dearest = 0;
    int wrong = 0, broken = -1, dear = -1;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        double off = 0;
        r->better[i] = better_mode(s, i, &off);
        if (r->better[i] == r->mode[i])
            continue;
        wrong++;
        off *= sqrt(r->stiff[i]);
        if (r->mode[i] == KEPT || r->mode[i] == PAID) {
            if (dear < 0 || off > dearest)
                dearest = off, dear = i;
        } else if (broken < 0 || off > most)
            most = off, broken = i;
    }
    *worst = dear >= 0 ? dear : broken;
    return wrong;
}

/* All rows, or one of them, into the mode that they should have. */
static void change_modes(Work *s, int only)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k], to = r->better[i];
        if (to == r->mode[i] || (only >= 0 && i != only))
            continue;
        if (r->mode[i] == FREE)
            r->sign[i] = r->value[i] > q->hi[i] ? 1 : -1, r->price[i] = 0;
        else if (to == FREE)
            r->price[i] = 0;
        else if (to == SPENT || r->mode[i] == SPENT)
            r->price[i] = r->sign[i] * q->plain[i];
        r->mode[i] = to;
    }
}

/* ---- start ---------------------------------------------------------------------------------------------------- */

/* Everything that does not depend on the state now. */
static int prepare_stages(Work *s)
{
    Stages *r = &s->stages;
    for (int i = 0, row = 0; i <= N; i++) {
        r->first[i] = row;
        while (row < N_LIMITS && LIMIT_STAGE[row] == i)
            row++;
        r->first[i + 1] = row;
    }
    pack_stages(s);
    memset(r->slope, 0, sizeof r->slope);
    r->bends.count = 0;
    for (int a = 0; a < QN; a++)
        r->rate[a] = -1;
    for (int k = 0; k < QR; k++)
        r->rate[s->qp.after[k]] = QN + k;
    r->top = 0;
    for (int a = 0; a < QN; a++)
        r->top = larger(SCALE[a % NU] * SCALE[a % NU] * (s->wr[a] + s->ws[a]), r->top);
    return factor_stages(s, 1) && r->top > 0 && r->top < INFINITY && (s->damp == 0 || factor_stages(s, 0));
}

/* Rows with limits, and how stiff they are held. */
static void begin_rows(Work *s)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    double unit[M1(NL)];
    if (NL > 0)
        units(s->l, N + 1, NL, unit);
    r->rows = 0;
    for (int i = 0; i < QT; i++) {
        r->price[i] = r->after[i] = r->wanted[i] = r->value[i] = r->value_by[i] = 0, r->mode[i] = FREE, r->sign[i] = 0;
        if ((q->plain[i] <= 0 && q->square[i] <= 0) || !(q->hi[i] < INFINITY || q->lo[i] > -INFINITY))
            continue;
        double per = 1;
        if (i >= QN + QR) {
            double half = 0.5 * (q->hi[i] - q->lo[i]);
            per = half > 0 && half < INFINITY ? 1 / half : unit[LIMIT_WHICH[i - QN - QR]];
        }
        r->stiff[i] = STIFF * r->top * per * per;
        r->row[r->rows++] = i;
    }
}

/* Largest relative distance of a held row from where its multiplier says it is; those that do not come there any more
   become stiffer. The multipliers become those of now. */
static double update_prices(Work *s, int slow)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    double worst = 0;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        if (r->mode[i] == KEPT || r->mode[i] == PAID) {
            double off = fabs(r->after[i] - r->price[i]) / r->stiff[i]; /* nothing where a price is beyond all numbers */
            if (r->mode[i] == KEPT)
                off = larger(off, fabs(r->sign[i] > 0 ? r->value[i] - q->hi[i] : q->lo[i] - r->value[i]));
            double rel = off / (1 + fabs(r->sign[i] > 0 ? q->hi[i] : q->lo[i]) + fabs(r->value[i]));
            worst = larger(worst, rel);
            if (slow && rel > EXACT && rel > 0.1 * r->off[i] && r->stiff[i] < STIFFEST / STIFF * r->top)
                r->stiff[i] *= STIFFER;
            r->off[i] = rel;
        } else
            r->off[i] = INFINITY;
        r->price[i] = r->after[i];
    }
    return worst;
}

/* The row with the part in the next stage that this one has in its own; -1 at the end. */
static int row_later(const Work *s, int i)
{
    if (i < QN)
        return i + NU < QN ? i + NU : -1;
    if (i < QN + QR)
        return i + QR / N < QN + QR ? i + QR / N : -1;
    int row = i - QN - QR, stage = LIMIT_STAGE[row];
    for (int to = row + 1; to < N_LIMITS && LIMIT_STAGE[to] <= stage + 1; to++)
        if (LIMIT_STAGE[to] == stage + 1 && LIMIT_WHICH[to] == LIMIT_WHICH[row])
            return QN + QR + to;
    (void)s;
    return -1;
}

/* Rows that s->working names are expected to be held as it says, or, where the plan begins a step `later`, those of a
   stage before; the last one stays where the one before it is held alike, as limits that are touched are passed. */
static void expect(Work *s, int many, int later)
{
    Stages *r = &s->stages;
    r->expected = 0;
    for (int a = 0; a < many; a++) {
        double row = s->working[1 + 2 * a], how = s->working[2 + 2 * a];
        if (!(row >= 0 && row < QT && fabs(how) >= 1 + KEPT && fabs(how) < 2 + SPENT))
            continue;
        r->coming[r->expected] = (int)row, r->how[r->expected++] = (int)how;
    }
    if (!later)
        return;
    char held[QT] = {0};
    int kept = 0, before[QT];
    for (int a = 0; a < r->expected; a++)
        held[r->coming[a]] = (char)r->how[a];
    for (int i = 0; i < QT; i++)
        before[i] = i;
    for (int i = 0; i < QT; i++) {
        int from = row_later(s, i);
        char how = from >= 0 ? held[from] : held[before[i]] == held[i] ? held[i] : 0;
        if (from >= 0)
            before[from] = i;
        if (how)
            r->coming[kept] = i, r->how[kept++] = how;
    }
    r->expected = kept;
}

/* Bring the rows into the modes that are expected of them, where they can have them. */
static void expect_rows(Work *s)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    for (int a = 0; a < r->expected; a++) {
        int i = r->coming[a], up = r->how[a] > 0, mode = (up ? r->how[a] : -r->how[a]) - 1;
        if (!(fabs(up ? q->hi[i] : q->lo[i]) < INFINITY) || (mode == PAID && q->square[i] <= 0))
            continue;
        if (mode != KEPT && !(q->plain[i] < INFINITY))
            continue;
        r->mode[i] = mode, r->sign[i] = up ? 1 : -1;
    }
}

/* About how long condensing takes, and the working rows that are expected [ns], as benchmarks/bench_horizon.py measures. */
static double to_condense(const Work *s)
{
    double rows = (double)s->stages.expected;
    return TO_CONDENSE + rows * QN * (10 + 0.15 * rows);
}

/* Whether the next quadratic program had better be solved by stages: the factor of no row, or those that put the expected
   ones right, against condensing. */
static int by_stages_now(const Work *s) { return to_condense(s) > TO_FACTOR * (s->stages.expected > 0 ? 2.5 : 1.2); }

/* The gradient by the inputs with the multipliers of now; how large it is, relative to its terms, or to `size` if larger. */
static double gradient_of_rows(Work *s, double size)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    double worst = 0;
    pull(s);
    for (int a = 0; a < QN; a++) {
        double bent = r->bent[a] + r->damped[a] * r->v[a], left = fabs(q->g[a] + bent + r->forces[a]);
        size = larger(fabs(q->g[a]) + fabs(bent) + fabs(r->forces[a]), size);
        worst = larger(left, worst);
        if (!(left < INFINITY))
            return INFINITY;
    }
    return worst / size;
}

/* Inputs, errors and rows along the step. */
static void move_rows(Work *s, double t)
{
    Stages *r = &s->stages;
    add(r->v, t, r->dv, QN);
    add(r->e, t, r->e_by, (N + 1) * NE);
    add(r->value, t, r->value_by, QT);
}

/* Whether the inputs hardly move any more. */
static int rests(const Work *s, double how)
{
    double most = 0;
    for (int a = 0; a < QN; a++)
        most = larger(fabs(s->stages.dv[a]), most);
    return most <= how;
}

/* The largest force on one input of the row of the highest price that is paid or held. */
static double dearest_force(Work *s)
{
    Stages *r = &s->stages;
    double most = 0, after[QT];
    int dearest = -1;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        if (s->qp.plain[i] < INFINITY && r->after[i] != 0 && (dearest < 0 || fabs(r->after[i]) >= fabs(r->after[dearest])))
            dearest = i;
    }
    if (dearest < 0)
        return 0;
    memcpy(after, r->after, sizeof after);
    memset(r->after, 0, sizeof r->after);
    r->after[dearest] = after[dearest];
    pull(s);
    for (int a = 0; a < QN; a++)
        most = larger(fabs(r->forces[a]), most);
    memcpy(r->after, after, sizeof after);
    return most;
}

/* The gradient relative to that force too: where inputs cost next to nothing, prices balance each other. */
static double balance_of_rows(Work *s) { return gradient_of_rows(s, larger(dearest_force(s), 1e-300)); }

/* ---- method --------------------------------------------------------------------------------------------------- */

/* From the inputs r->v, multipliers r->price and modes on to the exact answer, or QP_NUMBER after so many factors. */
static int by_rows(Work *s, int factors)
{
    Stages *r = &s->stages;
    Qp *q = &s->qp;
    int still = 0, least = QT + 1, bent = 0, used = 0;
    double last = INFINITY;
    for (int n = 0; n < MOST_SWEEPS; n++) {
        if (price_rows(s)) {
            if (used++ == factors)
                return QP_NUMBER;
            if (now(q) > q->until)
                return QP_LATE;
            memcpy(r->slope, r->wanted, sizeof r->slope);
            if (!factor_stages(s, 0))
                return QP_NUMBER;
            q->iterations++, bent = 0;
        }
        if (!bent && !factor_bends(s))
            return QP_NUMBER;
        bent = 1;
        solve_stages(s);
        move_rows(s, 1);
        price_rows(s);
        int worst, wrong = count_wrong(s, &worst);
        if (wrong > MOST_WRONG && used >= FEW_FACTORS)
            return QP_NUMBER;
        if (wrong) {
            change_modes(s, wrong < least ? -1 : worst);
            least = wrong < least ? wrong : least, still = 0, last = INFINITY;
            continue;
        }
        double gap = update_prices(s, still > 1);
        if (gap <= ENOUGH) {
            int there = gap <= EXACT && rests(s, RESTS);
            double slope = gradient_of_rows(s, 1e-300);
            if (slope > FEW_DIGITS && rests(s, BALANCED))
                slope = balance_of_rows(s);
            gap = larger(slope, gap), q->kkt = gap;
            if (gap <= EXACT || (!(gap < 0.1 * last) && gap <= (there ? FEW_DIGITS : ENOUGH)))
                return QP_SOLVED;
        }
        if (!(gap < INFINITY) || (still > 3 && !(gap < 0.5 * last)))
            return QP_NUMBER;
        last = smaller(gap, last), still++;
    }
    return QP_NUMBER;
}
