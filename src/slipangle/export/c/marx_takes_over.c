/* Go on from what another controller planned last. */
void car_take_over(car_controller *memory, const car_handed *from)
{
    Controller *c = own(memory);
    c->plans = c->handed = 1, c->age = from->age, c->stopping = from->stopping;
    memcpy(c->u, from->u, sizeof c->u);
    memset(c->offset, 0, sizeof c->offset);
    memset(c->x, 0, sizeof c->x);
    if (from->x)
        memcpy(c->x, from->x, sizeof c->x);
}

void car_leave(car_controller *memory, car_handed *to)
{
    to->x = own(memory)->x;
    to->kept_u = to->kept_x = NULL, to->kept_age = 0;
}
