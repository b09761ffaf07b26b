/* How far what was measured is off what the model foretold, on average: one where that is right. */
static void wonder(const Filter *f, double *surprise)
{
    double squares = 0, count = 0;
    for (int i = 0; i < NY; i++)
        if (f->fresh[i] && f->taken[i] > 0)
            squares = squares + f->error[i] * f->error[i] / f->variance[i], count += 1;
    if (count > 0) {
        double now = squares / count;
        now = DOUBTED_MOST < now ? DOUBTED_MOST : now;
        *surprise += CAR_DT / TRUSTED * (now - *surprise);
    }
}

void car_planner_trust(car_planner_controller *memory, double doubt);
