/* One plan of MARX-MPC: blend the models' predictions by speed, condense, solve one quadratic program.

   Generated before this file: NH (horizon), QN (decided inputs, those at the steps KNOT; between them the input runs
   straight), SHARE (of each of them in each step's input, and FIRST, the first step where it has one), SQUARES and
   CHANGES (products of those shares and of their changes from step to step, summed over the horizon), QR (rates: QN or 0), NJ (models), NA, NB (lags), NY (outputs), NT (tracked), NS (states),
   POSE (0: the output itself is tracked; 1: v_y and r on the ground), VY, RR (their places), STEP, SMOOTH.

   Rows over the decided inputs are QL wide, in whole vectors; beyond QN, and before FIRST, they are zero.

   State: outputs, newest first, then past inputs, newest first, then X, Y, psi where POSE. */

#define WIDE_ROW __attribute__((aligned(sizeof(V))))

enum { DONE, NOT_FINITE = 1, NO_ANSWER = 2, NO_INPUT = 3, DOUBTFUL = 4 };
#define M1(n) ((n) > 0 ? (n) : 1)
#define PAST (NA * NY)

typedef struct {
    /* what Python sets */
    double x[NS], path[(NH + 1) * 3], v[NH], applied[1], speeds[NJ];
    double A[NJ * NA * NY * NY], B[NJ * NB * NY], c[NJ * NY], offset[NY];
    double q[2], end[2], r[1], s[1], bounds[2], steps[2];
    double lowest[NS + 4], highest[NS + 4]; /* of x, path and v that can be true */
    /* what Python reads */
    double u[NH], states[(NH + 1) * NS], weights[NJ], cost[1], residual[1], seconds[1];
    int64_t iterations[1];
    /* prediction: without input, and by each decided input of 1 */
    double w[(NH + 1) * NJ], free[(NH + 1) * NY], pose[(NH + 1) * 3], error[NT][NH + 1];
    WIDE_ROW double hit[(NH + 1) * NY * QL], row[NT][(NH + 1) * QL], along[(NH + 1) * QL], across[(NH + 1) * QL];
    Qp qp;
} Work;

/* Weights of the models at a speed. */
static void weights_at(const Work *s, double v, double *w)
{
    double last = 1.0;
    for (int j = 0; j < NJ; j++) {
        double t = 0.0;
        if (j + 1 < NJ) {
            t = fmin(fmax((v - s->speeds[j]) / (s->speeds[j + 1] - s->speeds[j]), 0.0), 1.0);
            if (SMOOTH)
                t = t * t * (3.0 - 2.0 * t);
        }
        w[j] = last - t;
        last = t;
    }
}

static void speed_weights(Work *s)
{
    for (int i = 0; i <= NH; i++) {
        double *w = s->w + i * NJ, v = s->v[i < NH ? i : NH - 1];
        if (i == NH || (i && v == s->v[i - 1]))
            memcpy(w, w - NJ, sizeof(double) * NJ);
        else
            weights_at(s, v, w);
    }
    memcpy(s->weights, s->w, sizeof s->weights);
}

/* y[0] is the newest output known; u[0] the newest past input, both going back. Fills y[-1], y[-2], ... in time. */
static void advance(const Work *s, int j, double (*y)[NY], const double *u, int constant)
{
    const double *A = s->A + j * NA * NY * NY, *B = s->B + j * NB * NY;
    for (int i = 1; i <= NH; i++) {
        double *now = y[-i];
        for (int o = 0; o < NY; o++)
            now[o] = constant ? s->c[j * NY + o] + s->offset[o] : 0.0;
        for (int l = 0; l < NA; l++)
            for (int o = 0; o < NY; o++)
                for (int p = 0; p < NY; p++)
                    now[o] -= A[(l * NY + o) * NY + p] * y[1 + l - i][p];
        for (int m = i - 1; m < NB; m++) /* u[m - i] was given i - m samples before now */
            for (int o = 0; o < NY; o++)
                now[o] += B[m * NY + o] * u[m - i + 1];
    }
}

/* Blended outputs over the horizon: free and by the decided inputs (eq. 7-3). The answer to an input that rises from 0 to 1
   between two knots is a difference of ramps' answers; a decided input rises before its knot and falls after it. */
