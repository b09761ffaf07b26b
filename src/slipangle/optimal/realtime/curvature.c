/* Curvature of the Lagrangian beyond squares of errors, as rows of errors that are zero, from the row CURVED on. */

#define NZ (NX + NU)

static const double *limit_of(const Work *s, int row, int *stage, int *which);

/* Rows r whose r r^T sum to a symmetric matrix, each times its turn, the sign of an eigenvalue; by Jacobi's rotations of
   what is not all zero. */
static void split(const double *M, double *rows, double *turn)
{
    int n = 0, at[NZ];
    double size = 0, m[NZ * NZ], e[NZ * NZ];
    for (int a = 0; a < NZ; a++) {
        double most = 0;
        for (int b = 0; b < NZ; b++)
            most = larger(most, fabs(M[a * NZ + b]));
        size = larger(size, most);
        turn[a] = 1;
        if (most > 0)
            at[n++] = a;
    }
    memset(rows, 0, sizeof(double) * NZ * NZ);
    for (int a = 0; a < n; a++)
        for (int b = 0; b < n; b++)
            m[a * n + b] = M[at[a] * NZ + at[b]], e[a * n + b] = a == b;
    for (int sweep = 0; sweep < 40; sweep++) {
        double off = 0;
        for (int a = 0; a < n; a++)
            for (int b = a + 1; b < n; b++)
                off = larger(off, fabs(m[a * n + b]));
        if (!(off > 1e-15 * size))
            break;
        for (int a = 0; a < n; a++)
            for (int b = a + 1; b < n; b++) {
                double *p = m + a * n, *q = m + b * n, *v = e + a * n, *w = e + b * n, x = p[b];
                if (x == 0)
                    continue;
                double half = 0.5 * (q[b] - p[a]) / x;
                double t = (half >= 0 ? 1 : -1) / (fabs(half) + sqrt(half * half + 1));
                double c = 1 / sqrt(t * t + 1), d = t * c, first = p[a] - t * x, second = q[b] + t * x;
                for (int k = 0; k < n; k++) {
                    double one = p[k], two = q[k], of = v[k], to = w[k];
                    p[k] = c * one - d * two, q[k] = d * one + c * two;
                    v[k] = c * of - d * to, w[k] = d * of + c * to;
                }
                p[a] = first, q[b] = second, p[b] = q[a] = 0;
                for (int k = 0; k < n; k++)
                    m[k * n + a] = p[k], m[k * n + b] = q[k];
            }
    }
    for (int a = 0; a < n; a++) {
        double value = m[a * n + a], by = sqrt(fabs(value));
        turn[at[a]] = value < -1e-12 * size ? -1 : 1;
        for (int k = 0; k < n; k++)
            rows[at[a] * NZ + at[k]] = by * e[a * n + k];
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
    Scratch *c = &s->scratch;
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
        gather(c->x, s->x, NX, first, LANES, N);
        gather(c->u, s->u, NU, first, LANES, N - 1);
        gather(c->w, s->w, NW, first, LANES, N);
        gather(c->p, s->p, NP, first, LANES, N);
        gather(c->pi, of_x, NX, first, LANES, N);
        gather(c->mu, of_l, NL, first, LANES, N);
        gather(c->nu, of_e, NE, first, LANES, N);
        curvature(c->x, c->u, c->w, c->p, c->pi, c->mu, c->nu, c->M);
        for (int lane = 0; lane < LANES && first + lane <= N; lane++) {
            double m[NZ * NZ], rows[NZ * NZ];
            for (int a = 0; a < NZ * NZ; a++)
                m[a] = v_lane(c->M[a], lane);
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
