/* Limits of the states from the next plan on, a row of pairs for each node. */
void car_limit(car_controller *memory, const double *bounds);

void car_limit(car_controller *memory, const double *bounds)
{
    Work *s = &own(memory)->work;
    memcpy(s->bounds, bounds, sizeof s->bounds);
}

/* After a fallback: plans once more from the same state, from a guess of inputs and states, and says whether that is a
   plan. If it is none, the fallback stays. */
int car_plan_from(car_controller *memory, const car_input *in, const double *u, const double *x, car_output *out);

int car_plan_from(car_controller *memory, const car_input *in, const double *u, const double *x, car_output *out)
{
    Controller *c = own(memory);
    Work *s = &c->work;
    c->found = 0, c->attempts = 0;
    if (fault(s, in) != SOLVED)
        return 0;
    memset(s->applied, 0, sizeof s->applied);
    memcpy(s->u, u, sizeof s->u);
    memcpy(s->x, x, sizeof s->x);
    memcpy(s->x, s->x0, sizeof s->x0);
    s->fresh = GIVEN, s->misses = 0, s->time_limit = larger(c->around.seconds - now(&s->qp), 0);
    int status = car_rt_solve(s), answer = moderate(s->u, N * NU) && moderate(s->x, (NS + 1) * NX);
    if ((status == SOLVED || status == ITERATED) && !answer)
        status = NOT_FINITE;
    if (!is_plan(c, status)) {
        c->found = 0;
        return 0;
    }
    c->attempts = status == TIME_OUT || status == ITERATION_LIMIT, c->stuck = c->misses = 0;
    keep_plan(c);
    memcpy(out->command, c->u, sizeof out->command);
    memcpy(out->u, c->u, sizeof c->u);
    memcpy(out->x, c->x, sizeof c->x);
    out->cost = s->cost, out->residual = s->residual, out->violation = s->violation;
    out->status = status, out->age = 0, out->stopping = 0;
    out->iterations = (int)s->iterations, out->begun_anew = s->anew != 0;
    return 1;
}
