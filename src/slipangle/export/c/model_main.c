/* Repeats the recorded free run on whatever machine this is:

       car_replay < drive.csv            how far the outputs are from those that were recorded
       car_replay --outputs < drive.csv  the outputs themselves, a line a sample

   A line of the drive has the state, of which the first one counts, the inputs and the outputs. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static int read_numbers(double *to, int n)
{
    for (int i = 0; i < n; i++)
        if (scanf("%lf%*1[,\n]", &to[i]) != 1)
            return 0;
    return 1;
}

int main(int n, char **words)
{
    static double x[CAR_STATES], next[CAR_STATES], read[CAR_STATES], u[CAR_INPUTS_SIZE], y[CAR_OUTPUTS], was[CAR_OUTPUTS];
    int outputs = n > 1 && strcmp(words[1], "--outputs") == 0, steps = 0;
    double worst = 0;
    if (scanf("%*[^\n]") == EOF || scanf("%*1[\n]") == EOF) /* names of the columns */
        return 2;
    for (; read_numbers(read, CAR_STATES) && read_numbers(u, CAR_INPUTS) && read_numbers(was, CAR_OUTPUTS); steps++) {
        memcpy(x, steps ? next : read, sizeof x);
        car_output(x, u, y);
        car_step(x, u, next);
        for (int j = 0; j < CAR_OUTPUTS; j++) {
            double off = fabs(y[j] - was[j]) / (1 + fabs(was[j]));
            worst = off > worst || off != off ? off : worst;
            if (outputs)
                printf(j + 1 < CAR_OUTPUTS ? "%.17g," : "%.17g\n", y[j]);
        }
    }
    if (!outputs)
        printf("%d samples of a free run; largest difference from the recorded outputs: %g\n", steps, worst);
    return steps > 0 && worst <= 1e-6 ? 0 : 1;
}
