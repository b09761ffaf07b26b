
/* Weights as the reader wants them, each time that they are set. */
static double factors_now[N_WEIGHTS + 1];

void car_factors(const double *factors);
void car_weighed(car_controller *memory, double doubt);

void car_factors(const double *factors) { memcpy(factors_now, factors, sizeof(double[N_WEIGHTS + 1]) - sizeof(double)); }

void car_weighed(car_controller *memory, double doubt)
{
    car_trust(memory, doubt);
    car_weigh(memory, factors_now);
}
