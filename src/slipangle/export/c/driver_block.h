/* One vector in, one out, for block diagrams and messages: what was measured (NaN where nothing was), then commands,
   wanted speed, place along the path, distance to the left of it, and where the commands come from. */

#ifndef CAR_BLOCK_H
#define CAR_BLOCK_H

#include "car.h"

typedef double car_signal;

#define CAR_BLOCK_INPUTS CAR_CHANNELS
#define CAR_BLOCK_OUTPUTS (CAR_COMMANDS + 4)
#define CAR_BLOCK_HOLDS 0 /* what is old counts as not measured */

typedef struct {
    car_driver driver;
    car_measurements measured;
    car_commands commands;
} car_block;

static inline int car_block_start(car_block *b) { return car_start(&b->driver, sizeof b->driver); }

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    const car_commands *c = &b->commands;
    b->measured.t = t;
    for (int i = 0; i < CAR_CHANNELS; i++)
        b->measured.value[i] = (double)in[i];
    (void)car_step(&b->driver, &b->measured, &b->commands);
    for (int i = 0; i < CAR_COMMANDS; i++)
        out[i] = c->value[i];
    out[CAR_COMMANDS] = c->wanted_v_x, out[CAR_COMMANDS + 1] = c->s;
    out[CAR_COMMANDS + 2] = c->e_y, out[CAR_COMMANDS + 3] = c->reason;
}

#endif
