/* Replays a recorded drive through the recursion, on whatever machine this runs:

       car_replay < drive.csv           how far the coefficients are from those that were recorded
       car_replay --theta < drive.csv   the coefficients themselves, a line a sample

   A line of the drive has the outputs, the inputs, and the coefficients after the sample. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define COEFFICIENTS (CAR_OUTPUTS * CAR_REGRESSORS)

static car_recursion recursion;
static car_estimate estimate;

@READ_NUMBERS@
int main(int n, char **words)
{
    static double wanted[COEFFICIENTS], y[CAR_OUTPUTS], u[CAR_INPUTS];
    int said = n > 1 && strcmp(words[1], "--theta") == 0, other = 0, samples = 0;
    double worst = 0;
    int code = car_start(&recursion, sizeof recursion);
    if (code != CAR_OK) {
        printf("car_start: code %d\n", code);
        return 2;
    }
    if (scanf("%*[^\n]") == EOF || scanf("%*1[\n]") == EOF) /* names of the columns */
        return 2;
    for (; read_numbers(y, CAR_OUTPUTS) && read_numbers(u, CAR_INPUTS) && read_numbers(wanted, COEFFICIENTS); samples++) {
        (void)car_update(&recursion, y, u, &estimate);
        for (int i = 0; i < COEFFICIENTS; i++) {
            double is = estimate.theta[i / CAR_REGRESSORS][i % CAR_REGRESSORS];
            double off = fabs(is - wanted[i]) / (1 + fabs(wanted[i]));
            if (off != 0)
                other++;
            worst = off > worst || off != off ? off : worst;
            if (said)
                printf(i + 1 < COEFFICIENTS ? "%.17g," : "%.17g\n", is);
        }
    }
    if (!said) {
        printf("%d samples in %lu bytes of memory\n", samples, (unsigned long)sizeof recursion);
        printf("largest difference from the recorded coefficients: %g, in %d of them\n", worst, other);
    }
    return samples > 0 && worst <= 1e-6 ? 0 : 1;
}
