/* A free run with forward sensitivities. The generated part before this file defines NX, NU, NY, for Radau RADAU
   (the coefficients A), SHARES (of Newton steps), newton_factor and newton_solve, and the functions rates,
   (x, u, p) -> (f, df/dx, df/du, df/dp), and the same of the outputs; slopes are rates without derivatives. along_rates
   and along_outputs make df/dx S + df/du du/dp + df/dp, (., m), of their derivatives, S and du/dp. u, the drive, is the
   same for all steps of a row, and comes from a library of its own: driven, (w, q) -> (u, du/dq), where q are those of
   all p that it depends on, and undriven without derivatives.

   Matrices are stored row after row. The rows of S and of derivatives by parameters are padded with zeros to a multiple
   of WIDE numbers, so that they are added up by whole vectors: the m columns of S are derivatives with respect to the
   parameters, MP with their padding, or, where there are more, to whatever else the start depends on; with m = 0 there
   are none. S follows x in memory, and the derivatives of u, (NU, m), follow u. */

#include <string.h>

#define NK (3 * NX)

/* Rates of x and S. */
static void all_rates(const double *x, const double *u, const double *p, double *k, long m)
{
    double fx[NX * NX] = {0}, fu[NX * NU] = {0}, fp[NX * MP] = {0};
    if (m == 0) {
        slopes(x, u, p, k);
        return;
    }
    rates(x, u, p, k, fx, fu, fp);
    along_rates(fx, fu, fp, x + NX, u + NU, k + NX, m);
}

#ifdef IMPLICIT
/* Stage slopes k and their residuals have the three stages of each state in a row. */
static void stage_state(const double *x, const double *k, double h, int i, double *out)
{
    for (int a = 0; a < NX; a++)
        out[a] = x[a] + h * (RADAU[i][0] * k[3 * a] + RADAU[i][1] * k[3 * a + 1] + RADAU[i][2] * k[3 * a + 2]);
}

static double residual(const double *x, const double *k, const double *u, const double *p, double h, double *r)
{
    double place[NX], f[NX], size = 0.0;
    for (int i = 0; i < 3; i++) {
        stage_state(x, k, h, i, place);
        slopes(place, u, p, f);
        for (int a = 0; a < NX; a++) {
            r[3 * a + i] = k[3 * a + i] - f[a];
            size += r[3 * a + i] * r[3 * a + i];
        }
    }
    return size;
}

/* Derivatives of the three stages' rates, and the factorised Newton matrix. */
static void newton_matrix(const double *x, const double *k, const double *u, const double *p, double h, double *fx,
                          double *fu, double *fp, double *matrix)
{
    double place[NX], f[NX];
    for (int i = 0; i < 3; i++) {
        stage_state(x, k, h, i, place);
        rates(place, u, p, f, fx + i * NX * NX, fu + i * NX * NU, fp + i * NX * MP);
        for (int j = 0; j < 3; j++)
            for (int c = 0; c < NX; c++)
                for (int a = 0; a < NX; a++)
                    matrix[(3 * a + i) * NK + 3 * c + j] =
                        (i == j && a == c) - h * RADAU[i][j] * fx[i * NX * NX + a * NX + c];
    }
    newton_factor(matrix);
}

