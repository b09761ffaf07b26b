/* The quadratic program of a step without condensing it: proximal method of multipliers, its inner problems by semismooth
   Newton steps with an exact line search, each on a Riccati factor.

   The same problem as in qp.c. Rows outside their limits, or held there, have a slope in the factor and a multiplier that
   is brought up to date whenever their modes stay as they are; once the right rows are held, the factor stays and what
   follows is iterative refinement of the exact answer.

   Rockafellar, Math. Oper. Res. 1, 1976; Hermans, Themelis, Patrinos, Math. Program. Comput. 14, 2022 (QPALM). */

#define STIFF (1 / 1e-6)  /* of a held row, relative to the largest curvature by an input */
#define STIFFER 30.0      /* where a row does not come to its limit */
#define STIFFEST (1 / 1e-11)
#define MOST_SWEEPS 40
#define EXACT 1e-12       /* residual, relative to the size of its terms, with which an answer is one at once */
#define ENOUGH 1e-9       /* the same where refinement gains nothing any more */

/* ---- rows ----------------------------------------------------------------------------------------------------- */

/* Multiplier of a row at this value, its slope, and what holds it; `forced` into the mode that it has. */
INLINE double price_of(const Work *s, int i, double value, double *slope, int *mode, double *sign, int forced)
{
    const Qp *q = &s->qp;
    double stiff = s->stages.stiff[i], old = s->stages.price[i], plain = q->plain[i], square = q->square[i];
    double up = old + stiff * (value - q->hi[i]), down = old + stiff * (value - q->lo[i]), over;
    if (!forced) {
        *sign = up > 0 ? 1 : down < 0 ? -1 : 0;
        over = *sign > 0 ? up : -down;
        *mode = *sign == 0 ? FREE : over <= plain ? KEPT : square > 0 ? PAID : SPENT;
    } else
        over = *sign > 0 ? up : -down;
    switch (*mode) {
    case KEPT:
        *slope = stiff;
        return *sign * over;
    case PAID:
        *slope = stiff * square / (stiff + square);
        return *sign * (plain + square * (over - plain) / (stiff + square));
    case SPENT:
        *slope = 0;
        return *sign * plain;
    default:
        *slope = 0;
        return 0;
    }
}

/* Multipliers, modes and slopes of all rows; how many slopes are not those of the factor. */
static int price_rows(Work *s, int forced)
{
    int changed = 0;
    for (int k = 0; k < s->stages.rows; k++) {
        int i = s->stages.row[k];
        double slope;
        s->stages.after[i] = price_of(s, i, s->stages.value[i], &slope, s->stages.mode + i, s->stages.sign + i, forced);
        changed += slope != s->stages.slope[i];
        s->stages.wanted[i] = slope;
    }
    return changed;
}

/* Where along the step the penalised cost is least: its derivative is linear in pieces, and rises. */
static double line_search(const Work *s, double at_start, double bend)
{
    const double *value = s->stages.value, *by = s->stages.value_by;
    double low = 0, high = 1, t = 1, first = 0;
    for (int n = -1; n < 40; n++) {
        double sum = at_start + (n < 0 ? 0 : t) * bend, rise = bend;
        for (int k = 0; k < s->stages.rows; k++) {
            int i = s->stages.row[k], mode;
            double slope, sign;
            if (by[i] != 0) {
                sum += by[i] * price_of(s, i, value[i] + (n < 0 ? 0 : t) * by[i], &slope, &mode, &sign, 0);
                rise += slope * by[i] * by[i];
            }
        }
        if (n < 0) {
            first = sum;
            continue;
        }
        if (fabs(sum) <= 1e-3 * fabs(first) || (n == 0 && sum <= 0))
            return t;
        *(sum > 0 ? &high : &low) = t;
        double next = t - sum / rise;
        t = next > low && next < high ? next : 0.5 * (low + high);
    }
    return t;
}

/* ---- start ---------------------------------------------------------------------------------------------------- */

