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

static int fmuStep(Part *p, double *v)
{
    double next[STATES] = {0};
    int finite = 1;
    (void)p;
    stepOf(v, next);
    memcpy(v, next, sizeof next);
    for (int i = 0; i < STATES; i++)
        finite &= next[i] - next[i] == 0;
    return finite;
}

static int fmuSlope(const Part *p, const double *v, const double *along, double *to)
{
    (void)p;
    slopeOf(v, along, to);
    return 1;
}

#if DOUBTS > 0
/* What is wrong with parameters that do not go together, or nothing. */
static const char *fmuDoubt(const double *v)
{
    double above[DOUBTS] = {0};
    doubtOf(v, above);
    for (int k = 0; k < DOUBTS; k++)
        if (!(above[k] > 0))
            return SAID[k];
    return NULL;
}
#endif
