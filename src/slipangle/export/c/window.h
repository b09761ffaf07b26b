/* The last samples as an optimal control problem, as car.c needs it: written by slipangle. */

#ifndef CAR_WINDOW_H
#define CAR_WINDOW_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers per vector, the same in all files of a program: 8, 4, 2, or 1 where the processor has no such vectors. */
@LANES@
typedef struct {
#if defined __GNUC__ || defined __clang__
    __attribute__((aligned(8 * CAR_WINDOW_LANES)))
#endif
    int64_t memory[CAR_WINDOW_BYTES / 8];
} car_window;

/* What the problem is made of: the estimate before, what is known at each node; and a guess, which becomes the answer. */
typedef struct {
    double *before, *given, *u, *x;
} car_window_parts;

enum { CAR_WINDOW_OK, CAR_WINDOW_TOO_SMALL, CAR_WINDOW_MISALIGNED };

int car_window_start(car_window *window, size_t bytes);

car_window_parts car_window_at(car_window *window);

/* 1 where there is a solution, else 0. */
int car_window_solve(car_window *window);

#ifdef __cplusplus
}
#endif
#endif