/* Everything that does not depend on the state now. */
static int prepare_stages(Work *s)
{
    Stages *r = &s->stages;
    join_steps(s);
    for (int i = 0, row = 0; i <= N; i++) {
        r->first[i] = row;
        while (row < N_LIMITS && LIMIT_STAGE[row] == i)
            row++;
        r->first[i + 1] = row;
    }
    memset(r->slope, 0, sizeof r->slope);
    for (int a = 0; a < QN; a++)
        r->rate[a] = -1;
    for (int k = 0; k < QR; k++)
        r->rate[s->qp.after[k]] = QN + k;
    r->top = 0;
    for (int a = 0; a < QN; a++)
        r->top = larger(SCALE[a % NU] * SCALE[a % NU] * (s->wr[a] + s->ws[a]), r->top);
    return factor_stages(s, 1) && r->top > 0 && r->top < INFINITY;
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
        r->price[i] = r->after[i] = r->value[i] = r->value_by[i] = 0, r->mode[i] = FREE, r->sign[i] = 0;
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
            double off = fabs(r->after[i] - r->price[i]) / r->stiff[i];
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
   stage before; the last one stays. */
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
    int kept = 0;
    for (int a = 0; a < r->expected; a++)
        held[r->coming[a]] = (char)r->how[a];
    for (int i = 0; i < QT; i++) {
        int from = row_later(s, i);
        if (held[from < 0 ? i : from])
            r->coming[kept] = i, r->how[kept++] = held[from < 0 ? i : from];
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

/* Whether the next quadratic program had better be solved by stages, by times [ns] that benchmarks/bench_horizon.py
   measures: condensing, and each working row, against few factors where few rows are expected, else an interior point.
*/
static int by_stages_now(const Work *s)
{
    double rows = (double)s->stages.expected, share = smaller(4 * rows / QN, 1);
    return TO_CONDENSE + 0.25 * rows * rows * QN > TO_FACTOR * (2 + 13 * share);
}

/* The gradient by the inputs with the multipliers of now; how large it is, relative to its terms. */
static double gradient_of_rows(Work *s)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    double size = 1e-300, worst = 0;
    pull(s, r->v, r->e, r->after, r->bent, r->forces);
    for (int a = 0; a < QN; a++) {
        r->r[a] = q->g[a] + r->bent[a] + r->forces[a];
        size = larger(fabs(q->g[a]) + fabs(r->bent[a]) + fabs(r->forces[a]), size);
        worst = larger(fabs(r->r[a]), worst);
        if (!(fabs(r->r[a]) < INFINITY))
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

/* ---- method of multipliers ------------------------------------------------------------------------------------ */

/* From the inputs r->v and multipliers r->price on, or first a step with the rows held that are expected (`forced`): to
   the exact answer, or QP_NUMBER after so many factors. */
static int by_multipliers(Work *s, int forced, int factors)
{
    Stages *r = &s->stages;
    Qp *q = &s->qp;
    int still = 0;
    double last = INFINITY;
    for (int n = 0; n < MOST_SWEEPS; n++) {
        int changed = price_rows(s, forced);
        double worst = gradient_of_rows(s);
        if (!(worst < INFINITY))
            return QP_NUMBER;
        if (!forced && (!changed || worst <= ENOUGH)) {
            double gap = update_prices(s, still > 1);
            gap = larger(worst, gap), q->kkt = gap;
            if (gap <= EXACT || (gap <= ENOUGH && !(gap < 0.1 * last)))
                return QP_SOLVED;
            if (still > 3 && !(gap < 0.5 * last))
                return QP_NUMBER;
            last = smaller(gap, last), still++;
            changed = price_rows(s, 0);
            gradient_of_rows(s);
        }
        if (changed && !(factors-- > 0))
            return QP_NUMBER;
        if (changed) {
            memcpy(r->slope, r->wanted, sizeof r->slope);
            if (now(q) > q->until)
                return QP_LATE;
            if (!factor_stages(s, 0))
                return QP_NUMBER;
            q->iterations++;
        }
        solve_stages(s, r->r, r->dv);
        respond(s, r->dv, r->dx, r->e_by, r->value_by);
        double t = 1, start = 0, bend = 0;
        if (!forced) {
            for (int a = 0; a < QN; a++) {
                double step = r->dv[a] - (a < NU ? 0 : r->dv[a - NU]), c = SCALE[a % NU] * SCALE[a % NU];
                start += (q->g[a] + r->bent[a]) * r->dv[a];
                bend += c * (s->wr[a] * r->dv[a] * r->dv[a] + s->ws[a] * step * step);
            }
            for (int i = 0; i < (N + 1) * NE; i++)
                bend += s->q[i] * r->e_by[i] * r->e_by[i];
            t = line_search(s, start, bend);
        }
        move_rows(s, t);
        forced = 0;
    }
    return QP_NUMBER;
}
