/* Solve from what the plan before left; whether a solve went on from an unfinished one is in c->attempts. */
static int solve(Controller *c)
{
    Work *s = &c->work;
    int whole = c->found && c->attempts <= MOST_ATTEMPTS && moderate(s->u, N * NU) && moderate(s->x, (NS + 1) * NX) &&
                moderate(s->k, (NS + 1) * NK) && moderate(s->working, 1 + 2 * QT);
    if (whole)
        s->fresh = !c->attempts ? CONTINUE : c->attempts % RETRIES ? RESUME : RETRY;
    else if (c->plans && !c->stuck) {
        inputs_after(c->u, 1, s->u);
        s->fresh = GIVEN_INPUTS;
    } else
        s->fresh = FROM_NOTHING;
    if (!whole)
        c->attempts = 0;
    s->misses = c->misses;
    int status = rt_solve(s);
    int answer = moderate(s->u, N * NU) && moderate(s->x, (NS + 1) * NX);
    c->attempts = status == TIME_OUT || status == ITERATION_LIMIT ? c->attempts + 1 : 0;
    return (status == SOLVED || status == ITERATED) && !answer ? NOT_FINITE : status;
}
