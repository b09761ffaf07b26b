/* One plan of MARX-MPC: blend the models' predictions by speed, condense, solve one quadratic program.

   Generated before this file: QN (horizon), QR (rates: QN or 0), NJ (models), NA, NB (lags), NY (outputs), NT (tracked),
   NS (states), POSE (0: the output itself is tracked; 1: v_y and r on the ground), VY, RR (their places), STEP, SMOOTH.

   State: outputs, newest first, then past inputs, newest first, then X, Y, psi where POSE. */

enum { DONE, NOT_FINITE = 1, NO_ANSWER = 2, NO_INPUT = 3 };
#define M1(n) ((n) > 0 ? (n) : 1)
#define PAST (NA * NY)

typedef struct {
    /* what Python sets */
    double x[NS], path[(QN + 1) * 3], v[QN], applied[1], speeds[NJ];
    double A[NJ * NA * NY * NY], B[NJ * NB * NY], c[NJ * NY], offset[NY];
    double q[2], end[2], r[1], s[1], bounds[2], steps[2];
    /* what Python reads */
    double u[QN], states[(QN + 1) * NS], weights[NJ], cost[1], residual[1], seconds[1];
    int64_t iterations[1];
    /* prediction: without input, and by an input of 1 at step k */
    double w[(QN + 1) * NJ], free[(QN + 1) * NY], hit[(QN + 1) * QN * NY], pose[(QN + 1) * 3];
    double row[NT][(QN + 1) * QN], error[NT][QN + 1], along[(QN + 1) * QN], across[(QN + 1) * QN];
    Qp qp;
} Work;

static int finite(const double *a, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += a[i] * 0.0;
    return sum == 0.0;
}