static void blend(Work *s)
{
    memset(s->free, 0, sizeof s->free);
    memset(s->hit, 0, sizeof s->hit);
    memcpy(s->free, s->x, sizeof(double) * NY);
    for (int j = 0; j < NJ; j++) {
        double most = 0;
        for (int i = 1; i <= NH; i++)
            most += s->w[i * NJ + j];
        if (most == 0)
            continue;
        double past[NH + NA][NY], unit[NH + NA][NY], u[M1(NB)] = {0}, one[M1(NB)] = {1.0};
        double ramp[NY][2 * NH + 2]; /* ramp[o][NH + i]: the answer after i steps; zero before */
        memcpy(past[NH], s->x, sizeof(double) * PAST);
        memset(unit, 0, sizeof unit);
        memset(ramp, 0, sizeof ramp);
        memcpy(u + 1, s->x + PAST, sizeof(double) * (NB - 1));
        advance(s, j, past + NH, u, 1);
        advance(s, j, unit + NH, one, 0);
        for (int o = 0; o < NY; o++) {
            double step = 0;
            for (int i = 1; i <= NH; i++) {
                step += unit[NH - i][o];
                ramp[o][NH + i + 1] = ramp[o][NH + i] + step;
            }
        }
        for (int i = 1; i <= NH; i++) {
            double w = s->w[i * NJ + j], rise[QN + 1];
            for (int o = 0; o < NY; o++) {
                const double *since = ramp[o] + NH + i;
                double *hit = s->hit + (i * NY + o) * QL;
                s->free[i * NY + o] += w * past[NH - i][o];
                rise[0] = w * (since[1] - since[0]), rise[QN] = 0;
                for (int k = 1; k < QN; k++)
                    rise[k] = w / (double)(KNOT[k] - KNOT[k - 1]) * (since[-KNOT[k - 1]] - since[-KNOT[k]]);
                for (int k = 0; k < QN; k++)
                    hit[k] += rise[k] - rise[k + 1];
            }
        }
    }
}

#if POSE
#define WIDE ((NH + LANES) / LANES) /* vectors that hold NH + 1 numbers */

INLINE double total(const double *row)
{
    V sum = {0};
    for (int k = 0; k < QL / LANES; k++)
        sum += ((const V *)row)[k];
    double all = 0;
    for (int l = 0; l < LANES; l++)
        all += v_lane(sum, l);
    return all;
}

static void sines(const V *angle, V *cosine, V *sine)
{
    for (int i = 0; i < WIDE; i++)
        cosine[i] = v_cos(angle[i]), sine[i] = v_sin(angle[i]);
}

/* Error rows across the path and in heading, in the frame of the vehicle now, linear about the motion with the input
   held as it was: where that turns, the change of heading moves the vehicle along as well as across. */
