/* Go on from what another controller planned last. */
void car_take_over(car_controller *memory, const car_handed *from)
{
    Controller *c = own(memory);
    c->plans = 1, c->found = 0, c->attempts = 0, c->misses = 0;
    c->age = from->age, c->stopping = from->stopping, c->kept = from->kept_u != NULL, c->kept_age = from->kept_age;
    memcpy(c->u, from->u, sizeof c->u);
    for (int i = 0; i < (N + 1) * NX; i++) {
        double still = fabs(from->now[i % NX]) <= 1e150 ? from->now[i % NX] : 0;
        c->x[i] = from->x ? from->x[i] : still;
        c->kept_x[i] = from->kept_x ? from->kept_x[i] : still;
    }
    if (c->kept)
        memcpy(c->kept_u, from->kept_u, sizeof c->kept_u);
}

void car_leave(car_controller *memory, car_handed *to)
{
    const Controller *c = own(memory);
    int kept = c->kept && c->age > 0;
    to->x = c->x, to->kept_u = kept ? c->kept_u : NULL, to->kept_x = kept ? c->kept_x : NULL, to->kept_age = c->kept_age;
}
