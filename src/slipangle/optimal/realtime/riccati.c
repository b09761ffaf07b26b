/* Riccati factor and sweeps of the quadratic program by stages: curvature, gradient and response by the inputs, in time
   proportional to the horizon.

   Rao, Wright, Rawlings, J. Optim. Theory Appl. 99, 1998. */

#define RZ (NX + NV) /* the state and, where its change counts (NV = NU), the input before */
#define RZV ((RZ + LANES - 1) / LANES)
#define RZL (RZV * LANES)

#if NS == N
#define STAGE_A(i) (s->A + (i) * NX * NX)
#define STAGE_B(i) (s->B + (i) * NX * NU)
#define join_steps(s)
#else
#define STAGE_A(i) (s->stages.A + (i) * NX * NX)
#define STAGE_B(i) (s->stages.B + (i) * NX * NU)

/* Steps of a stage made into one. */
static void join_steps(Work *s)
{
    for (int i = 0; i < N; i++) {
        double *A = s->stages.A + i * NX * NX, *B = s->stages.B + i * NX * NU, a[NX * NX], b[NX * NU];
        memcpy(A, s->A + NODE(i) * NX * NX, sizeof a);
        memcpy(B, s->B + NODE(i) * NX * NU, sizeof b);
        for (int m = NODE(i) + 1; m < NODE(i + 1); m++) {
            const double *to = s->A + m * NX * NX;
            memset(a, 0, sizeof a);
            memcpy(b, s->B + m * NX * NU, sizeof b);
            for (int r = 0; r < NX; r++)
                for (int k = A_FIRST[r]; k < A_FIRST[r + 1]; k++) {
                    add(a + r * NX, to[r * NX + A_AT[k]], A + A_AT[k] * NX, NX);
                    add(b + r * NU, to[r * NX + A_AT[k]], B + A_AT[k] * NU, NU);
                }
            memcpy(A, a, sizeof a);
            memcpy(B, b, sizeof b);
        }
    }
}
#endif

/* ---- factor --------------------------------------------------------------------------------------------------- */

/* A quantity with derivatives x (where `at` says) and u, times a weight, into the curvature by the state, by the input
   and between them; at the end the input is the one before. */
INLINE void add_quantity(double *H, double *S, double *R, double weight, const double *x, const int *at, int count,
                         const double *u, int end)
{
    for (int b = 0; b < count; b++)
        for (int c = 0; c < count; c++)
            H[at[b] * RZL + at[c]] += weight * x[at[b]] * x[at[c]];
    for (int j = 0; u && j < NU; j++) {
        double w = weight * SCALE[j] * u[j];
        if (end) {
            for (int b = 0; b < count; b++) {
                H[(NX + j) % RZ * RZL + at[b]] += w * x[at[b]];
                H[at[b] * RZL + (NX + j) % RZ] += w * x[at[b]];
            }
            for (int k = 0; k < NU; k++)
                H[(NX + j) % RZ * RZL + (NX + k) % RZ] += w * SCALE[k] * u[k];
            continue;
        }
        for (int b = 0; b < count; b++)
            S[j * RZL + at[b]] += w * x[at[b]];
        for (int k = 0; k < NU; k++)
            R[j * NU + k] += w * SCALE[k] * u[k];
    }
}

/* Curvature of stage i, its held rows included. */
static void add_stage(const Work *s, int i, double *H, double *S, double *R)
{
    const double *slope = s->stages.slope;
    for (int k = 0; k < NE; k++)
        if (s->q[i * NE + k] > 0)
            add_quantity(H, S, R, s->q[i * NE + k], s->E + (i * NE + k) * NX, E_AT + E_FIRST[k], E_FIRST[k + 1] - E_FIRST[k],
                         E_INPUT[k] ? s->D + (i * NE + k) * NU : NULL, i == N);
    for (int row = s->stages.first[i]; row < s->stages.first[i + 1]; row++) {
        int k = LIMIT_WHICH[row];
        if (slope[QN + QR + row] > 0)
            add_quantity(H, S, R, slope[QN + QR + row], s->LX + (i * NL + k) * NX, L_AT + L_FIRST[k],
                         L_FIRST[k + 1] - L_FIRST[k], L_INPUT[k] ? s->LU + (i * NL + k) * NU : NULL, i == N);
    }
    for (int j = 0; i < N && j < NU; j++) {
        int a = i * NU + j, rate = s->stages.rate[a];
        double c = SCALE[j] * SCALE[j], change = c * s->ws[a] + (rate < 0 ? 0 : slope[rate]);
        R[j * NU + j] += c * s->wr[a] + slope[a] + change;
#if NV > 0
        H[(NX + j) * RZL + NX + j] += change;
        S[j * RZL + NX + j] -= change;
#endif
    }
}

