/* One vector in, one out, for block diagrams and messages: channels, then lateral velocity and side slip angle. */

#ifndef CAR_BLOCK_H
#define CAR_BLOCK_H

#include "car.h"

typedef double car_signal;

#define CAR_BLOCK_INPUTS CAR_CHANNELS
#define CAR_BLOCK_OUTPUTS 2
#define CAR_BLOCK_HOLDS 0 /* what is old is left out */

typedef struct {
    car_sensor sensor;
    car_estimate estimate;
} car_block;

static inline int car_block_start(car_block *b) { return car_start(&b->sensor, sizeof b->sensor); }

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    double channels[CAR_CHANNELS];
    for (int i = 0; i < CAR_CHANNELS; i++)
        channels[i] = (double)in[i];
    (void)t;
    (void)car_update(&b->sensor, channels, &b->estimate);
    out[0] = (car_signal)b->estimate.v_y;
    out[1] = (car_signal)b->estimate.side_slip;
}

#endif
