/* A point from which no first derivative leads down may be a maximum along something. The Riccati factor with all
   curvature, of what the held rows leave free, then has a negative pivot, and with it a direction along which the cost
   falls. */

#define FALLS 1e-6 /* negative curvature, over the largest by an input, that is no rounding */
#define ASIDE 0.1  /* of half its range, how far an input moves at most to leave such a point */
#define NEARER 0.1 /* of that, where it leads past what is better */
#define TOUCHED 1e-6 /* distance of a row from its limit, in units of half its range, that is none */
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

/* Rows with one value are held whatever their multiplier is, and so, of `all`, are those at their limit. */
static void hold_more(Work *s, int all)
{
    Stages *r = &s->stages;
    const Qp *q = &s->qp;
    for (int k = 0; k < r->rows; k++) {
        int i = r->row[k];
        double touch = TOUCHED * sqrt(STIFF * r->top / r->stiff[i]);
        int up = q->hi[i] <= touch, down = -q->lo[i] <= touch;
        if (r->mode[i] == FREE && (all ? up || down : up && down))
            r->mode[i] = q->plain[i] > 0 ? KEPT : PAID, r->sign[i] = up ? 1 : -1;
    }
}

/* Whether there is negative curvature at the iterate, beside rows that are held: where the factor falls. */
static int is_negative(Work *s, int all)
{
    Stages *r = &s->stages;
    begin_program(s, 1);
    hold_more(s, all);
    count_negative(s, 1);
    price_rows(s);
    memcpy(r->slope, r->wanted, sizeof r->slope);
    int positive = factor_stages(s, 0), i = r->fell / NU, j = r->fell % NU;
    count_negative(s, 0);
    return !positive && r->R[i * NU * NU + j * NU + j] < -FALLS * r->top;
}

/* Whether there is a direction of negative curvature at the iterate: steps of inputs and states, for `leave_saddle`.
   `surely` where rows that are at their limit do not hold it either, whatever their multipliers are. */
static int falls(Work *s, int *surely)
{
    Stages *r = &s->stages;
    double most = 0;
    s->damp = 0;
    if (!prepare_stages(s))
        return 0;
    feed(s);
    if (!is_negative(s, 0))
        return 0;
    lead_down(s, r->fell / NU, r->fell % NU);
    for (int a = 0; a < N * NU; a++)
        most = larger(most, fabs(r->dv[a]));
    for (int a = 0; a < N * NU; a++)
        s->falls_u[a] = ASIDE / most * SCALE[a % NU] * r->dv[a];
    for (int m = 0; m <= NS; m++)
        for (int a = 0; a < NX; a++)
            s->falls_x[m * NX + a] = ASIDE / most * ((const double *)(r->x + AT(m)))[a];
    *surely = is_negative(s, 1);
    return moderate(s->falls_u, N * NU) && moderate(s->falls_x, (NS + 1) * NX);
}

/* The inputs of a solve that was cut short, and the states that they lead to, as its own need not follow from them. */
static void follow_cut(Work *s)
{
    double cost, violation;
    keep_inputs(s);
    roll_out(s);
    if (!linearise(s))
        return;
    merit(s, &cost, &violation);
    s->cost = 2 * cost, s->violation = violation, s->residual = INFINITY;
}

/* From that plan on to one side of it. */
static int step_aside(Work *s, double side)
{
    recall_iterate(s);
    for (int a = 0; a < N * NU; a++)
        s->u[a] += side * s->falls_u[a];
    for (int a = 0; a < (NS + 1) * NX; a++)
        s->x[a] += side * s->falls_x[a];
    int ended = go_on(s);
    if (ended == ITERATION_LIMIT && !(s->violation <= FEASIBLE))
        follow_cut(s);
    return ended;
}

/* What ended at such a point goes on from either side of it, a little way if a longer one leads to nothing better. Where
   nothing does it stays there, which is no optimum where that is sure: iterations or time ran out, or the search did. */
static int leave_saddle(Work *s, int status)
{
    static const double sides[] = {1, -1, NEARER, -NEARER};
    for (int n = 0; status == SOLVED; n++) {
        if ((s->tried && s->saddle) || !has_negative(s)) /* positive where the last step had it all */
            break;
        if (!begins(s, BY_STAGES))
            return TIME_OUT;
        int ended = STALLED, better = 0, surely = 0;
        if (!falls(s, &surely))
            break;
        double enough = s->cost - LOWER * fabs(s->cost);
        keep_iterate(s);
        for (int side = 0; side < 4 && n < LEAVES && !better && ended != TIME_OUT; side++) {
            ended = s->iterations < s->max_iterations ? step_aside(s, sides[side]) : ITERATION_LIMIT;
            better = leads_on(s, ended) && s->cost < enough;
        }
        if (!better)
            recall_iterate(s);
        else if (ended == SOLVED)
            continue;
        if (better || (surely && (ended == ITERATION_LIMIT || ended == TIME_OUT)))
            return ended;
        return surely ? STALLED : SOLVED;
    }
    return status;
}
