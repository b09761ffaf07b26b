/* One vector in, one out, for block diagrams and messages: outputs and inputs, then coefficients. */

#ifndef CAR_BLOCK_H
#define CAR_BLOCK_H

#include "car.h"

typedef double car_signal;

#define CAR_BLOCK_INPUTS (CAR_OUTPUTS + CAR_INPUTS)
#define CAR_BLOCK_OUTPUTS (CAR_OUTPUTS * CAR_REGRESSORS)
#define CAR_BLOCK_HOLDS 0 /* what is old is left out */

typedef struct {
    car_recursion recursion;
    car_estimate estimate;
} car_block;

static inline int car_block_start(car_block *b) { return car_start(&b->recursion, sizeof b->recursion); }

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    double y[CAR_OUTPUTS], u[CAR_INPUTS];
    for (int i = 0; i < CAR_OUTPUTS; i++)
        y[i] = (double)in[i];
    for (int i = 0; i < CAR_INPUTS; i++)
        u[i] = (double)in[CAR_OUTPUTS + i];
    (void)t;
    if (car_update(&b->recursion, y, u, &b->estimate) != CAR_OK)
        car_restart(&b->recursion);
    for (int i = 0; i < CAR_BLOCK_OUTPUTS; i++)
        out[i] = b->estimate.theta[i / CAR_REGRESSORS][i % CAR_REGRESSORS];
}

#endif
