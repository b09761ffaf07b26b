/* One vector in, one out, for block diagrams and messages: what was measured (NaN where nothing was), then commands,
   wanted speed, place along the path, distance to the left of it, and where the commands come from.

   It counts time from its first call, by whatever clock. Where that is set back or says what is no time, CAR_DT has passed
   as between any two calls: the vehicle is driven on, and CAR_BLOCK_CLOCK_SET counts it. Where it is set ahead, that is a
   gap to the driver. */

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
    car_seconds zero, now; /* by the clock, at the first call; since then */
    int64_t set;           /* how often the clock was set */
    int begun, clocked;
} car_block;

#define CAR_BLOCK_CLOCK_SET(b) ((b)->set)
#define CAR_BLOCK_LATEST ((car_seconds)1e10) /* s by a clock */
#define CAR_BLOCK_LONGEST ((car_seconds)1e9) /* s of a drive */

static inline int car_block_start(car_block *b)
{
    b->zero = 0, b->now = 0, b->set = 0, b->begun = 0, b->clocked = 0;
    return car_start(&b->driver, sizeof b->driver);
}

/* Time since the first call. */
static inline car_seconds car_block_time(car_block *b, car_seconds t)
{
    car_seconds next = b->begun ? b->now + (car_seconds)CAR_DT : 0, now = t - b->zero;
    int number = t >= -CAR_BLOCK_LATEST && t <= CAR_BLOCK_LATEST;
    if (!(number && b->clocked && now >= b->now && now <= CAR_BLOCK_LONGEST)) {
        b->set += b->clocked || !number;
        if (number)
            b->zero = t - next, b->clocked = 1;
        now = next;
    }
    b->begun = 1;
    return now;
}

static inline void car_block_step(car_block *b, car_signal t, const car_signal *in, car_signal *out)
{
    const car_commands *c = &b->commands;
    b->measured.t = b->now = car_block_time(b, (car_seconds)t);
    for (int i = 0; i < CAR_CHANNELS; i++)
        b->measured.value[i] = (double)in[i];
    (void)car_step(&b->driver, &b->measured, &b->commands);
    for (int i = 0; i < CAR_COMMANDS; i++)
        out[i] = c->value[i];
    out[CAR_COMMANDS] = c->wanted_v_x, out[CAR_COMMANDS + 1] = c->s;
    out[CAR_COMMANDS + 2] = c->e_y, out[CAR_COMMANDS + 3] = c->reason;
}

#endif
