/* Curvature of the Lagrangian beyond squares of errors, as rows of errors that are zero, from the row CURVED on. */

#define NZ (NX + NU)

static const double *limit_of(const Work *s, int row, int *stage, int *which);

/* Rows r whose r r^T sum to a symmetric matrix, each times its turn, the sign of an eigenvalue; by Jacobi's rotations,
   which leave the matrix diagonal. */
static void split(double *M, double *rows, double *turn)
{
    double size = 0;
    for (int a = 0; a < NZ * NZ; a++) {
        rows[a] = a % (NZ + 1) == 0;
        size = larger(size, fabs(M[a]));
    }
    for (int sweep = 0; sweep < 40; sweep++) {
        double off = 0;
        for (int a = 0; a < NZ; a++)
            for (int b = a + 1; b < NZ; b++)
                off = larger(off, fabs(M[a * NZ + b]));
        if (!(off > 1e-15 * size))
            break;
        for (int a = 0; a < NZ; a++)
            for (int b = a + 1; b < NZ; b++) {
                double m = M[a * NZ + b];
                if (m == 0)
                    continue;
                double half = 0.5 * (M[b * NZ + b] - M[a * NZ + a]) / m;
                double t = (half >= 0 ? 1 : -1) / (fabs(half) + sqrt(half * half + 1));
                double c = 1 / sqrt(t * t + 1), d = t * c;
                for (int k = 0; k < NZ; k++) {
                    double p = M[a * NZ + k], q = M[b * NZ + k];
                    M[a * NZ + k] = c * p - d * q, M[b * NZ + k] = d * p + c * q;
                }
                for (int k = 0; k < NZ; k++) {
                    double p = M[k * NZ + a], q = M[k * NZ + b];
                    M[k * NZ + a] = c * p - d * q, M[k * NZ + b] = d * p + c * q;
                }
                for (int k = 0; k < NZ; k++) {
                    double p = rows[a * NZ + k], q = rows[b * NZ + k];
                    rows[a * NZ + k] = c * p - d * q, rows[b * NZ + k] = d * p + c * q;
                }
            }
    }
    for (int a = 0; a < NZ; a++) {
        double by = sqrt(fabs(M[a * NZ + a]));
        turn[a] = M[a * NZ + a] < -1e-12 * size ? -1 : 1;
        for (int k = 0; k < NZ; k++)
            rows[a * NZ + k] *= by;
    }
}

/* Price of a soft limit that is reached or exceeded, on one side: what its multiplier is beyond it. */
static double price_now(const Work *s, int row, int *i, int *k)
{
    const double *b = limit_of(s, row, i, k);
    double v = s->l[*i * NL + *k], above = v - b[1], below = b[0] - v;
    if ((above < 0 && below < 0) || (above >= 0 && below >= 0) || !(s->plain[row] < INFINITY))
        return 0;
    return above >= 0 ? s->plain[row] + s->square[row] * above : -s->plain[row] - s->square[row] * below;
}

/* Whether the rows of negative curvature count. */
static void count_negative(Work *s, int count)
{
    for (int i = 0; i <= N; i++)
        for (int r = 0; r < NZ; r++)
            s->q[i * NE + CURVED + r] = count ? s->turn[i * NZ + r] : larger(s->turn[i * NZ + r], 0);
}

static int has_negative(const Work *s)
{
    for (int i = 0; i < (N + 1) * NZ; i++)
        if (s->turn[i] < 0)
            return 1;
    return 0;
}

/* With the multipliers of the last quadratic program, in the derivatives of all nodes; before there are some, with the
   prices of limits that are exceeded. */
static void curve(Work *s)
{
    double of_l[M1((N + 1) * NL)] = {0}, of_e[(N + 1) * NE], of_x[(N + 1) * NX] = {0};
    if (s->curved)
        memcpy(of_x, s->pi + NX, sizeof(double) * N * NX);
#if JUMPS > 0
    for (int j = 0; j < JUMPS; j++)
        memset(of_x + JUMP[j] * NX, 0, sizeof(double) * NX);
#endif
    for (int i = 0; i < (N + 1) * NE; i++)
        of_e[i] = s->q[i] * s->e[i];
    for (int row = 0; row < N_LIMITS; row++) {
        int i, k;
        double price = price_now(s, row, &i, &k);
        of_l[i * NL + k] = s->curved ? s->qp.lambda[QN + QR + row] : price;
    }
    for (int first = 0; first <= N; first += LANES) {
        V x[NX], u[NU], w[M1(NW)], p[M1(NP)], pi[NX], mu[M1(NL)], nu[NE], M[NZ * NZ] = {{0}};
        gather(x, s->x, NX, first, LANES, N);
        gather(u, s->u, NU, first, LANES, N - 1);
        gather(w, s->w, NW, first, LANES, N);
        gather(p, s->p, NP, first, LANES, N);
        gather(pi, of_x, NX, first, LANES, N);
        gather(mu, of_l, NL, first, LANES, N);
        gather(nu, of_e, NE, first, LANES, N);
        curvature(x, u, w, p, pi, mu, nu, M);
        for (int lane = 0; lane < LANES && first + lane <= N; lane++) {
            double m[NZ * NZ], rows[NZ * NZ];
            for (int a = 0; a < NZ * NZ; a++)
                m[a] = v_lane(M[a], lane);
            split(m, rows, s->turn + (first + lane) * NZ);
            for (int r = 0; r < NZ; r++) {
                int at = (first + lane) * NE + CURVED + r;
                memcpy(s->E + at * NX, rows + r * NZ, sizeof(double) * NX);
                memcpy(s->D + at * NU, rows + r * NZ + NX, sizeof(double) * NU);
            }
        }
    }
    count_negative(s, 0);
}
