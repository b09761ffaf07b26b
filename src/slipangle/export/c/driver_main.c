/* Replays a recorded drive through the driver, on whatever machine this runs:

       car_replay < drive.csv             how far the commands are from those that were recorded
       car_replay --commands < drive.csv  the commands themselves, a line a call

   A line of the drive has the time, what was measured, and the commands. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static car_driver driver;
static car_measurements measured;
static car_commands commands;

@READ_NUMBERS@
static int read_time(car_seconds *to) { return scanf("%lf%*1[,\n]", to) == 1; }

int main(int n, char **words)
{
    int said = n > 1 && strcmp(words[1], "--commands") == 0, other = 0, steps = 0;
    double wanted[CAR_COMMANDS], worst = 0;
    int code = car_start(&driver, sizeof driver);
    if (code != CAR_OK) {
        printf("car_start: code %d\n", code);
        return 2;
    }
    if (scanf("%*[^\n]") == EOF || scanf("%*1[\n]") == EOF) /* names of the columns */
        return 2;
    while (read_time(&measured.t) && read_numbers(measured.value, CAR_CHANNELS) &&
           read_numbers(wanted, CAR_COMMANDS)) {
        (void)car_step(&driver, &measured, &commands);
        steps++;
        for (int j = 0; j < CAR_COMMANDS; j++) {
            double off = fabs(commands.value[j] - wanted[j]) / (1 + fabs(wanted[j]));
            if (off != 0)
                other++;
            worst = off > worst || off != off ? off : worst;
            if (said)
                printf(j + 1 < CAR_COMMANDS ? "%.17g," : "%.17g\n", commands.value[j]);
        }
    }
    if (!said) {
        printf("%d calls in %lu bytes of memory, %ld plans without a solution\n", steps, (unsigned long)sizeof driver,
               (long)commands.health.fallbacks);
        printf("largest difference from the recorded commands: %g, in %d of them\n", worst, other);
    }
    return steps > 0 && worst <= 1e-6 ? 0 : 1;
}