/* Backward recursion; 0 where the curvature is no number. `free` learns the size of the curvature by an input. */
static int factor_stages(Work *s, int free)
{
    V Pv[RZ * RZV], Hv[RZ * RZV], Mv[RZ * RZV], Av[NX * RZV];
    double *P = (double *)Pv, *H = (double *)Hv, *Ap = (double *)Av, PB[RZ * NU], top = s->stages.top;
    memset(Pv, 0, sizeof Pv);
    memset(Av, 0, sizeof Av);
    add_stage(s, N, P, NULL, NULL);
    for (int i = N - 1; i >= 0; i--) {
        const double *A = STAGE_A(i), *B = STAGE_B(i);
        V *Sv = s->stages.S + i * NU * RZV;
        double *S = (double *)Sv, *R = s->stages.R + i * NU * NU;
        for (int a = 0; a < NX; a++)
            memcpy(Ap + a * RZL, A + a * NX, sizeof(double) * NX);
        for (int a = 0; a < RZ; a++) {
            double sum[NU];
            V row[RZV];
            for (int j = 0; j < NU; j++)
                sum[j] = NV ? P[a * RZL + (NX + j) % RZ] : 0;
            memset(row, 0, sizeof row);
            for (int c = 0; c < NX; c++) {
                for (int j = 0; j < NU; j++)
                    sum[j] += P[a * RZL + c] * SCALE[j] * B[c * NU + j];
                for (int b = 0; b < RZV; b++)
                    row[b] += P[a * RZL + c] * Av[c * RZV + b];
            }
            memcpy(PB + a * NU, sum, sizeof sum);
            memcpy(Mv + a * RZV, row, sizeof row);
        }
        for (int j = 0; j < NU; j++) {
            V row[RZV];
            for (int b = 0; b < RZV; b++)
                row[b] = NV ? Mv[(NX + j) % RZ * RZV + b] : v_all(0.0);
            for (int k = 0; k < NU; k++)
                R[j * NU + k] = NV ? PB[(NX + j) % RZ * NU + k] : 0;
            for (int c = 0; c < NX; c++) {
                double w = SCALE[j] * B[c * NU + j];
                for (int b = 0; b < RZV; b++)
                    row[b] += w * Mv[c * RZV + b];
                for (int k = 0; k < NU; k++)
                    R[j * NU + k] += w * PB[c * NU + k];
            }
            memcpy(Sv + j * RZV, row, sizeof row);
        }
        memset(Hv, 0, sizeof Hv);
        for (int a = 0; a < NX; a++) {
            V row[RZV];
            int from = a / LANES;
            memset(row, 0, sizeof row);
            for (int c = 0; c < NX; c++)
                for (int b = from; b < RZV; b++)
                    row[b] += Ap[c * RZL + a] * Mv[c * RZV + b];
            memcpy(Hv + a * RZV, row, sizeof row);
        }
        add_stage(s, i, H, S, R);
        for (int j = 0; free && j < NU; j++)
            top = larger(R[j * NU + j], top);
        for (int j = 0; j < NU; j++) {
            double d = R[j * NU + j] + 1e-12 * top;
            if (!(d > 0 && d < INFINITY))
                return 0;
            double inverse = 1 / sqrt(d);
            for (int k = j + 1; k < NU; k++)
                R[j * NU + k] *= inverse;
            for (int b = 0; b < RZV; b++)
                Sv[j * RZV + b] *= inverse;
            R[j * NU + j] = inverse;
            for (int k = j + 1; k < NU; k++) {
                double w = R[j * NU + k];
                for (int m = k; m < NU; m++)
                    R[k * NU + m] -= w * R[j * NU + m];
                for (int b = 0; b < RZV; b++)
                    Sv[k * RZV + b] -= w * Sv[j * RZV + b];
            }
        }
        for (int a = 0; a < RZ; a++) {
            V row[RZV];
            int from = a / LANES;
            for (int b = from; b < RZV; b++)
                row[b] = Hv[a * RZV + b];
            for (int j = 0; j < NU; j++)
                for (int b = from; b < RZV; b++)
                    row[b] -= S[j * RZL + a] * Sv[j * RZV + b];
            for (int b = from; b < RZV; b++)
                Pv[a * RZV + b] = row[b];
        }
        for (int a = 0; a < RZ; a++)
            for (int c = 0; c < a; c++)
                P[a * RZL + c] = P[c * RZL + a];
    }
    s->stages.top = top;
    return 1;
}

