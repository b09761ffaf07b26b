/* Real numbers: states, inputs, parameters; outputs. */
typedef struct {
    int none;
} Part;

static void fmuStart(Part *p) { (void)p; }

static void fmuOutput(Part *p, double *v)
{
    (void)p;
    outputOf(v, v + OUTPUTS);
}

static void fmuStep(Part *p, double *v)
{
    double next[STATES] = {0};
    (void)p;
    stepOf(v, next);
    memcpy(v, next, sizeof next);
}

static int fmuSlope(const Part *p, const double *v, const double *along, double *to)
{
    (void)p;
    slopeOf(v, along, to);
    return 1;
}
