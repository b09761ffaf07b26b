/* One vector in, one out, for block diagrams and messages: outputs (NaN where nothing was measured) and inputs, then states
   and their standard deviations. It begins where the recorded drive does. */

#ifndef CAR_BLOCK_H
#define CAR_BLOCK_H

#include "car.h"

typedef double car_signal;

#define CAR_BLOCK_INPUTS (CAR_OUTPUTS + CAR_INPUTS)
#define CAR_BLOCK_OUTPUTS (2 * CAR_STATES)
#define CAR_BLOCK_HOLDS 0 /* what is old counts as not measured */

typedef struct {
    car_estimator estimator;
    car_sample sample;
    car_estimate estimate;
} car_block;

static inline int car_block_start(car_block *b)
{
    static const double start[CAR_STATES] = CAR_START;
    return car_start(&b->estimator, sizeof b->estimator, start);
}

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    for (int i = 0; i < CAR_OUTPUTS; i++)
        b->sample.y[i] = (double)in[i];
    for (int i = 0; i < CAR_INPUTS; i++)
        b->sample.u[i] = (double)in[CAR_OUTPUTS + i];
    (void)t;
    (void)car_update(&b->estimator, &b->sample, &b->estimate);
    for (int a = 0; a < CAR_STATES; a++)
        out[a] = b->estimate.state[a], out[CAR_STATES + a] = b->estimate.state_std[a];
}

#endif
