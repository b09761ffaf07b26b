/* Inputs where there is no plan, and where they lead: at the cost of about a linearisation, whatever happened. */

#define SWEEPS 6
#define NEAR 1e-6   /* error left by the last sweep, as far as is known, relative to 1 + |x| */
#define ROUGH 1e-3  /* the same where the state to begin with is itself only what was predicted */

/* States predicted some steps ago, at every step from now on: linear between nodes, the last one repeated. */
static void states_after(const double *from, int later, double *to)
{
    if (NS == N) {
        int left = later < NS ? NS - later : 0;
        memcpy(to, from + (NS - left) * NX, sizeof(double) * NX * (size_t)(left + 1));
        for (int m = left + 1; m <= NS; m++)
            memcpy(to + m * NX, from + NS * NX, sizeof(double) * NX);
        return;
    }
    for (int m = 0; m <= NS; m++) {
        int at = m + later < NS ? m + later : NS, i = at < NS ? STAGE_OF(at) : N - 1;
        double share = (double)(at - NODE(i)) / (double)(NODE(i + 1) - NODE(i));
        for (int a = 0; a < NX; a++)
            to[m * NX + a] = (1 - share) * from[i * NX + a] + share * from[(i + 1) * NX + a];
    }
}

/* The states that s->u leads to from s->x0 on, by Newton's method on all steps side by side from the states that s->x
   holds, with the derivatives there as long as each sweep moves the states much less than the one before. As many
   sweeps as time allows, at least one; 0 where the states leave the finite numbers. */
static int follow_inputs(Work *s, double until, double near)
{
    double most = INFINITY, before = INFINITY;
    int fresh = 1;
    memset(s->du, 0, sizeof s->du);
    if (NS > N) /* the inputs stay as they are */
        memcpy(s->u_later, s->u, sizeof s->u);
#if DYNAMICS == RADAU
    for (int m = 0; m < NS; m++)
        for (int i = 0; i < NK; i++)
            s->k[m * NK + i] = (s->x[(m + 1) * NX + CORE[i / 3]] - s->x[m * NX + CORE[i / 3]]) / STEP;
#endif
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        s->from = sweep ? 0 : INFINITY; /* stages need not be better than the states */
        for (int i = 0; i < NS; i += LANES)
            if (fresh)
                evaluate_dynamics(s, i, LANES);
            else
                evaluate_ends(s, i);
        s->from = 0, before = most, most = 0;
        move_states(s, 0);
        if (!moderate(s->dx, (NS + 1) * NX))
            return 0;
        for (int i = 0; i < (NS + 1) * NX; i++) {
            s->x[i] += s->dx[i];
            most = larger(most, fabs(s->dx[i]) / (1 + fabs(s->x[i])));
        }
        if ((sweep && most * most <= near * before) || now(&s->qp) > until)
            break;
        fresh = sweep && !(most <= 0.3 * before);
    }
    return 1;
}

/* From the inputs and the states at the nodes that s->way_u and s->way_x hold, `later` steps old, to those of a
   fallback in their place: these inputs shifted or, when `stopping`, the safe ones approached from the applied, within
   limits and rates; and the states that they lead to from s->x0 where that is known, and when stopping, else the old
   ones shifted. 0, and nothing done, where something given is no number. The iterate stays as it was. */
int rt_fallback(Work *s, int later, int stopping, int known)
{
    double until = now(&s->qp) + s->time_limit, size = 0;
    for (int j = 0; j < NU; j++)
        size += s->applied[j] * s->applied[j];
    if (!(size <= ANY_INPUT * ANY_INPUT && moderate(s->way_u, N * NU) && moderate(s->way_x, (N + 1) * NX)))
        return 0;
    memcpy(s->u_from, s->u, sizeof s->u);
    memcpy(s->x_from, s->x, sizeof s->x);
    memcpy(s->k_from, s->k, sizeof s->k);
    for (int j = 0; j < NU; j++)
        s->applied[j] = smaller(larger(s->applied[j], INPUT_LOW[j]), INPUT_HIGH[j]);
    inputs_after(s->way_u, later, s->u);
    for (int a = 0; stopping && a < N * NU; a++)
        s->u[a] = s->safe[a % NU] + s->relaxing[a / NU] * (s->applied[a % NU] - s->safe[a % NU]);
    keep_inputs(s);
    memcpy(s->way_u, s->u, sizeof s->u);
    states_after(s->way_x, later, s->x);
    if (!known)
        memcpy(s->x0, s->x, sizeof s->x0);
    for (int i = 0; i <= N; i++)
        memcpy(s->way_x + i * NX, s->x + NODE(i) * NX, sizeof s->x0);
    if ((known || stopping) && follow_inputs(s, until, known ? NEAR : ROUGH) && moderate(s->x, (NS + 1) * NX))
        for (int i = 0; i <= N; i++)
            memcpy(s->way_x + i * NX, s->x + NODE(i) * NX, sizeof s->x0);
    memcpy(s->u, s->u_from, sizeof s->u);
    memcpy(s->x, s->x_from, sizeof s->x);
    memcpy(s->k, s->k_from, sizeof s->k);
    return 1;
}
