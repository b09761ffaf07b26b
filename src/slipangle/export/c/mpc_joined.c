/* Where a problem has several parts, the solver of car_joined.c is asked about all of them at once; the one here knows a
   single part, predicts by it where a guess is needed, and makes the fallbacks. */

/* Inputs and states to begin with, the same for all parts: the plan before, a step later, else the input held. */
static void guess(Controller *c)
{
    Work *s = &c->work;
    int planned = c->plans && !c->stuck;
    s->qp.until = INFINITY;
    if (planned)
        inputs_after(c->u, 1, s->u);
    for (int i = 0; !planned && i < N; i++)
        memcpy(s->u + i * NU, s->applied, sizeof s->applied);
    if (planned)
        keep_inputs(s);
    if (planned && N > 1) {
        memset(s->k, 0, sizeof s->k);
        memcpy(s->x + (N - 1) * NX, c->x + N * NX, sizeof s->x0);
        evaluate_dynamics(s, N - 1, 1);
        memcpy(s->x, c->x + NX, sizeof(double) * N * NX);
        memcpy(s->x, s->x0, sizeof s->x0);
        memcpy(s->x + N * NX, s->next + (N - 1) * NX, sizeof s->x0);
    } else
        roll_out(s);
    for (int i = 0; !moderate(s->x, (N + 1) * NX) && i <= N; i++)
        memcpy(s->x + i * NX, s->x0, sizeof s->x0);
}

/* Solve from what the last solve left, else from a guess; what was found of one part goes where that part's would. */
static int solve(Controller *c)
{
    Work *s = &c->work;
    car_joined_answer found;
    car_joined_task task = {s->x0, s->applied, s->p, s->w, s->corridor, s->r, s->u, s->x, GIVEN, 0, 0, 0, 0};
    if (c->found)
        task.begin = c->attempts > MOST_ATTEMPTS ? GIVEN_INPUTS : c->attempts ? RESUME : CONTINUE;
    else
        guess(c);
    if (task.begin != RESUME)
        c->attempts = 0;
    task.most = s->max_iterations, task.seconds = s->time_limit, task.clock = s->qp.clock, task.clock_of = c;
    int status = car_joined_solve(joined_of(c), &task, &found);
    memcpy(s->u, found.u, sizeof s->u);
    memcpy(s->x, found.x, sizeof s->x);
    s->iterations = found.iterations, s->anew = found.begun_anew;
    s->cost = found.cost, s->residual = found.residual, s->violation = found.violation;
    c->attempts = status == TIME_OUT || status == ITERATION_LIMIT ? c->attempts + 1 : 0;
    return status;
}