/* ---- sweeps --------------------------------------------------------------------------------------------------- */

/* States and quantities that scaled inputs lead to from zero: of all rows, and of errors. */
static void respond(const Work *s, const double *v, double *x, double *e, double *rows)
{
    const Qp *q = &s->qp;
    memset(x, 0, sizeof(double) * NX);
    for (int i = 0; i < N; i++) {
        const double *A = STAGE_A(i), *B = STAGE_B(i), *from = x + i * NX;
        double *to = x + (i + 1) * NX;
        for (int a = 0; a < NX; a++) {
            double sum = 0;
            if (NS == N)
                for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                    sum += A[a * NX + A_AT[c]] * from[A_AT[c]];
            else
                for (int c = 0; c < NX; c++)
                    sum += A[a * NX + c] * from[c];
            for (int j = 0; j < NU; j++)
                sum += B[a * NU + j] * SCALE[j] * v[i * NU + j];
            to[a] = sum;
        }
    }
    for (int i = 0; i <= N; i++) {
        const double *at = x + i * NX, *in = v + (i < N ? i : N - 1) * NU;
        for (int k = 0; k < NE; k++) {
            const double *ex = s->E + (i * NE + k) * NX, *eu = s->D + (i * NE + k) * NU;
            double sum = 0;
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                sum += ex[E_AT[c]] * at[E_AT[c]];
            for (int j = 0; E_INPUT[k] && j < NU; j++)
                sum += eu[j] * SCALE[j] * in[j];
            e[i * NE + k] = sum;
        }
        for (int row = s->stages.first[i]; row < s->stages.first[i + 1]; row++) {
            int k = LIMIT_WHICH[row];
            const double *lx = s->LX + (i * NL + k) * NX, *lu = s->LU + (i * NL + k) * NU;
            double sum = 0;
            for (int c = L_FIRST[k]; c < L_FIRST[k + 1]; c++)
                sum += lx[L_AT[c]] * at[L_AT[c]];
            for (int j = 0; L_INPUT[k] && j < NU; j++)
                sum += lu[j] * SCALE[j] * in[j];
            rows[QN + QR + row] = sum;
        }
    }
    memcpy(rows, v, sizeof(double) * QN);
    for (int k = 0; k < QR; k++)
        rows[QN + k] = v[q->after[k]] - (q->before[k] < 0 ? 0 : v[q->before[k]]);
}

