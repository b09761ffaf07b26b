/* Multiplies the weights of tracked quantities, then those of changes of inputs; once they are set. */
void car_weigh(car_controller *memory, const double *factors)
{
    Work *s = &own(memory)->work;
    for (int i = 0; i < (N + 1) * NE; i++)
        s->q[i] *= factors[i % M1(NE)];
    for (int i = 0; i < N * NU; i++)
        s->ws[i] *= FACTOR_OF_CHANGE[i % NU] < 0 ? 1 : factors[FACTOR_OF_CHANGE[i % NU]];
}
