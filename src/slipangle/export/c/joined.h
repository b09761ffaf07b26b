/* All parts of one optimal control problem at once, as car.c needs them: written by slipangle. */

#ifndef CAR_JOINED_H
#define CAR_JOINED_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers per vector, the same in all files of a program: 8, 4, 2, or 1 where the processor has no such vectors. */
@LANES@
typedef struct {
#if defined __GNUC__ || defined __clang__
    __attribute__((aligned(8 * CAR_JOINED_LANES)))
#endif
    int64_t memory[CAR_JOINED_BYTES / 8];
} car_joined;

/* What one part is about, and a guess of its inputs and states, which counts where `begin` says so. */
typedef struct {
    const double *x, *applied, *tracked, *exogenous, *corridor, *inputs, *guess_u, *guess_x;
    int begin;    /* what to start from, as car.c names it */
    int64_t most; /* iterations */
    double seconds;
    double (*clock)(void *);
    void *clock_of;
} car_joined_task;

/* Of the part that is most likely. */
typedef struct {
    const double *u, *x;
    double cost, residual, violation;
    int64_t iterations, begun_anew;
} car_joined_answer;

enum { CAR_JOINED_OK, CAR_JOINED_TOO_SMALL, CAR_JOINED_MISALIGNED };

int car_joined_start(car_joined *joined, size_t bytes);

/* The status, as car.c names it. */
int car_joined_solve(car_joined *joined, const car_joined_task *task, car_joined_answer *answer);

/* What the last solve decided once for all parts. */
const double *car_joined_decided(const car_joined *joined);

#ifdef __cplusplus
}
#endif
#endif
