/* A point from which no first derivative leads down may be a maximum along something. The Riccati factor with all
   curvature, of what the held rows leave free, then has a negative pivot, and with it a direction along which the cost
   falls. */

#define FALLS 1e-6 /* negative curvature, over the largest by an input, that is no rounding */
#define ASIDE 0.1  /* of half its range, how far an input moves at most to leave such a point */
#define LEAVES 4   /* most such points in a solve */
#define LOWER 1e-9 /* of the cost, by which a plan from beside one must be better */

/* Where that direction leads from the input j of stage i on: inputs before it at their best, later ones by feedback. */
static void lead_down(Work *s, int i, int j)
{
    Stages *r = &s->stages;
    const double *pivots = r->R + i * NU * NU;
    double *v = r->dv;
    memset(r->dv, 0, sizeof r->dv);
    memset(r->x, 0, sizeof r->x);
    v[i * NU + j] = 1;
    for (int k = j - 1; k >= 0; k--) {
        double sum = 0;
        for (int m = k + 1; m <= j; m++)
            sum -= pivots[k * NU + m] * v[i * NU + m];
        v[i * NU + k] = sum * pivots[k * NU + k];
    }
    move_on(r, v, i, i);
}

/* Whether there is a direction of negative curvature at the iterate: steps of inputs and states, for `leave_saddle`. */
static int falls(Work *s)
{
    Stages *r = &s->stages;
    if ((s->tried && s->saddle) || !has_negative(s) || !begins(s, BY_STAGES)) /* positive where the last step had it all */
        return 0;
    s->damp = 0;
    if (!prepare_stages(s))
        return 0;
    double top = r->top, most = 0;
    begin_program(s, 1);
    count_negative(s, 1);
    price_rows(s);
    memcpy(r->slope, r->wanted, sizeof r->slope);
    int positive = factor_stages(s, 0), i = r->fell / NU, j = r->fell % NU;
    count_negative(s, 0);
    if (positive || !(r->R[i * NU * NU + j * NU + j] < -FALLS * top))
        return 0;
    lead_down(s, i, j);
    for (int a = 0; a < N * NU; a++)
        most = larger(most, fabs(r->dv[a]));
    for (int a = 0; a < N * NU; a++)
        s->falls_u[a] = ASIDE / most * SCALE[a % NU] * r->dv[a];
    for (int m = 0; m <= NS; m++)
        for (int a = 0; a < NX; a++)
            s->falls_x[m * NX + a] = ASIDE / most * ((const double *)(r->x + AT(m)))[a];
    return moderate(s->falls_u, N * NU) && moderate(s->falls_x, (NS + 1) * NX);
}

/* From that plan on to one side of it. */
static int step_aside(Work *s, double side)
{
    recall_iterate(s);
    for (int a = 0; a < N * NU; a++)
        s->u[a] += side * s->falls_u[a];
    for (int a = 0; a < (NS + 1) * NX; a++)
        s->x[a] += side * s->falls_x[a];
    return go_on(s);
}

/* What ended at such a point goes on from either side of it, and stays there if that leads to nothing better. */
static int leave_saddle(Work *s, int status)
{
    for (int n = 0, better = 1; n < LEAVES && better && status == SOLVED && falls(s); n++) {
        double enough = s->cost - LOWER * fabs(s->cost);
        keep_iterate(s);
        better = 0;
        for (int side = 1; side >= -1 && !better && s->iterations < s->max_iterations; side -= 2) {
            int ended = step_aside(s, side);
            better = leads_on(s, ended) && s->cost < enough;
            status = better ? ended : status;
        }
        if (!better)
            recall_iterate(s);
    }
    return status;
}
