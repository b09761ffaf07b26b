/* Replays a recorded drive through the estimator, on whatever machine this runs:

       car_replay < drive.csv           how far the states are from those that were recorded
       car_replay --states < drive.csv  the states themselves, a line a sample

   A line of the drive has the outputs, the inputs, and the state after the sample. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static car_estimator estimator;
static car_sample sample;
static car_estimate estimate;

@READ_NUMBERS@
int main(int n, char **words)
{
    static const double start[CAR_STATES] = CAR_START;
    int said = n > 1 && strcmp(words[1], "--states") == 0, other = 0, samples = 0;
    double wanted[CAR_STATES], worst = 0;
    int code = car_start(&estimator, sizeof estimator, start);
    if (code != CAR_OK) {
        printf("car_start: code %d\n", code);
        return 2;
    }
    if (scanf("%*[^\n]") == EOF || scanf("%*1[\n]") == EOF) /* names of the columns */
        return 2;
    for (; read_numbers(sample.y, CAR_OUTPUTS) && read_numbers(sample.u, CAR_INPUTS) && read_numbers(wanted, CAR_STATES);
         samples++) {
        (void)car_update(&estimator, &sample, &estimate);
        for (int a = 0; a < CAR_STATES; a++) {
            double off = fabs(estimate.state[a] - wanted[a]) / (1 + fabs(wanted[a]));
            if (off != 0)
                other++;
            worst = off > worst || off != off ? off : worst;
            if (said)
                printf(a + 1 < CAR_STATES ? "%.17g," : "%.17g\n", estimate.state[a]);
        }
    }
    if (!said) {
        printf("%d samples in %lu bytes of memory\n", samples, (unsigned long)sizeof estimator);
        printf("largest difference from the recorded states: %g, in %d of them\n", worst, other);
    }
    return samples > 0 && worst <= 1e-6 ? 0 : 1;
}
