/* The usual call, from the plan that the work area still holds: what it is given is judged here, at once. */

#define FAR_BEYOND 0.01 /* its limits, in units of half its range: an input applied that is to be told of */

/* As rt_solve; DOUBTFUL, with nothing solved, where anything given is for a closer look. */
int rt_again(Work *s)
{
    const double *low = s->lowest, *high = s->highest;
    int good = plausible(s->x0, 1, NX, low, high) && plausible(s->p, N + 1, NP, low + NX, high + NX) &&
               plausible(s->w, N + 1, NW, low + NX + NP, high + NX + NP) && moderate(s->u, N * NU) &&
               moderate(s->x, (NS + 1) * NX) && moderate(s->k, NS * NK) && moderate(s->working, 1 + 2 * QT);
#ifdef EDGES
    for (int i = 0; i < 2 * (N + 1); i++)
        good &= s->corridor[i] == s->corridor[i];
#endif
#ifdef HEADING
    good &= fabs(s->x0[HEADING] - s->p[HEADING_WANTED]) <= 3.1415; /* no turn more, or less, to be unwound */
#endif
    double size = 0, beyond = 0;
    for (int j = 0; j < NU; j++) {
        size += s->applied[j] * s->applied[j];
        beyond = larger(beyond, larger(s->applied[j] - INPUT_HIGH[j], INPUT_LOW[j] - s->applied[j]) / SCALE[j]);
        s->applied[j] = smaller(larger(s->applied[j], INPUT_LOW[j]), INPUT_HIGH[j]);
    }
    if (!(good && beyond <= FAR_BEYOND && size <= ANY_INPUT * ANY_INPUT))
        return DOUBTFUL;
    int status = rt_solve(s);
    if ((status == SOLVED || status == ITERATED) && !(moderate(s->u, N * NU) && moderate(s->x, (NS + 1) * NX)))
        return NOT_FINITE;
    return status;
}
