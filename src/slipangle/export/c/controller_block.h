/* One vector in, one out, for block diagrams and messages: what car_input has, in its order (NaN where no input applied is
   known), then commands, status, age of the plan, and whether the vehicle should stop. */

#ifndef CAR_BLOCK_H
#define CAR_BLOCK_H

#include "car.h"

#include <string.h>

typedef double car_signal;

#define CAR_BLOCK_PATH (CAR_NODES * CAR_REFERENCES + CAR_EXOGENOUS_ROWS * CAR_EXOGENOUS + 2 * CAR_NODES * CAR_CORRIDOR)
#define CAR_BLOCK_INPUTS (CAR_STATES + CAR_BLOCK_PATH + CAR_CONTROLS)
#define CAR_BLOCK_OUTPUTS (CAR_CONTROLS + 3)
#define CAR_BLOCK_HOLDS 0 /* what is old counts as unknown */

typedef struct {
    car_controller controller;
    car_input input;
    car_output output;
} car_block;

static inline int car_block_start(car_block *b)
{
    memset(&b->input, 0, sizeof b->input);
    return car_start(&b->controller, sizeof b->controller);
}

static inline const car_signal *car_block_take(double *to, const car_signal *from, int n)
{
    for (int i = 0; i < n; i++)
        to[i] = (double)from[i];
    return from + n;
}

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    car_input *to = &b->input;
    in = car_block_take(to->x, in, CAR_STATES);
#if CAR_REFERENCES > 0
    in = car_block_take(to->tracked[0], in, CAR_NODES * CAR_REFERENCES);
#endif
#if CAR_EXOGENOUS > 0
    in = car_block_take(to->exogenous[0], in, CAR_EXOGENOUS_ROWS * CAR_EXOGENOUS);
#endif
#if CAR_CORRIDOR
    in = car_block_take(to->corridor[0], in, 2 * CAR_NODES);
#endif
    (void)car_block_take(to->applied, in, CAR_CONTROLS);
    to->applied_known = 1;
    for (int j = 0; j < CAR_CONTROLS; j++)
        if (to->applied[j] != to->applied[j])
            to->applied_known = 0;
    (void)t;
    (void)car_plan(&b->controller, to, &b->output);
    for (int j = 0; j < CAR_CONTROLS; j++)
        out[j] = b->output.command[j];
    out[CAR_CONTROLS] = b->output.status, out[CAR_CONTROLS + 1] = b->output.age;
    out[CAR_CONTROLS + 2] = b->output.stopping;
}

#endif
