/* Linear algebra of `interior.py`: an interval's 14 stage values follow from its first state and inputs, and a Riccati
   recursion over the intervals leaves the first state and the multipliers of the lap's closing to the caller.

   An interval has w = (a, b), 7 states each, and 2 inputs u; v = (w, u). Its linearised collocation is
   E w + G u = J x - c, where x is b of the interval before and J x is x twice. Per interval its cost is
   v' H v / 2 + g' v. Parameters of the value function are theta, the first state, and nu, the multipliers. */
#include <math.h>
#include <string.h>

enum { X = 7, W = 14, U = 2, Y = 9, N = 16, P = 14 };

typedef struct {
    double lu[W * W], M[N * Y], Q[Y * Y], V[X * X], S[X * P], FV[X * Y], gain[U * (X + P)], inverse[3];
    int order[W];
} Interval; /* M: v by (x, u); V, S: value after it by b and parameters */

typedef struct {
    double m[N], p[X], u0[U];
} Shift;

long lap_interval_bytes(void) { return (long)sizeof(Interval); }
long lap_shift_bytes(void) { return (long)sizeof(Shift); }

static int decompose(double *A, int *order)
{
    for (int k = 0; k < W; k++) {
        int best = k;
        for (int i = k + 1; i < W; i++)
            if (fabs(A[i * W + k]) > fabs(A[best * W + k]))
                best = i;
        order[k] = best;
        if (!(fabs(A[best * W + k]) > 1e-14))
            return 0;
        if (best != k)
            for (int j = 0; j < W; j++) {
                double t = A[k * W + j];
                A[k * W + j] = A[best * W + j];
                A[best * W + j] = t;
            }
        double one = 1.0 / A[k * W + k];
        for (int i = k + 1; i < W; i++) {
            double f = A[i * W + k] *= one;
            if (f != 0.0)
                for (int j = k + 1; j < W; j++)
                    A[i * W + j] -= f * A[k * W + j];
        }
    }
    return 1;
}

/* B (W rows of n) := inverse of A times B */
static void solve(const double *A, const int *order, double *B, int n)
{
    for (int k = 0; k < W; k++)
        if (order[k] != k)
            for (int j = 0; j < n; j++) {
                double t = B[k * n + j];
                B[k * n + j] = B[order[k] * n + j];
                B[order[k] * n + j] = t;
            }
    for (int i = 1; i < W; i++)
        for (int k = 0; k < i; k++)
            for (int j = 0; j < n; j++)
                B[i * n + j] -= A[i * W + k] * B[k * n + j];
    for (int i = W - 1; i >= 0; i--) {
        for (int k = i + 1; k < W; k++)
            for (int j = 0; j < n; j++)
                B[i * n + j] -= A[i * W + k] * B[k * n + j];
        double one = 1.0 / A[i * W + i];
        for (int j = 0; j < n; j++)
            B[i * n + j] *= one;
    }
}

static void solve_transposed(const double *A, const int *order, double *b)
{
    for (int i = 0; i < W; i++) {
        for (int k = 0; k < i; k++)
            b[i] -= A[k * W + i] * b[k];
        b[i] /= A[i * W + i];
    }
    for (int i = W - 1; i >= 0; i--)
        for (int k = i + 1; k < W; k++)
            b[i] -= A[k * W + i] * b[k];
    for (int k = W - 1; k >= 0; k--)
        if (order[k] != k) {
            double t = b[k];
            b[k] = b[order[k]];
            b[order[k]] = t;
        }
}

/* The intervals' matrices. E: W x W each, G: W x U, H: N x N. V0, S0, K0: value before the first interval, by x, by the
   parameters. 1 where every input is bounded below, else 0. */
