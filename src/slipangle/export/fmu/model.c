/* Real numbers: states, inputs, outputs. */
typedef struct {
    int none;
} Part;

static void fmuStart(Part *p) { (void)p; }

static void fmuOutput(Part *p, double *v)
{
    (void)p;
    car_output(v, v + CAR_STATES, v + CAR_STATES + CAR_INPUTS);
}

static void fmuStep(Part *p, double *v)
{
    double next[CAR_STATES];
    (void)p;
    car_step(v, v + CAR_STATES, next);
    memcpy(v, next, sizeof next);
}
