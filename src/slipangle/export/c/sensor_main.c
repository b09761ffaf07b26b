/* Replays a recorded drive through the sensor, on whatever machine this runs:

       car_replay < drive.csv         how far the lateral velocity is from that which was recorded
       car_replay --v_y < drive.csv   the lateral velocity itself, a line a sample

   A line of the drive has the channels, and the lateral velocity that was said, nan where none. */

#include "car.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static car_sensor sensor;
static car_estimate estimate;

@READ_NUMBERS@
int main(int n, char **words)
{
    static double channels[CAR_CHANNELS], wanted;
    int said = n > 1 && strcmp(words[1], "--v_y") == 0, other = 0, samples = 0;
    double worst = 0;
    int code = car_start(&sensor, sizeof sensor);
    if (code != CAR_OK) {
        printf("car_start: code %d\n", code);
        return 2;
    }
    if (scanf("%*[^\n]") == EOF || scanf("%*1[\n]") == EOF) /* names of the columns */
        return 2;
    for (; read_numbers(channels, CAR_CHANNELS) && read_numbers(&wanted, 1); samples++) {
        int silent = car_update(&sensor, channels, &estimate) != CAR_OK;
        double off = fabs(estimate.v_y - wanted) / (1 + fabs(wanted));
        if (silent && wanted != wanted)
            off = 0;
        if (off != 0)
            other++;
        worst = off > worst || off != off ? off : worst;
        if (said)
            printf("%.17g\n", estimate.v_y);
    }
    if (!said) {
        printf("%d samples in %lu bytes of memory\n", samples, (unsigned long)sizeof sensor);
        printf("largest difference from the recorded lateral velocity: %g, in %d of them\n", worst, other);
    }
    return samples > 0 && worst <= 1e-6 ? 0 : 1;
}
