/* A free run with forward sensitivities. The generated part before this file defines NX, NW, NP, NY, for Radau RADAU
   (the coefficients A), SHARES (of Newton steps), newton_factor and newton_solve, and the functions rates and outputs,
   (x, w, p) -> (f, df/dx, df/dp) and the same of the outputs, and slopes, (x, w, p) -> f. Matrices are stored column
   after column, but Newton's by row. The m columns of S are derivatives with respect to NP parameters, then to whatever
   else the start depends on; with m = 0 there are none. S follows x in memory. */

#include <string.h>

#define NK (3 * NX)

/* out (NX, m) = fx S + [fp 0] */
static void variation(const double *fx, const double *fp, const double *S, double *out, long m)
{
    for (long j = 0; j < m; j++) {
        double *o = out + j * NX;
        const double *s = S + j * NX;
        for (int i = 0; i < NX; i++) o[i] = j < NP ? fp[j * NX + i] : 0.0;
        for (int k = 0; k < NX; k++) {
            if (s[k] == 0.0) continue;
            for (int i = 0; i < NX; i++) o[i] += fx[k * NX + i] * s[k];
        }
    }
}

/* Rates of x and S. */
static void all_rates(const double *x, const double *w, const double *p, double *k, long m)
{
    double fx[NX * NX], fp[NX * (NP ? NP : 1)];
    if (m == 0) {
        slopes(x, w, p, k);
        return;
    }
    rates(x, w, p, k, fx, fp);
    variation(fx, fp, x + NX, k + NX, m);
}

#ifdef IMPLICIT
/* Stage slopes k and their residuals have the three stages of each state in a row. */
static void stage_state(const double *x, const double *k, double h, int i, double *out)
{
    for (int a = 0; a < NX; a++)
        out[a] = x[a] + h * (RADAU[i][0] * k[3 * a] + RADAU[i][1] * k[3 * a + 1] + RADAU[i][2] * k[3 * a + 2]);
}

static double residual(const double *x, const double *k, const double *w, const double *p, double h, double *r)
{
    double place[NX], f[NX], size = 0.0;
    for (int i = 0; i < 3; i++) {
        stage_state(x, k, h, i, place);
        slopes(place, w, p, f);
        for (int a = 0; a < NX; a++) {
            r[3 * a + i] = k[3 * a + i] - f[a];
            size += r[3 * a + i] * r[3 * a + i];
        }
    }
    return size;
}

/* Derivatives of the three stages' rates, and the factorised Newton matrix. */
static void newton_matrix(const double *x, const double *k, const double *w, const double *p, double h, double *fx,
                          double *fp, double *matrix)
{
    double place[NX], f[NX];
    for (int i = 0; i < 3; i++) {
        stage_state(x, k, h, i, place);
        rates(place, w, p, f, fx + i * NX * NX, fp + i * NX * NP);
        for (int j = 0; j < 3; j++)
            for (int c = 0; c < NX; c++)
                for (int a = 0; a < NX; a++)
                    matrix[(3 * a + i) * NK + 3 * c + j] =
                        (i == j && a == c) - h * RADAU[i][j] * fx[i * NX * NX + c * NX + a];
    }
    newton_factor(matrix);
}

/* One step; where Newton's method finds no solution, and again is set, RETRY shorter ones instead. */
static void implicit_step(double *x, double *S, const double *w, const double *p, double h, long m, int again)
{
    double k[NK] = {0}, tried[NK], best[NK], r[NK], matrix[NK * NK];
    double fx[3 * NX * NX], fp[3 * NX * (NP ? NP : 1)];
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        newton_matrix(x, k, w, p, h, fx, fp, matrix);
        residual(x, k, w, p, h, r);
        double missed = 0.0;
        for (int a = 0; a < NK; a++) {
            const double part = h * r[a] / (1.0 + fabs(x[a / 3]));
            missed += part * part;
        }
        if (again && iteration == ITERATIONS - 1 && !(missed <= MISSED * MISSED)) {
            for (int s = 0; s < RETRY; s++) implicit_step(x, S, w, p, h / RETRY, m, 0);
            return;
        }
        newton_solve(matrix, r);
        double least = INFINITY, move = 0.0, size = 0.0, spare[NK];
        for (int a = 0; a < NK; a++) {
            move = fmax(move, fabs(r[a]));
            size = fmax(size, fabs(k[a]));
        }
        const int last = iteration == ITERATIONS - 1 || move <= 1e-11 * (1.0 + size);
        for (int s = 0; s < (last ? 1 : N_SHARES); s++) {
            for (int a = 0; a < NK; a++) tried[a] = k[a] - SHARES[s] * r[a];
            const double now = last ? 0.0 : residual(x, tried, w, p, h, spare);
            if (s == 0 || now < least) {
                least = now;
                memcpy(best, tried, sizeof best);
            }
        }
        memcpy(k, best, sizeof k);
        if (last) break;
    }
    newton_matrix(x, k, w, p, h, fx, fp, matrix);
    for (long j = 0; j < m; j++) {
        double *s = S + j * NX, d[NK];
        for (int i = 0; i < 3; i++) {
            for (int a = 0; a < NX; a++) d[3 * a + i] = j < NP ? fp[i * NX * NP + j * NX + a] : 0.0;
            for (int c = 0; c < NX; c++)
                for (int a = 0; a < NX; a++) d[3 * a + i] += fx[i * NX * NX + c * NX + a] * s[c];
        }
        newton_solve(matrix, d);
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < NX; a++) s[a] += h * RADAU[2][i] * d[3 * a + i];
    }
    for (int i = 0; i < 3; i++)
        for (int a = 0; a < NX; a++) x[a] += h * RADAU[2][i] * k[3 * a + i];
}

#endif

static void step(double *x, const double *w, const double *p, double h, long m, double *y)
{
    const long n = NX * (1 + m);
    double *k = y + n, *sum = k + n;
    /* STEP */
}

/* x and S, NX (1 + m) numbers, at the first row are overwritten; out gets NY (1 + m) numbers for each row. scratch holds
   3 NX (1 + m) numbers. */
void free_run(double *x, const double *w, const double *p, long rows, long m, double h, long substeps, double *out,
              double *scratch)
{
    double yx[NY * NX], yp[NY * (NP ? NP : 1)];
    const double *S = x + NX;
    for (long k = 0; k < rows; k++) {
        double *o = out + k * NY * (1 + m);
        outputs(x, w + k * NW, p, o, yx, yp);
        for (long j = 0; j < m; j++)
            for (int i = 0; i < NY; i++) {
                double total = j < NP ? yp[j * NY + i] : 0.0;
                for (int c = 0; c < NX; c++) total += yx[c * NY + i] * S[j * NX + c];
                o[NY + j * NY + i] = total;
            }
        if (k + 1 < rows)
            for (long s = 0; s < substeps; s++) step(x, w + k * NW, p, h, m, scratch);
    }
}