long lap_factor(long count, long closed, double penalty, const double *E, const double *G, const double *H, void *work,
                double *V0, double *S0, double *K0)
{
    Interval *all = work;
    double V[X * X] = {0}, S[X * P] = {0}, K[P * P] = {0};
    if (closed)
        for (int i = 0; i < X; i++) {
            V[i * X + i] = K[i * P + i] = penalty;
            S[i * P + i] = -penalty;
            S[i * P + X + i] = 1.0;
            K[i * P + X + i] = K[(X + i) * P + i] = -1.0;
        }
    for (long n = count - 1; n >= 0; n--) {
        Interval *at = all + n;
        const double *h = H + n * N * N;
        memcpy(at->lu, E + n * W * W, sizeof at->lu);
        if (!decompose(at->lu, at->order))
            return 0;
        double M[N * Y] = {0};
        for (int i = 0; i < X; i++)
            M[i * Y + i] = M[(X + i) * Y + i] = 1.0;
        for (int i = 0; i < W; i++)
            for (int j = 0; j < U; j++)
                M[i * Y + X + j] = -G[n * W * U + i * U + j];
        solve(at->lu, at->order, M, Y);
        for (int j = 0; j < U; j++)
            M[(W + j) * Y + X + j] = 1.0;
        memcpy(at->M, M, sizeof M);
        double HM[N * Y];
        for (int i = 0; i < N; i++) {
            double row[Y] = {0};
            for (int k = 0; k < N; k++) {
                double f = h[i * N + k];
                if (f != 0.0)
                    for (int j = 0; j < Y; j++)
                        row[j] += f * M[k * Y + j];
            }
            memcpy(HM + i * Y, row, sizeof row);
        }
        double Q[Y * Y] = {0};
        for (int k = 0; k < N; k++)
            for (int i = 0; i < Y; i++)
                for (int j = 0; j < Y; j++)
                    Q[i * Y + j] += M[k * Y + i] * HM[k * Y + j];
        const double *F = M + X * Y;
        memcpy(at->V, V, sizeof V);
        memcpy(at->S, S, sizeof S);
        for (int i = 0; i < X; i++)
            for (int j = 0; j < Y; j++) {
                double sum = 0.0;
                for (int k = 0; k < X; k++)
                    sum += V[i * X + k] * F[k * Y + j];
                at->FV[i * Y + j] = sum;
            }
        for (int k = 0; k < X; k++)
            for (int i = 0; i < Y; i++)
                for (int j = 0; j < Y; j++)
                    Q[i * Y + j] += F[k * Y + i] * at->FV[k * Y + j];
        double R[Y * P] = {0};
        if (closed)
            for (int k = 0; k < X; k++)
                for (int i = 0; i < Y; i++)
                    for (int j = 0; j < P; j++)
                        R[i * P + j] += F[k * Y + i] * S[k * P + j];
        memcpy(at->Q, Q, sizeof Q);
        double a = Q[X * Y + X], b = 0.5 * (Q[X * Y + X + 1] + Q[(X + 1) * Y + X]), d = Q[(X + 1) * Y + X + 1];
        double det = a * d - b * b;
        if (!(a > 0.0 && det > 1e-14 * a * d && isfinite(det)))
            return 0;
        at->inverse[0] = d / det, at->inverse[1] = -b / det, at->inverse[2] = a / det;
        for (int j = 0; j < X + P; j++) {
            double q0 = j < X ? Q[X * Y + j] : R[X * P + j - X], q1 = j < X ? Q[(X + 1) * Y + j] : R[(X + 1) * P + j - X];
            at->gain[j] = -(at->inverse[0] * q0 + at->inverse[1] * q1);
            at->gain[X + P + j] = -(at->inverse[1] * q0 + at->inverse[2] * q1);
        }
        for (int i = 0; i < X; i++) {
            for (int j = 0; j < X; j++)
                V[i * X + j] = Q[i * Y + j] + Q[i * Y + X] * at->gain[j] + Q[i * Y + X + 1] * at->gain[X + P + j];
            for (int j = 0; j < P; j++)
                S[i * P + j] = R[i * P + j] + Q[i * Y + X] * at->gain[X + j] + Q[i * Y + X + 1] * at->gain[2 * X + P + j];
        }
        for (int i = 0; i < X; i++)
            for (int j = 0; j < i; j++)
                V[i * X + j] = V[j * X + i] = 0.5 * (V[i * X + j] + V[j * X + i]);
        if (closed)
            for (int i = 0; i < P; i++)
                for (int j = 0; j < P; j++)
                    K[i * P + j] += R[X * P + i] * at->gain[X + j] + R[(X + 1) * P + i] * at->gain[2 * X + P + j];
    }
    memcpy(V0, V, sizeof V);
    memcpy(S0, S, sizeof S);
    memcpy(K0, K, sizeof K);
    return 1;
}

