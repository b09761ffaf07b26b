/* Random inputs for an exported MPC with a corridor, NaN and infinities among them; every plan must be within limits and
   rates. The first argument is how many calls. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define LIMIT 0.35
#define STEP 0.05

static car_controller controller;
static unsigned long long state = 1;

static double uniform(void)
{
    state = state * 6364136223846793005ull + 1442695040888963407ull;
    return (double)(state >> 11) / 9007199254740992.0;
}

static double odd(void)
{
    static const double values[] = {NAN,   INFINITY, -INFINITY, 1e308, -1e308, 1e200, 1e100,
                                    -1e30, 1e13,     0,         5e-324, 1e-300, -40,   9};
    return values[(int)(uniform() * 14)];
}

static void invent(car_input *in)
{
    double *v = (double *)in, size = pow(10, 4 * uniform() - 3);
    int many = (int)(offsetof(car_input, applied_known) / sizeof(double));
    for (int i = 0; i < many; i++)
        v[i] = size * (uniform() - 0.5);
    for (int i = 0; i < CAR_NODES; i++) {
        in->exogenous[i][0] = 30 * uniform();
        in->corridor[i][0] = in->corridor[i][1] = uniform() < 0.1 ? INFINITY : 3 * uniform();
    }
    if (uniform() < 0.5)
        for (int i = 0; i < CAR_HORIZON; i++)
            in->inputs[i][0] = 0;
    for (int poison = uniform() < 0.4 ? 1 + (int)(3 * uniform()) : 0; poison > 0; poison--)
        v[(int)(uniform() * many)] = odd();
    in->applied_known = uniform() < 0.5;
}

int main(int n, char **words)
{
    long calls = n > 1 ? atol(words[1]) : 1, wrong = 0, fallbacks = 0;
    double last = 0;
    for (long k = 0; k < calls; k++) {
        car_input in;
        car_output out;
        if (k == 0 || uniform() < 0.001) {
            if (car_start(&controller, sizeof controller) != CAR_OK)
                return 2;
            last = 0;
        }
        invent(&in);
        car_deadline(&controller, uniform() < 0.1 ? 1 + (int)(5 * uniform()) : 0, 0, NULL, NULL);
        car_plan(&controller, &in, &out);
        double said = in.applied[0], before = in.applied_known && fabs(said) <= 1e12 ? said : last;
        before = fmin(fmax(before, -LIMIT), LIMIT);
        for (int i = 0; i < CAR_HORIZON; i++) {
            double u = out.u[i][0];
            wrong += !(fabs(u) <= LIMIT && fabs(u - before) <= STEP + 1e-12);
            before = u;
        }
        last = out.command[0];
        fallbacks += out.age > 0;
    }
    printf("%ld calls, %ld without a solution, %ld inputs outside limits or rates\n", calls, fallbacks, wrong);
    return wrong != 0;
}