static void track(Work *s)
{
    const double *here = s->x + NS - 3;
    double cosine = cos(here[2]), sine = sin(here[2]), x = 0, y = 0, psi = 0, held = s->applied[0];
    WIDE_ROW double turn[QL] = {0}, side[QL] = {0}, ahead[QL] = {0};
    double out[(NH + 1) * NY];
    V angles[2][WIDE], cosine_of[2][WIDE], sine_of[2][WIDE]; /* of the vehicle between steps, of the path */
    double *mean = (double *)angles[0], *lean = (double *)angles[1];
    memset(angles, 0, sizeof angles);
    for (int i = 0; i < (NH + 1) * NY; i++)
        out[i] = s->free[i] + held * total(s->hit + i * QL);
    for (int i = 0; i <= NH; i++) {
        if (i) {
            mean[i] = psi + STEP * (2 * out[(i - 1) * NY + RR] + out[i * NY + RR]) / 6;
            psi += 0.5 * STEP * (out[(i - 1) * NY + RR] + out[i * NY + RR]);
        }
        lean[i] = s->path[3 * i + 2] - here[2];
        s->pose[3 * i + 2] = psi;
    }
    sines(angles[0], cosine_of[0], sine_of[0]);
    sines(angles[1], cosine_of[1], sine_of[1]);
    for (int i = 0; i <= NH; i++) {
        if (i) {
            const double *h0 = s->hit + (i - 1) * NY * QL, *h1 = h0 + NY * QL;
            const double *last = out + (i - 1) * NY, *next = out + i * NY;
            double v = s->v[i - 1], c = ((double *)cosine_of[0])[i], b = ((double *)sine_of[0])[i];
            double v_y = 0.5 * (last[VY] + next[VY]), dx = STEP * (v * c - v_y * b), dy = STEP * (v * b + v_y * c);
            x += dx, y += dy;
            for (int k = 0; k < QL; k++) {
                double r0 = h0[RR * QL + k], r1 = h1[RR * QL + k], d = turn[k] + STEP * (2 * r0 + r1) / 6;
                double slide = 0.5 * STEP * (h0[VY * QL + k] + h1[VY * QL + k]);
                ahead[k] -= dy * d + b * slide;
                side[k] += dx * d + c * slide;
                turn[k] += 0.5 * STEP * (r0 + r1);
            }
        }
        const double *p = s->path + 3 * i;
        double px = p[0] - here[0], py = p[1] - here[1], a = lean[i];
        double c = ((double *)cosine_of[1])[i], b = ((double *)sine_of[1])[i];
        double along = cosine * px + sine * py, across = cosine * py - sine * px, *row = s->row[0] + i * QL;
        s->pose[3 * i] = x, s->pose[3 * i + 1] = y;
        memcpy(s->along + i * QL, ahead, sizeof ahead);
        memcpy(s->across + i * QL, side, sizeof side);
        memcpy(s->row[1] + i * QL, turn, sizeof turn);
        for (int k = 0; k < QL; k++)
            row[k] = c * side[k] - b * ahead[k];
        s->error[0][i] = c * (y - across) - b * (x - along) - held * total(row);
        s->error[1][i] = s->pose[3 * i + 2] - a - held * total(turn);
    }
    double whole = 6.283185307179586 * round((here[2] - s->path[2]) / 6.283185307179586);
    for (int i = 0; i <= NH; i++)
        s->error[1][i] -= whole;
}
#else
static void track(Work *s)
{
    for (int i = 0; i <= NH; i++) {
        s->error[0][i] = s->free[i * NY] - s->path[3 * i + 1];
        memcpy(s->row[0] + i * QL, s->hit + i * NY * QL, sizeof(double) * QL);
    }
}
#endif

static double condense(Work *s)
{
    Qp *q = &s->qp;
    double *H = (double *)q->H, r = s->r[0], c = s->s[0], fixed = c * s->applied[0] * s->applied[0];
    for (int k = 0; k < QN * QL; k++)
        H[k] = r * SQUARES[k] + c * CHANGES[k];
    memset(q->g, 0, sizeof q->g);
    for (int t = 0; t < NT; t++) {
        if (s->q[t] == 0 && s->end[t] == 0)
            continue;
        fixed += s->q[t] * s->error[t][0] * s->error[t][0];
        for (int i = 1; i <= NH; i++) {
            const double *row = s->row[t] + i * QL;
            double weight = i < NH ? s->q[t] : s->end[t], e = s->error[t][i];
            fixed += weight * e * e;
            for (int b = 0; b < QL; b++)
                q->g[b] += weight * e * row[b];
            for (int a = 0; a < QN && FIRST[a] < i; a++)
                add_rows(H + a * QL, weight * row[a], row, 0, QL); /* whole rows are faster than their upper parts */
        }
    }
    q->g[0] -= c * s->applied[0];
    return fixed;
}

static void limit(Work *s)
{
    Qp *q = &s->qp;
    for (int k = 0; k < QN; k++)
        q->lo[k] = s->bounds[0], q->hi[k] = s->bounds[1];
    for (int k = 0; k < QR; k++) {
        double base = k ? 0 : s->applied[0], steps = k ? (double)(KNOT[k] - KNOT[k - 1]) : 1;
        q->after[k] = k, q->before[k] = k - 1;
        q->lo[QN + k] = base + steps * s->steps[0], q->hi[QN + k] = base + steps * s->steps[1];
    }
    for (int i = 0; i < QT; i++)
        q->square[i] = 0, q->plain[i] = INFINITY;
    q->until = INFINITY;
}

