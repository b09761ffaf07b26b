/* Multiplies the weights of tracked quantities, then those of changes of inputs; once, after car_start. */
void car_weigh(car_controller *memory, const double *factors)
{
    Work *s = &own(memory)->work;
    for (int i = 0; i < (N + 1) * NE; i++)
        s->q[i] = OF_ERRORS[i] * factors[i % M1(NE)];
    for (int i = 0; i < N * NU; i++)
        s->ws[i] = OF_CHANGES[i] * (FACTOR_OF_CHANGE[i % NU] < 0 ? 1 : factors[FACTOR_OF_CHANGE[i % NU]]);
}