static void speed_weights(Work *s)
{
    for (int i = 0; i <= QN; i++) {
        double *w = s->w + i * NJ, v = s->v[i < QN ? i : QN - 1], last = 1.0;
        if (i && i < QN && v == s->v[i - 1]) {
            memcpy(w, w - NJ, sizeof(double) * NJ);
            continue;
        }
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
    memcpy(s->weights, s->w, sizeof s->weights);
}

/* y[0] is the newest output known; u[0] the newest past input, both going back. Fills y[-1], y[-2], ... in time. */
static void advance(const Work *s, int j, double (*y)[NY], const double *u, int constant)
{
    const double *A = s->A + j * NA * NY * NY, *B = s->B + j * NB * NY;
    for (int i = 1; i <= QN; i++) {
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

/* Blended outputs over the horizon: free and by unit inputs (eq. 7-3). */
static void blend(Work *s)
{
    memset(s->free, 0, sizeof s->free);
    memset(s->hit, 0, sizeof s->hit);
    memcpy(s->free, s->x, sizeof(double) * NY);
    for (int j = 0; j < NJ; j++) {
        double most = 0;
        for (int i = 1; i <= QN; i++)
            most += s->w[i * NJ + j];
        if (most == 0)
            continue;
        double past[QN + NA][NY], unit[QN + NA][NY], u[M1(NB)] = {0}, one[M1(NB)] = {1.0};
        memcpy(past[QN], s->x, sizeof(double) * PAST);
        memset(unit, 0, sizeof unit);
        memcpy(u + 1, s->x + PAST, sizeof(double) * (NB - 1));
        advance(s, j, past + QN, u, 1);
        advance(s, j, unit + QN, one, 0);
        for (int i = 1; i <= QN; i++) {
            double w = s->w[i * NJ + j];
            for (int o = 0; o < NY; o++) {
                s->free[i * NY + o] += w * past[QN - i][o];
                double *hit = s->hit + (i * NY + o) * QN;
                const double *from = (const double *)unit + (QN - i) * NY + o;
                for (int k = 0; k < i; k++)
                    hit[k] += w * from[k * NY];
            }
        }
    }
}

#if POSE
#define WIDE ((QN + LANES) / LANES) /* vectors that hold QN + 1 numbers */

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
    double turn[QN] = {0}, side[QN] = {0}, ahead[QN] = {0}, out[(QN + 1) * NY];
    V angles[2][WIDE] = {{{0}}}, cosine_of[2][WIDE], sine_of[2][WIDE]; /* of the vehicle between steps, of the path */
    double *mean = (double *)angles[0], *lean = (double *)angles[1];
    memcpy(out, s->free, sizeof out);
    for (int i = 0; i <= QN; i++) {
        for (int o = 0; o < NY; o++)
            for (int k = 0; k < i; k++)
                out[i * NY + o] += s->hit[(i * NY + o) * QN + k] * held;
        if (i) {
            mean[i] = psi + STEP * (2 * out[(i - 1) * NY + RR] + out[i * NY + RR]) / 6;
            psi += 0.5 * STEP * (out[(i - 1) * NY + RR] + out[i * NY + RR]);
        }
        lean[i] = s->path[3 * i + 2] - here[2];
        s->pose[3 * i + 2] = psi;
    }
    sines(angles[0], cosine_of[0], sine_of[0]);
    sines(angles[1], cosine_of[1], sine_of[1]);
    for (int i = 0; i <= QN; i++) {
        if (i) {
            const double *h0 = s->hit + (i - 1) * NY * QN, *h1 = h0 + NY * QN;
            const double *last = out + (i - 1) * NY, *next = out + i * NY;
            double v = s->v[i - 1], c = ((double *)cosine_of[0])[i], b = ((double *)sine_of[0])[i];
            double v_y = 0.5 * (last[VY] + next[VY]), dx = STEP * (v * c - v_y * b), dy = STEP * (v * b + v_y * c);
            x += dx, y += dy;
            for (int k = 0; k < i; k++) {
                double r0 = h0[RR * QN + k], r1 = h1[RR * QN + k], d = turn[k] + STEP * (2 * r0 + r1) / 6;
                double slide = 0.5 * STEP * (h0[VY * QN + k] + h1[VY * QN + k]);
                ahead[k] -= dy * d + b * slide;
                side[k] += dx * d + c * slide;
                turn[k] += 0.5 * STEP * (r0 + r1);
            }
        }
        const double *p = s->path + 3 * i;
        double px = p[0] - here[0], py = p[1] - here[1], a = lean[i];
        double c = ((double *)cosine_of[1])[i], b = ((double *)sine_of[1])[i];
        double along = cosine * px + sine * py, across = cosine * py - sine * px;
        s->pose[3 * i] = x, s->pose[3 * i + 1] = y;
        s->error[0][i] = c * (y - across) - b * (x - along);
        s->error[1][i] = s->pose[3 * i + 2] - a;
        memcpy(s->along + i * QN, ahead, sizeof ahead);
        memcpy(s->across + i * QN, side, sizeof side);
        memcpy(s->row[1] + i * QN, turn, sizeof turn);
        for (int k = 0; k < i; k++) {
            double e = c * side[k] - b * ahead[k];
            s->row[0][i * QN + k] = e;
            s->error[0][i] -= e * held;
            s->error[1][i] -= turn[k] * held;
        }
    }
    double whole = 6.283185307179586 * round((here[2] - s->path[2]) / 6.283185307179586);
    for (int i = 0; i <= QN; i++)
        s->error[1][i] -= whole;
}
#else
static void track(Work *s)
{
    for (int i = 0; i <= QN; i++) {
        s->error[0][i] = s->free[i * NY] - s->path[3 * i + 1];
        memcpy(s->row[0] + i * QN, s->hit + i * NY * QN, sizeof(double) * QN);
    }
}
#endif

static double condense(Work *s)
{
    Qp *q = &s->qp;
    double *H = (double *)q->H, r = s->r[0], c = s->s[0], fixed = c * s->applied[0] * s->applied[0];
    memset(H, 0, sizeof q->H);
    memset(q->g, 0, sizeof q->g);
    for (int t = 0; t < NT; t++) {
        if (s->q[t] == 0 && s->end[t] == 0)
            continue;
        fixed += s->q[t] * s->error[t][0] * s->error[t][0];
        for (int i = 1; i <= QN; i++) {
            const double *row = s->row[t] + i * QN;
            double weight = i < QN ? s->q[t] : s->end[t], e = s->error[t][i];
            fixed += weight * e * e;
            for (int b = 0; b < QN; b++)
                q->g[b] += weight * e * row[b];
            for (int a = 0; a < i; a++) { /* rows are zero from i on; whole ones are faster than their upper parts */
                double f = weight * row[a], *h = H + a * QL;
                for (int b = 0; b < QN; b++)
                    h[b] += f * row[b];
            }
        }
    }
    for (int k = 0; k < QN; k++) {
        H[k * QL + k] += r + c;
        if (k + 1 < QN) {
            H[k * QL + k] += c;
            H[k * QL + k + 1] -= c;
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
        double base = k ? 0 : s->applied[0];
        q->after[k] = k, q->before[k] = k - 1;
        q->lo[QN + k] = base + s->steps[0], q->hi[QN + k] = base + s->steps[1];
    }
    for (int i = 0; i < QT; i++)
        q->square[i] = 0, q->plain[i] = INFINITY;
    q->until = INFINITY;
}

/* The predicted states: lags filled with what was measured, predicted and decided. */
static void report(Work *s)
{
    double y[(QN + 1) * NY];
#if POSE
    double cosine = cos(s->x[NS - 1]), sine = sin(s->x[NS - 1]);
#endif
    memcpy(y, s->free, sizeof y);
    for (int i = 1; i <= QN; i++)
        for (int o = 0; o < NY; o++)
            for (int k = 0; k < i; k++)
                y[i * NY + o] += s->hit[(i * NY + o) * QN + k] * s->u[k];
    for (int i = 0; i <= QN; i++) {
        double *x = s->states + i * NS;
        for (int l = 0; l < NA; l++)
            memcpy(x + l * NY, l <= i ? y + (i - l) * NY : s->x + (l - i) * NY, sizeof(double) * NY);
        for (int m = 1; m < NB; m++)
            x[PAST + m - 1] = m <= i ? s->u[i - m] : s->x[PAST + m - i - 1];
#if POSE
        const double *from = s->x + NS - 3;
        double across = s->pose[3 * i + 1], psi = s->pose[3 * i + 2], along = s->pose[3 * i];
        for (int k = 0; k < i; k++) {
            double u = s->u[k] - s->applied[0];
            along += s->along[i * QN + k] * u;
            across += s->across[i * QN + k] * u;
            psi += s->row[1][i * QN + k] * u;
        }
        x[NS - 3] = from[0] + cosine * along - sine * across;
        x[NS - 2] = from[1] + sine * along + cosine * across;
        x[NS - 1] = from[2] + psi;
#endif
    }
}

int marx_plan(Work *s)
{
    double begin = now();
    if (!(finite(s->x, NS) && finite(s->path, (QN + 1) * 3) && finite(s->v, QN) && finite(s->applied, 1) && finite(s->offset, NY)))
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
    if (status != QP_SOLVED)
        return status == QP_INFEASIBLE ? NO_INPUT : NO_ANSWER;
    memcpy(s->u, q->u, sizeof s->u);
    const double *H = (const double *)q->H;
    for (int a = 0; a < QN; a++) {
        fixed += 2 * q->g[a] * s->u[a] + H[a * QL + a] * s->u[a] * s->u[a];
        for (int b = a + 1; b < QN; b++)
            fixed += 2 * H[a * QL + b] * s->u[a] * s->u[b];
    }
    *s->cost = fixed;
    report(s);
    *s->seconds = now() - begin;
    return DONE;
}

Work *marx_new(void)
{
    void *at = NULL;
    return posix_memalign(&at, 64, sizeof(Work)) ? NULL : memset(at, 0, sizeof(Work));
}
void marx_free(Work *s)
{
    free(s);
}