/* What the curvature of the cost, and the multipliers of the rows, add to the gradient by the inputs. */
static void pull(const Work *s, const double *v, const double *e, const double *price, double *bent, double *forced)
{
    const Qp *q = &s->qp;
    double after[2 * NX] = {0}, before[2 * NX];
    memset(bent, 0, sizeof(double) * QN);
    memset(forced, 0, sizeof(double) * QN);
    for (int i = N; i >= 0; i--) {
        int at = i < N ? i : N - 1;
        memset(before, 0, sizeof before);
        if (i < N) {
            const double *A = STAGE_A(i), *B = STAGE_B(i);
            carry_back(A, after, before);
            carry_back(A, after + NX, before + NX);
            for (int a = 0; a < NX; a++)
                for (int j = 0; j < NU; j++) {
                    bent[i * NU + j] += SCALE[j] * B[a * NU + j] * after[a];
                    forced[i * NU + j] += SCALE[j] * B[a * NU + j] * after[NX + a];
                }
        }
        for (int k = 0; k < NE; k++) {
            const double *ex = s->E + (i * NE + k) * NX, *eu = s->D + (i * NE + k) * NU;
            double w = s->q[i * NE + k] * e[i * NE + k];
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                before[E_AT[c]] += ex[E_AT[c]] * w;
            for (int j = 0; E_INPUT[k] && j < NU; j++)
                bent[at * NU + j] += SCALE[j] * eu[j] * w;
        }
        for (int row = s->stages.first[i]; row < s->stages.first[i + 1]; row++) {
            int k = LIMIT_WHICH[row];
            const double *lx = s->LX + (i * NL + k) * NX, *lu = s->LU + (i * NL + k) * NU;
            double w = price[QN + QR + row];
            if (w == 0)
                continue;
            for (int c = L_FIRST[k]; c < L_FIRST[k + 1]; c++)
                before[NX + L_AT[c]] += lx[L_AT[c]] * w;
            for (int j = 0; L_INPUT[k] && j < NU; j++)
                forced[at * NU + j] += SCALE[j] * lu[j] * w;
        }
        memcpy(after, before, sizeof after);
    }
    for (int a = 0; a < QN; a++) {
        double c = SCALE[a % NU] * SCALE[a % NU], change = c * s->ws[a] * (v[a] - (a < NU ? 0 : v[a - NU]));
        bent[a] += c * s->wr[a] * v[a] + change;
        if (a >= NU)
            bent[a - NU] -= change;
        forced[a] += price[a];
    }
    for (int k = 0; k < QR; k++) {
        forced[q->after[k]] += price[QN + k];
        if (q->before[k] >= 0)
            forced[q->before[k]] -= price[QN + k];
    }
}

/* The Newton step v for the gradient r by the inputs. */
static void solve_stages(const Work *s, const double *r, double *v)
{
    V tail[RZV] = {0}, z[RZV] = {0};
    double *p = (double *)tail, *x = (double *)z, back[NX];
    for (int i = N - 1; i >= 0; i--) {
        const double *A = STAGE_A(i), *B = STAGE_B(i), *R = s->stages.R + i * NU * NU;
        const V *S = s->stages.S + i * NU * RZV;
        double *y = v + i * NU;
        for (int j = 0; j < NU; j++) {
            double sum = r[i * NU + j] + (NV ? p[(NX + j) % RZ] : 0);
            for (int a = 0; a < NX; a++)
                sum += SCALE[j] * B[a * NU + j] * p[a];
            y[j] = sum;
        }
        for (int j = 0; j < NU; j++) {
            y[j] *= R[j * NU + j];
            for (int k = j + 1; k < NU; k++)
                y[k] -= R[j * NU + k] * y[j];
        }
        memset(back, 0, sizeof back);
        carry_back(A, p, back);
        memset(tail, 0, sizeof tail);
        memcpy(p, back, sizeof back);
        for (int j = 0; j < NU; j++)
            for (int b = 0; b < RZV; b++)
                tail[b] -= y[j] * S[j * RZV + b];
    }
    for (int i = 0; i < N; i++) {
        const double *A = STAGE_A(i), *B = STAGE_B(i), *R = s->stages.R + i * NU * NU;
        const double *S = (const double *)(s->stages.S + i * NU * RZV);
        double *y = v + i * NU, next[NX];
        for (int j = NU - 1; j >= 0; j--) {
            double sum = -y[j] - dot(S + j * RZL, x, RZL);
            for (int k = j + 1; k < NU; k++)
                sum -= R[j * NU + k] * y[k];
            y[j] = sum * R[j * NU + j];
        }
        for (int a = 0; a < NX; a++) {
            double sum = 0;
            if (NS == N)
                for (int c = A_FIRST[a]; c < A_FIRST[a + 1]; c++)
                    sum += A[a * NX + A_AT[c]] * x[A_AT[c]];
            else
                for (int c = 0; c < NX; c++)
                    sum += A[a * NX + c] * x[c];
            for (int j = 0; j < NU; j++)
                sum += B[a * NU + j] * SCALE[j] * y[j];
            next[a] = sum;
        }
        memcpy(x, next, sizeof next);
        for (int j = 0; j < NV; j++)
            x[(NX + j) % RZ] = y[j];
    }
}
