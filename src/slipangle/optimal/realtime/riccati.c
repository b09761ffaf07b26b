/* Riccati factor and sweeps of the quadratic program by stages: curvature, gradient and response by the inputs, in time
   proportional to the horizon.

   Rao, Wright, Rawlings, J. Optim. Theory Appl. 99, 1998.

   Rows of ZL numbers belong to the state and the scaled inputs of a stage; where the change of an input counts (NV = NU)
   the next stage finds in their place, behind its state, the inputs before. */

/* ---- packing -------------------------------------------------------------------------------------------------- */

/* Derivatives of the state after stage i by that before and by the inputs: of its steps, one after the other. */
static void stage_derivatives(const Work *s, int i, double *A, double *B)
{
    memcpy(A, s->A + NODE(i) * NX * NX, sizeof(double) * NX * NX);
    memcpy(B, s->B + NODE(i) * NX * NU, sizeof(double) * NX * NU);
    for (int m = NODE(i) + 1; m < NODE(i + 1); m++) {
        const double *to = s->A + m * NX * NX;
        double a[NX * NX] = {0}, b[NX * NU];
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

/* Rows of one quantity; derivatives by the state where `at` says, and by the inputs. */
INLINE void pack_quantity(V *row, const double *x, const int *at, int count, const double *u)
{
    double *to = (double *)row;
    for (int a = 0; a < ZL; a++)
        to[a] = 0;
    for (int b = 0; b < count; b++)
        to[at[b]] = x[at[b]];
    for (int j = 0; u && j < NU; j++)
        to[NX + j] = SCALE[j] * u[j];
}

static void pack_stages(Work *s)
{
    Stages *r = &s->stages;
    double *unit = (double *)r->unit;
    memset(r->Z, 0, sizeof r->Z);
    memset(r->T, 0, sizeof r->T);
    for (int a = 0; a < ZW; a++)
        unit[(a < NX ? NU : a - NX) * ZL + a] = 1;
    for (int i = 0; i < N; i++) {
        double A[NX * NX], B[NX * NU], *Z = (double *)(r->Z + AT(i * RZ)), *T = (double *)(r->T + AT(i * ZW));
        stage_derivatives(s, i, A, B);
        for (int a = 0; a < NX; a++) {
            for (int c = 0; c < NX; c++)
                Z[a * ZL + c] = T[c * ZL + a] = A[a * NX + c];
            for (int j = 0; j < NU; j++)
                Z[a * ZL + NX + j] = T[(NX + j) * ZL + a] = SCALE[j] * B[a * NU + j];
        }
        for (int j = 0; j < NV; j++)
            Z[(NX + j) % RZ * ZL + NX + j] = T[(NX + j) * ZL + NX + j] = 1;
    }
    for (int i = 0; i <= N; i++) {
        for (int k = 0; k < NE; k++)
            pack_quantity(r->E + AT(i * NE + k), s->E + (i * NE + k) * NX, E_AT + E_FIRST[k], E_FIRST[k + 1] - E_FIRST[k],
                          E_INPUT[k] ? s->D + (i * NE + k) * NU : NULL);
        for (int row = r->first[i]; row < r->first[i + 1]; row++) {
            int k = LIMIT_WHICH[row];
            pack_quantity(r->L + AT(row), s->LX + (i * NL + k) * NX, L_AT + L_FIRST[k], L_FIRST[k + 1] - L_FIRST[k],
                          L_INPUT[k] ? s->LU + (i * NL + k) * NU : NULL);
        }
    }
}

/* ---- factor --------------------------------------------------------------------------------------------------- */

/* The sum of rows times the entries of x, added to a row: in two sums, as one would wait for each of its products. */
INLINE void add_products(V *to, const double *x, int stride, const V *rows, int count)
{
    V other[ZV] = {0};
    int c = 0;
    for (; c + 1 < count; c += 2)
        for (int b = 0; b < ZV; b++) {
            to[b] += x[c * stride] * rows[AT(c) + b];
            other[b] += x[(c + 1) * stride] * rows[AT(c + 1) + b];
        }
    for (int b = 0; b < ZV; b++)
        to[b] += (c < count ? x[c * stride] : 0) * rows[AT(c < count ? c : 0) + b] + other[b];
}

/* A quantity, times a weight, into the curvature. */
INLINE void add_quantity(V *H, double weight, const V *row, const int *at, int count, int input)
{
    const double *x = (const double *)row;
    for (int b = 0; b < count; b++)
        for (int k = 0; k < ZV; k++)
            H[AT(at[b]) + k] += weight * x[at[b]] * row[k];
    for (int j = NX; input && j < ZW; j++)
        for (int k = 0; k < ZV; k++)
            H[AT(j) + k] += weight * x[j] * row[k];
}

/* Curvature of what is tracked in stage i and of its held rows. */
INLINE void add_stage(const Work *s, int i, V *H)
{
    const Stages *r = &s->stages;
    for (int k = 0; k < NE; k++)
        if (s->q[i * NE + k] != 0)
            add_quantity(H, s->q[i * NE + k], r->E + AT(i * NE + k), E_AT + E_FIRST[k], E_FIRST[k + 1] - E_FIRST[k], E_INPUT[k]);
    for (int row = r->first[i]; row < r->first[i + 1]; row++) {
        int k = LIMIT_WHICH[row];
        if (r->slope[QN + QR + row] > 0)
            add_quantity(H, r->slope[QN + QR + row], r->L + AT(row), L_AT + L_FIRST[k], L_FIRST[k + 1] - L_FIRST[k], L_INPUT[k]);
    }
}

/* Rows S and R of the inputs of a stage from its curvature H: those of the factor. The first input at which that is no
   number, or NU. */
INLINE int factor_inputs(const V *H, const double *own, const double *change, double top, const V *unit, V *S, double *R)
{
    const double *h = (const double *)H;
    for (int j = 0; j < NU; j++) {
        for (int k = 0; k < NU; k++)
            R[j * NU + k] = h[(NX + j) * ZL + NX + k];
        R[j * NU + j] += own[j];
        for (int b = 0; b < ZV; b++)
            S[AT(j) + b] = H[AT(NX + j) + b] * unit[AT(NU) + b] - (NV ? change[j] * unit[AT(j) + b] : v_all(0.0));
    }
    for (int j = 0; j < NU; j++) {
        double d = R[j * NU + j] + 1e-12 * top;
        if (!(d > 0 && d < INFINITY))
            return j;
        double inverse = 1 / sqrt(d);
        for (int k = j + 1; k < NU; k++)
            R[j * NU + k] *= inverse;
        for (int b = 0; b < ZV; b++)
            S[AT(j) + b] *= inverse;
        R[j * NU + j] = inverse;
        for (int k = j + 1; k < NU; k++) {
            double w = R[j * NU + k];
            for (int m = k; m < NU; m++)
                R[k * NU + m] -= w * R[j * NU + m];
            for (int b = 0; b < ZV; b++)
                S[AT(k) + b] -= w * S[AT(j) + b];
        }
    }
    return NU;
}

/* Backward recursion; 0 where the curvature is no number, and `fell` says at which input. `free` learns the size of the
   curvature by an input. */
static int factor_stages(Work *s, int free)
{
    Stages *r = &s->stages;
    V P[ZW * ZV] = {0}, W[ZW * ZV], H[ZW * ZV];
    const V *unit = r->unit;
    double top = r->top;
    add_stage(s, N, P);
    for (int i = N - 1; i >= 0; i--) {
        const V *Z = r->Z + AT(i * RZ);
        V *S = r->S + AT(i * NU);
        double own[NU], change[NU], *R = r->R + i * NU * NU;
        for (int a = 0; a < RZ; a++) {
            V row[ZV] = {0};
            add_products(row, (const double *)(P + AT(a)), 1, Z, RZ);
            memcpy(W + AT(a), row, sizeof row);
        }
        for (int a = 0; a < ZW; a++) {
            V row[ZV] = {0};
            add_products(row, (const double *)Z + a, ZL, W, RZ);
            memcpy(H + AT(a), row, sizeof row);
        }
        add_stage(s, i, H);
        for (int j = 0; j < NU; j++) {
            int a = i * NU + j, rate = r->rate[a];
            double c = SCALE[j] * SCALE[j];
            change[j] = c * s->ws[a] + (rate < 0 ? 0 : r->slope[rate]);
            own[j] = c * s->wr[a] + r->slope[a] + change[j];
            if (free) {
                double curve = ((const double *)H)[(NX + j) * ZL + NX + j] + own[j];
                r->damped[a] = s->damp * curve, top = larger(curve, top);
            } else
                own[j] += r->damped[a];
        }
        int good = factor_inputs(H, own, change, top, unit, S, R);
        if (good < NU) {
            r->fell = i * NU + good;
            return 0;
        }
        for (int a = 0; a < RZ; a++)
            for (int b = 0; b < ZV; b++) {
                V sum = a < NX ? H[AT(a) + b] * unit[AT(NU) + b] : change[(a - NX + NU) % NU] * unit[AT((a - NX + NU) % NU) + b];
                for (int j = 0; j < NU; j++)
                    sum -= ((const double *)S)[j * ZL + a] * S[AT(j) + b];
                P[AT(a) + b] = sum;
            }
        for (int a = 0; a < RZ; a++) /* or errors grow with the states, not with what the inputs make of them */
            for (int c = 0; c < a; c++)
                ((double *)P)[a * ZL + c] = ((double *)P)[c * ZL + a];
    }
    r->top = top;
    return 1;
}

/* ---- sweeps --------------------------------------------------------------------------------------------------- */

/* Errors and rows of all stages where the state and inputs move so. */
static void respond(Work *s, const double *v, const double *x)
{
    const Qp *q = &s->qp;
    double *e = s->stages.e_by, *rows = s->stages.value_by;
    for (int i = 0; i <= N; i++) {
        const double *at = x + i * ZL, *in = v + (i < N ? i : N - 1) * NU;
        for (int k = 0; k < NE; k++) {
            const double *of = (const double *)(s->stages.E + AT(i * NE + k));
            double sum = 0;
            for (int c = E_FIRST[k]; c < E_FIRST[k + 1]; c++)
                sum += of[E_AT[c]] * at[E_AT[c]];
            for (int j = 0; E_INPUT[k] && j < NU; j++)
                sum += of[NX + j] * in[j];
            e[i * NE + k] = sum;
        }
        for (int row = s->stages.first[i]; row < s->stages.first[i + 1]; row++) {
            const double *of = (const double *)(s->stages.L + AT(row));
            int k = LIMIT_WHICH[row];
            double sum = 0;
            for (int c = L_FIRST[k]; c < L_FIRST[k + 1]; c++)
                sum += of[L_AT[c]] * at[L_AT[c]];
            for (int j = 0; L_INPUT[k] && j < NU; j++)
                sum += of[NX + j] * in[j];
            rows[QN + QR + row] = sum;
        }
    }
    memcpy(rows, v, sizeof(double) * QN);
    for (int k = 0; k < QR; k++)
        rows[QN + k] = v[q->after[k]] - (q->before[k] < 0 ? 0 : v[q->before[k]]);
}

/* What the inputs themselves add to the gradient: by their weights and by what is remembered of the curvature, and by
   the multipliers of their rows. */
static void pull_inputs(const Work *s, double *bent, double *forces)
{
    const Qp *q = &s->qp;
    const Bends *m = &s->stages.bends;
    const double *v = s->stages.v, *price = s->stages.after;
    for (int a = 0; a < QN; a++) {
        double c = SCALE[a % NU] * SCALE[a % NU], change = c * s->ws[a] * (v[a] - (a < NU ? 0 : v[a - NU]));
        bent[a] = c * s->wr[a] * v[a] + change;
        if (a >= NU)
            bent[a - NU] -= change;
        forces[a] = price[a];
    }
    for (int k = 0; k < QR; k++) {
        forces[q->after[k]] += price[QN + k];
        if (q->before[k] >= 0)
            forces[q->before[k]] -= price[QN + k];
    }
    for (int k = 0; k < m->count; k++)
        add(bent, m->weight[k] * dot(m->y + k * QL, v, QN), m->y + k * QL, QN);
}

/* The same of the errors of stage i, and of its rows, by the state and the inputs there. */
INLINE void pull_stage(const Work *s, int i, V *bent, V *forces)
{
    const Stages *r = &s->stages;
    for (int k = 0; k < NE; k++) {
        double w = s->q[i * NE + k] * r->e[i * NE + k];
        for (int b = 0; b < ZV; b++)
            bent[b] += w * r->E[AT(i * NE + k) + b];
    }
    for (int row = r->first[i]; N_LIMITS > 0 && row < r->first[i + 1]; row++) {
        double w = r->after[QN + QR + row];
        for (int b = 0; w != 0 && b < ZV; b++)
            forces[b] += w * r->L[AT(row) + b];
    }
}

/* What the curvature of the cost, and the multipliers of the rows, add to the gradient by the inputs. */
static void pull(Work *s)
{
    Stages *r = &s->stages;
    V later[2 * ZV] = {0};
    pull_inputs(s, r->bent, r->forces);
    for (int i = N; i >= 0; i--) {
        V here[2 * ZV] = {0};
        pull_stage(s, i, here, here + ZV);
        for (int k = 0; i < N && k < 2; k++)
            add_products(here + AT(k), (const double *)(later + AT(k)), 1, r->Z + AT(i * RZ), RZ);
        for (int b = 0; b < 2 * ZV; b++)
            later[b] = i < N ? here[b] * r->unit[AT(NU) + b % ZV] : here[b];
        for (int j = 0; i < N && j < NU; j++) {
            r->bent[i * NU + j] += ((const double *)here)[NX + j];
            r->forces[i * NU + j] += ((const double *)here)[ZL + NX + j];
        }
    }
}

/* From what drives the inputs v, over the factor, to these inputs and the states r->x that move with them, from a stage
   on; the inputs of the stage `held` stay as they are. */
INLINE void move_on(Stages *r, double *v, int first, int held)
{
    for (int i = first; i < N; i++) {
        const V *S = r->S + AT(i * NU);
        const double *R = r->R + i * NU * NU, *x = (const double *)(r->x + AT(i));
        double *y = v + i * NU;
        for (int j = NU - 1; i != held && j >= 0; j--) {
            double sum = -y[j] - dot((const double *)(S + AT(j)), x, ZL);
            for (int k = j + 1; k < NU; k++)
                sum -= R[j * NU + k] * y[k];
            y[j] = sum * R[j * NU + j];
        }
        V next[ZV] = {0};
        add_products(next, x, 1, r->T + AT(i * ZW), NX);
        add_products(next, y, 1, r->T + AT(i * ZW + NX), NU);
        memcpy(r->x + AT(i + 1), next, sizeof next);
    }
}

/* The step r->dv from the gradient by the inputs that it holds and, if `staged`, by the multipliers r->after and what is
   tracked, and what moves with it. */
static void sweep(Work *s, int staged)
{
    Stages *r = &s->stages;
    V later[ZV] = {0};
    double *v = r->dv;
    if (staged)
        pull_stage(s, N, later, later);
    for (int i = N - 1; i >= 0; i--) {
        const V *S = r->S + AT(i * NU);
        const double *R = r->R + i * NU * NU;
        V here[ZV] = {0};
        double *y = v + i * NU;
        if (staged)
            pull_stage(s, i, here, here);
        add_products(here, (const double *)later, 1, r->Z + AT(i * RZ), RZ);
        for (int j = 0; j < NU; j++)
            y[j] += ((const double *)here)[NX + j];
        for (int j = 0; j < NU; j++) {
            y[j] *= R[j * NU + j];
            for (int k = j + 1; k < NU; k++)
                y[k] -= R[j * NU + k] * y[j];
        }
        for (int b = 0; b < ZV; b++) {
            V sum = here[b] * r->unit[AT(NU) + b];
            for (int j = 0; j < NU; j++)
                sum -= y[j] * S[AT(j) + b];
            later[b] = sum;
        }
    }
    memset(r->x, 0, sizeof(V) * ZV);
    move_on(r, v, 0, -1);
    respond(s, v, (const double *)r->x);
}
