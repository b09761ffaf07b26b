/* One vector in, one out, for block diagrams and messages: inputs, then outputs at the same sample, after which the state
   moves on. It begins where the recorded drive does. */

#ifndef CAR_BLOCK_H
#define CAR_BLOCK_H

#include "car.h"

#include <string.h>

typedef double car_signal;

#define CAR_BLOCK_INPUTS CAR_INPUTS
#define CAR_BLOCK_OUTPUTS CAR_OUTPUTS
#define CAR_BLOCK_HOLDS 1 /* inputs stay what they were last */

typedef struct {
    double x[CAR_STATES], next[CAR_STATES], u[CAR_INPUTS_SIZE], y[CAR_OUTPUTS];
} car_block;

static inline int car_block_start(car_block *b)
{
    static const double start[CAR_STATES] = {@START@};
    memset(b, 0, sizeof *b);
    memcpy(b->x, start, sizeof b->x);
    return 0;
}

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    for (int i = 0; i < CAR_INPUTS; i++)
        b->u[i] = (double)in[i];
    (void)t;
    car_output(b->x, b->u, b->y);
    car_step(b->x, b->u, b->next);
    memcpy(b->x, b->next, sizeof b->x);
    for (int j = 0; j < CAR_OUTPUTS; j++)
        out[j] = b->y[j];
}

#endif
