
/* Weighs course and quick steering by how far the model is doubted, one where it foretells what is measured. */
void car_trust(car_controller *memory, double doubt);

void car_trust(car_controller *memory, double doubt)
{
    Work *s = &own(memory)->work;
    double steep = doubt * doubt * doubt;
    for (int k = 0; k <= N; k++)
        for (int i = 0; i < NE; i++) {
            double weight = ERRORS_AS_ONE[k * NE + i] * (DOUBTED[i] ? doubt : 1);
            s->q[k * NE + i] = doubt == 1 ? OF_ERRORS[k * NE + i] : ERRORS_COUNT[k] * weight;
        }
    for (int k = 0; k < N; k++)
        for (int j = 0; j < NU; j++) {
            double weight = CHANGES_AS_ONE[j] * steep;
            s->ws[k * NU + j] = doubt == 1 ? OF_CHANGES[k * NU + j] : CHANGES_COUNT[k] * weight;
        }
}
