/* Free run of x(k+1) = f(x, u, p), y = g(x, u, p) with derivatives; f, g and NX, NU, NP, NY, M stand before this.
   S holds d x / d (p, x0), row after row: M = NP + number of free initial states. */
#include <string.h>

void plain_run(const double *start, const double *inputs, const double *p, long n, double *out)
{
    double x[NX], next[NX];
    memcpy(x, start, sizeof x);
    for (long k = 0; k < n; k++) {
        plain_output(x, inputs + k * NU, p, out + k * NY);
        plain_step(x, inputs + k * NU, p, next);
        memcpy(x, next, sizeof x);
    }
}

static void times(const double *by_x, const double *S, const double *by_p, int rows, double *out)
{
    for (int i = 0; i < rows; i++) {
        double *row = out + i * M;
        memcpy(row, by_p + i * NP, NP * sizeof(double));
        memset(row + NP, 0, (M - NP) * sizeof(double));
        for (int j = 0; j < NX; j++) {
            const double share = by_x[i * NX + j];
            if (share != 0.0)
                for (int c = 0; c < M; c++)
                    row[c] += share * S[j * M + c];
        }
    }
}

void sensitive_run(const double *start, const double *slope, const double *inputs, const double *p, long n,
                   double *out, double *by_all)
{
    double x[NX], next[NX], S[NX * M], S_next[NX * M];
    double f_x[NX * NX], f_p[NX * NP], g_x[NY * NX], g_p[NY * NP];
    memcpy(x, start, sizeof x);
    memcpy(S, slope, sizeof S);
    for (long k = 0; k < n; k++) {
        const double *u = inputs + k * NU;
        sloped_output(x, u, p, out + k * NY, g_x, g_p);
        times(g_x, S, g_p, NY, by_all + k * NY * M);
        sloped_step(x, u, p, next, f_x, f_p);
        times(f_x, S, f_p, NX, S_next);
        memcpy(x, next, sizeof x);
        memcpy(S, S_next, sizeof S);
    }
}
