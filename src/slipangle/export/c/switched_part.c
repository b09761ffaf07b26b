/* What a part is asked, and what it said. */
static int ask_part(Controller *c, const car_input *in, car_output *out)
{
    static const car_part_input nothing;
    car_part_input given = nothing;
    car_part_output said;
    memcpy(given.x, in->x + FIRST, sizeof given.x);
    memcpy(given.tracked, in->tracked, sizeof given.tracked);
    memcpy(given.inputs, in->inputs, sizeof given.inputs);
    for (int i = 0; i < CAR_PART_EXOGENOUS_ROWS; i++)
        given.exogenous[i][0] = in->exogenous[i < CAR_EXOGENOUS_ROWS ? i : CAR_EXOGENOUS_ROWS - 1][0];
    given.applied[0] = in->applied[0], given.applied_known = in->applied_known;
    (void)car_part_plan(&whole(c)->part, &given, &said);
    memcpy(c->u, said.u, sizeof c->u);
    for (int i = 0; i <= NH; i++) {
        for (int a = 0; a < CAR_STATES; a++)
            out->x[i][a] = NAN;
        memcpy(out->x[i] + FIRST, said.x[i], sizeof said.x[i]);
        c->heading[i] = said.x[i][CAR_PART_STATES - 1];
    }
    out->cost = said.cost, out->residual = said.residual, out->violation = said.violation;
    out->iterations = said.iterations, out->begun_anew = said.begun_anew, c->age = said.age, c->stopping = said.stopping;
    return said.status;
}