/* An input within limits and rate, from which rounding may have led it. */
static double keep(const Work *s, int i, double u)
{
    double before = i ? s->u[i - 1] : s->applied[0];
    u = fmin(fmax(u, before + s->steps[0]), before + s->steps[1]);
    return fmin(fmax(u, s->bounds[0]), s->bounds[1]);
}

/* The predicted states: lags filled with what was measured, predicted and decided. */
static void report(Work *s)
{
    const double *u = s->qp.u; /* zero beyond QN */
    double y[(NH + 1) * NY];
#if POSE
    WIDE_ROW double change[QL] = {0};
    double cosine = cos(s->x[NS - 1]), sine = sin(s->x[NS - 1]);
    for (int k = 0; k < QN; k++)
        change[k] = u[k] - s->applied[0];
#endif
    for (int i = 0; i < NH; i++)
        s->u[i] = keep(s, i, dot(SHARE + i * QL, u, QN));
    for (int i = 0; i < (NH + 1) * NY; i++)
        y[i] = s->free[i] + dot(s->hit + i * QL, u, QN);
    for (int i = 0; i <= NH; i++) {
        double *x = s->states + i * NS;
        for (int l = 0; l < NA; l++)
            memcpy(x + l * NY, l <= i ? y + (i - l) * NY : s->x + (l - i) * NY, sizeof(double) * NY);
        for (int m = 1; m < NB; m++)
            x[PAST + m - 1] = m <= i ? s->u[i - m] : s->x[PAST + m - i - 1];
#if POSE
        const double *from = s->x + NS - 3;
        double along = s->pose[3 * i] + dot(s->along + i * QL, change, QL);
        double across = s->pose[3 * i + 1] + dot(s->across + i * QL, change, QL);
        x[NS - 3] = from[0] + cosine * along - sine * across;
        x[NS - 2] = from[1] + sine * along + cosine * across;
        x[NS - 1] = from[2] + s->pose[3 * i + 2] + dot(s->row[1] + i * QL, change, QL);
#endif
    }
}

int marx_plan(Work *s)
{
    double begin = now(&s->qp);
    if (!(moderate(s->x, NS) && moderate(s->path, (NH + 1) * 3) && moderate(s->v, NH) && moderate(s->applied, 1) &&
          moderate(s->offset, NY)))
        return NOT_FINITE;
    speed_weights(s);
    blend(s);
    track(s);
    double fixed = condense(s);
    limit(s);
    Qp *q = &s->qp;
    if (!qp_factor(q))
        return NO_ANSWER;
    int status = qp_solve(q, 0);
    *s->iterations = q->iterations, *s->residual = q->kkt;
    if (status == QP_SOLVED && !(q->kkt <= 1e-6)) /* numbers of wildly different size */
        return NO_ANSWER;
    if (status != QP_SOLVED)
        return status == QP_INFEASIBLE ? NO_INPUT : NO_ANSWER;
    const double *H = (const double *)q->H;
    for (int a = 0; a < QN; a++) {
        double u = q->u[a];
        fixed += u * (2 * q->g[a] + H[a * QL + a] * u + 2 * dot(H + a * QL + a + 1, q->u + a + 1, QN - a - 1));
    }
    *s->cost = fixed;
    report(s);
    *s->seconds = now(&s->qp) - begin;
    return DONE;
}

/* The same, judged; DOUBTFUL, with nothing solved, where anything given is for a closer look. */
int marx_again(Work *s)
{
    const double *low = s->lowest, *high = s->highest;
    int good = plausible(s->x, 1, NS, low, high) && plausible(s->path, NH + 1, 3, low + NS, high + NS) &&
               plausible(s->v, NH, 1, low + NS + 3, high + NS + 3) && fabs(*s->applied) <= ANY_INPUT;
    *s->applied = fmin(fmax(*s->applied, s->bounds[0]), s->bounds[1]);
    if (!good)
        return DOUBTFUL;
    int status = marx_plan(s);
    return status == DONE && !(moderate(s->u, NH) && moderate(s->states, (NH + 1) * NS)) ? NO_ANSWER : status;
}