/* Linear parts: of the value before the first interval by x (p0) and by the parameters (k0). */
void lap_backward(long count, const double *H, const double *c, const double *g, const void *work, void *shifts,
                  double *p0, double *k0)
{
    const Interval *all = work;
    double p[X] = {0}, k0_[P] = {0};
    for (long n = count - 1; n >= 0; n--) {
        const Interval *at = all + n;
        Shift *to = (Shift *)shifts + n;
        const double *h = H + n * N * N, *F = at->M + X * Y, *f = to->m + X;
        for (int i = 0; i < W; i++)
            to->m[i] = -c[n * W + i];
        to->m[W] = to->m[W + 1] = 0.0;
        solve(at->lu, at->order, to->m, 1);
        memcpy(to->p, p, sizeof p);
        double q[Y] = {0}, after[X];
        for (int i = 0; i < N; i++) {
            double sum = g[n * N + i];
            for (int k = 0; k < W; k++)
                sum += h[i * N + k] * to->m[k];
            for (int j = 0; j < Y; j++)
                q[j] += at->M[i * Y + j] * sum;
        }
        for (int i = 0; i < X; i++) {
            after[i] = p[i];
            for (int k = 0; k < X; k++)
                after[i] += at->V[i * X + k] * f[k];
        }
        for (int k = 0; k < X; k++)
            for (int j = 0; j < Y; j++)
                q[j] += F[k * Y + j] * after[k];
        for (int j = 0; j < P; j++) {
            for (int i = 0; i < X; i++)
                k0_[j] += at->S[i * P + j] * f[i];
            k0_[j] += at->gain[X + j] * q[X] + at->gain[2 * X + P + j] * q[X + 1];
        }
        to->u0[0] = -(at->inverse[0] * q[X] + at->inverse[1] * q[X + 1]);
        to->u0[1] = -(at->inverse[1] * q[X] + at->inverse[2] * q[X + 1]);
        for (int i = 0; i < X; i++)
            p[i] = q[i] + at->gain[i] * q[X] + at->gain[X + P + i] * q[X + 1];
    }
    memcpy(p0, p, sizeof p);
    memcpy(k0, k0_, sizeof k0_);
}

/* The step v of every interval and its multipliers, from the first state and the parameters. */
void lap_forward(long count, const double *H, const double *g, const double *first, const double *parameters,
                 const void *work, const void *shifts, double *v, double *multipliers)
{
    const Interval *all = work;
    double x[X];
    memcpy(x, first, sizeof x);
    for (long n = 0; n < count; n++) {
        const Interval *at = all + n;
        const Shift *by = (const Shift *)shifts + n;
        const double *h = H + n * N * N;
        double y[Y], *to = v + n * N, *out = multipliers + n * W;
        memcpy(y, x, sizeof x);
        for (int j = 0; j < U; j++) {
            const double *gain = at->gain + j * (X + P);
            y[X + j] = by->u0[j];
            for (int i = 0; i < X; i++)
                y[X + j] += gain[i] * x[i];
            for (int i = 0; i < P; i++)
                y[X + j] += gain[X + i] * parameters[i];
        }
        for (int i = 0; i < N; i++) {
            to[i] = by->m[i];
            for (int j = 0; j < Y; j++)
                to[i] += at->M[i * Y + j] * y[j];
        }
        memcpy(x, to + X, sizeof x);
        for (int i = 0; i < W; i++) {
            out[i] = -g[n * N + i];
            for (int k = 0; k < N; k++)
                out[i] -= h[i * N + k] * to[k];
        }
        for (int i = 0; i < X; i++) {
            double slope = by->p[i];
            for (int k = 0; k < X; k++)
                slope += at->V[i * X + k] * x[k];
            for (int k = 0; k < P; k++)
                slope += at->S[i * P + k] * parameters[k];
            out[X + i] -= slope;
        }
        solve_transposed(at->lu, at->order, out);
    }
}
