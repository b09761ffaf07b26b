/* Replays the recorded drive through the controller, on whatever machine this runs:

       car_replay < drive.csv             how far the commands are from those that were recorded
       car_replay --commands < drive.csv  the commands themselves, a line a step

   A line of the drive has what car_input has, in its order, then the command that was decided. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static car_controller controller;
static car_input input;
static car_output output;

@READ_NUMBERS@
static int read_step(double *command)
{
    if (!read_numbers(input.x, CAR_STATES))
        return 0;
#if CAR_REFERENCES > 0
    if (!read_numbers(input.tracked[0], CAR_NODES * CAR_REFERENCES))
        return 0;
#endif
#if CAR_EXOGENOUS > 0
    if (!read_numbers(input.exogenous[0], CAR_EXOGENOUS_ROWS * CAR_EXOGENOUS))
        return 0;
#endif
#if CAR_CORRIDOR
    if (!read_numbers(input.corridor[0], CAR_NODES * 2))
        return 0;
#endif
    if (!read_numbers(input.applied, CAR_CONTROLS) || !read_numbers(command, CAR_CONTROLS))
        return 0;
    input.applied_known = 1;
    for (int j = 0; j < CAR_CONTROLS; j++)
        if (input.applied[j] != input.applied[j])
            input.applied_known = 0;
    return 1;
}

int main(int n, char **words)
{
    int commands = n > 1 && strcmp(words[1], "--commands") == 0, other = 0, steps = 0;
    double wanted[CAR_CONTROLS], worst = 0;
    int code = car_start(&controller, sizeof controller);
    if (code != CAR_OK) {
        printf("car_start: code %d\n", code);
        return 2;
    }
    if (scanf("%*[^\n]") == EOF || scanf("%*1[\n]") == EOF) /* names of the columns */
        return 2;
    for (; read_step(wanted); steps++) {
        car_plan(&controller, &input, &output);
        for (int j = 0; j < CAR_CONTROLS; j++) {
            double off = fabs(output.command[j] - wanted[j]) / (1 + fabs(wanted[j]));
            if (off != 0)
                other++;
            worst = off > worst || off != off ? off : worst;
            if (commands)
                printf(j + 1 < CAR_CONTROLS ? "%.17g," : "%.17g\n", output.command[j]);
        }
    }
    if (!commands) {
        printf("%d steps in %lu bytes of memory, %ld of them without a solution\n", steps,
               (unsigned long)sizeof controller, (long)output.health.fallbacks);
        printf("largest difference from the recorded commands: %g, in %d of them\n", worst, other);
    }
    return steps > 0 && worst <= 1e-6 ? 0 : 1;
}