/* One step; where Newton's method finds no solution, and again is set, RETRY shorter ones instead. */
static void implicit_step(double *x, double *S, const double *u, const double *p, double h, long m, int again)
{
    double k[NK] = {0}, tried[NK], best[NK], r[NK], matrix[NK * NK];
    double fx[3 * NX * NX] = {0}, fu[3 * NX * NU] = {0}, fp[3 * NX * MP] = {0};
    for (int iteration = 0; iteration < ITERATIONS; iteration++) {
        newton_matrix(x, k, u, p, h, fx, fu, fp, matrix);
        residual(x, k, u, p, h, r);
        double missed = 0.0;
        for (int a = 0; a < NK; a++) {
            const double part = h * r[a] / (1.0 + fabs(x[a / 3]));
            missed += part * part;
        }
        if (again && iteration == ITERATIONS - 1 && !(missed <= MISSED * MISSED)) {
            for (int s = 0; s < RETRY; s++) implicit_step(x, S, u, p, h / RETRY, m, 0);
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
            const double now = last ? 0.0 : residual(x, tried, u, p, h, spare);
            if (s == 0 || now < least) {
                least = now;
                memcpy(best, tried, sizeof best);
            }
        }
        memcpy(k, best, sizeof k);
        if (last) break;
    }
    newton_matrix(x, k, u, p, h, fx, fu, fp, matrix);
    for (long j = 0; j < m; j++) {
        double d[NK];
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < NX; a++) {
                double total = j < MP ? fp[(i * NX + a) * MP + j] : 0.0;
                for (int c = 0; c < NX; c++) total += fx[(i * NX + a) * NX + c] * S[c * m + j];
                for (int c = 0; c < NU; c++) total += fu[(i * NX + a) * NU + c] * u[NU + c * m + j];
                d[3 * a + i] = total;
            }
        newton_solve(matrix, d);
        for (int i = 0; i < 3; i++)
            for (int a = 0; a < NX; a++) S[a * m + j] += h * RADAU[2][i] * d[3 * a + i];
    }
    for (int i = 0; i < 3; i++)
        for (int a = 0; a < NX; a++) x[a] += h * RADAU[2][i] * k[3 * a + i];
}

#endif

static void step(double *x, const double *u, const double *p, double h, long m, double *y)
{
    const long n = NX * (1 + m);
    double *k = y + n, *sum = k + n;
    /* STEP */
}

typedef void driven_of(const double *w, const double *q, double *u, double *uq);
typedef void undriven_of(const double *w, const double *q, double *u);

/* x and S, NX (1 + m) numbers, at the first row are overwritten; out gets NY rows of 1 + n numbers for each row, an
   output and its first n derivatives. w has nw numbers in a row, q has nq, and columns says which derivative each of
   them is, or -1. scratch holds as many numbers as spare says. */
long spare(long m, long nq) { return (3 * NX + NU + NY) * (1 + m) + NU * nq; }

void free_run(double *x, const double *w, const double *p, void *driven, void *undriven, const double *q,
              const long *columns, long nq, long nw, long rows, long m, long n, double h,
              long substeps, double *out, double *scratch)
{
    double y[NY], yx[NY * NX] = {0}, yu[NY * NU] = {0}, yp[NY * MP] = {0};
    double *u = scratch + 3 * NX * (1 + m), *slopes_of_y = u + NU * (1 + m), *uq = slopes_of_y + NY * (1 + m);
    long moving = 0;
    for (long j = 0; j < nq && m; j++) moving += columns[j] >= 0;
    memset(u, 0, (size_t)(NU * (1 + m)) * sizeof(double));
    memset(uq, 0, (size_t)(NU * nq) * sizeof(double));
    for (long k = 0; k < rows; k++) {
        if (moving) ((driven_of *)driven)(w + k * nw, q, u, uq);
        else ((undriven_of *)undriven)(w + k * nw, q, u);
        for (long j = 0; moving && j < nq; j++)
            for (int i = 0; columns[j] >= 0 && i < NU; i++) u[NU + i * m + columns[j]] = uq[i * nq + j];
        outputs(x, u, p, y, yx, yu, yp);
        along_outputs(yx, yu, yp, x + NX, u + NU, slopes_of_y, m);
        for (int i = 0; i < NY; i++, out += 1 + n) {
            *out = y[i];
            memcpy(out + 1, slopes_of_y + i * m, (size_t)n * sizeof(double));
        }
        if (k + 1 < rows)
            for (long s = 0; s < substeps; s++) step(x, u, p, h, m, scratch);
    }
}
