/* Curvature that is remembered of steps, on the Riccati factor: a sum of products beside the stages', for each of which a
   sweep says what it changes (Sherman, Morrison, Woodbury). */

/* The Newton step r->dv from r->v, with the multipliers r->after there, and what moves with it. */
static void solve_stages(Work *s)
{
    Stages *r = &s->stages;
    const Bends *m = &r->bends;
    double bent[QN], c[COLUMNS];
    pull_inputs(s, bent, r->dv);
    for (int a = 0; a < QN; a++)
        r->dv[a] += s->qp.g[a] + bent[a] + r->damped[a] * r->v[a];
    sweep(s, 1);
    for (int k = 0; k < m->count; k++) {
        c[k] = dot(m->y + k * QL, r->dv, QN);
        for (int l = 0; l < k; l++)
            c[k] -= m->factor[k * COLUMNS + l] * c[l];
    }
    for (int k = m->count - 1; k >= 0; k--) {
        for (int l = k + 1; l < m->count; l++)
            c[k] -= m->factor[k * COLUMNS + l] * c[l];
        c[k] /= m->factor[k * COLUMNS + k];
        add(r->dv, -c[k], m->dv + k * QN, QN);
        add(r->e_by, -c[k], m->e_by + k * (N + 1) * NE, (N + 1) * NE);
        add(r->value_by, -c[k], m->value_by + k * QT, QT);
    }
}

/* What the factor makes of the remembered curvature: to be done after each; 0 where that is singular. */
static int factor_bends(Work *s)
{
    Stages *r = &s->stages;
    Bends *m = &r->bends;
    double *F = m->factor;
    for (int k = 0; k < m->count; k++) {
        for (int a = 0; a < QN; a++)
            r->dv[a] = -m->y[k * QL + a];
        sweep(s, 0);
        memcpy(m->dv + k * QN, r->dv, sizeof r->dv);
        memcpy(m->e_by + k * (N + 1) * NE, r->e_by, sizeof(double) * (N + 1) * NE);
        memcpy(m->value_by + k * QT, r->value_by, sizeof r->value_by);
        for (int l = 0; l < m->count; l++)
            F[l * COLUMNS + k] = dot(m->y + l * QL, r->dv, QN) + (k == l ? 1 / m->weight[k] : 0);
    }
    for (int k = 0; k < m->count; k++) { /* weights of both signs, each pivot that of its column: no row is exchanged */
        if (!(fabs(F[k * COLUMNS + k]) > 0 && fabs(F[k * COLUMNS + k]) < INFINITY))
            return 0;
        for (int l = k + 1; l < m->count; l++) {
            F[l * COLUMNS + k] /= F[k * COLUMNS + k];
            for (int n = k + 1; n < m->count; n++)
                F[l * COLUMNS + n] -= F[l * COLUMNS + k] * F[k * COLUMNS + n];
        }
    }
    return 1;
}

/* The curvature of the cost, as remembered too, along a step of the inputs. */
static const double *bend(Work *s, const double *step)
{
    Stages *r = &s->stages;
    memset(r->x, 0, sizeof(V) * ZV);
    for (int i = 0; i < N; i++) {
        V next[ZV] = {0};
        add_products(next, (const double *)(r->x + AT(i)), 1, r->T + AT(i * ZW), NX);
        add_products(next, step + i * NU, 1, r->T + AT(i * ZW + NX), NU);
        memcpy(r->x + AT(i + 1), next, sizeof next);
    }
    respond(s, step, (const double *)r->x);
    memcpy(r->v, step, sizeof r->v);
    memcpy(r->e, r->e_by, sizeof r->e);
    memset(r->after, 0, sizeof r->after);
    pull(s);
    return r->bent;
}

/* The curvature after all remembered steps, as `secant` corrects a matrix, as a sum of products. */
static void bend_stages(Work *s)
{
    Bends *m = &s->stages.bends;
    m->count = 0;
    for (int k = 0; k < s->pairs; k++) {
        double *y = m->y + m->count * QL, *z = y + QL, keep, mixed;
        const double *step = s->pair_s + k * QL, *change = s->pair_y + k * QL;
        memcpy(z, bend(s, step), sizeof(double) * QN);
        double old = dot(z, step, QN);
        if (!damped(old, dot(change, step, QN), &keep, &mixed))
            continue;
        for (int a = 0; a < QN; a++)
            y[a] = keep * change[a] + (1 - keep) * z[a];
        m->weight[m->count++] = 1 / mixed;
        m->weight[m->count++] = -1 / old;
    }
}

/* What the multipliers of the last quadratic program add to the gradient by the inputs. */
static const double *force(Work *s)
{
    Stages *r = &s->stages;
    memset(r->v, 0, sizeof r->v);
    memset(r->e, 0, sizeof r->e);
    memcpy(r->after, s->qp.lambda, sizeof r->after);
    for (int a = 0; a < QN + QR; a++)
        r->after[a] = 0;
    pull(s);
    return r->forces;
}
