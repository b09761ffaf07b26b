/* @TITLE@.
   Written by slipangle; SI units and radians, axes of ISO 8855.

   One struct holds all memory; nothing is allocated, no file and no clock is read, and every loop is bounded. A plan is
   always finite and within limits and rates, whatever is given. Ranges are those beyond which a value is taken for a
   fault. */

#ifndef CAR_H
#define CAR_H

#include <stddef.h>
#include <stdint.h>

@INCLUDED@#ifdef __cplusplus
extern "C" {
#endif

/* Numbers per vector, the same in all files of a program: 8, 4, 2, or 1 where the processor has no such vectors. */
@LANES@
@COUNTS@
#define CAR_DT @DT@ /* time from plan to plan [s] */

typedef double car_seconds; /* of a clock */

/* Entries of the state. */
@STATES@
/* Decided inputs, with their limits, and those of their rates. */
@CONTROLS@
/* Columns of the reference. */
@REFERENCES@
/* Columns of the exogenous inputs. */
@EXOGENOUS@
@DECIDED@

/* Nodes are at these times from now [s]: @TIMES@. */
typedef struct {
    double x[CAR_STATES]; /* state now */
#if CAR_REFERENCES > 0
    double tracked[CAR_NODES][CAR_REFERENCES]; /* what is wanted */
#endif
#if CAR_EXOGENOUS > 0
    double exogenous[CAR_EXOGENOUS_ROWS][CAR_EXOGENOUS]; /* what is known of inputs that are not decided */
#endif
#if CAR_CORRIDOR
    double corridor[CAR_NODES][2]; /* distance of the right and of the left edge from the path [m] */
#endif
    double inputs[CAR_HORIZON][CAR_CONTROLS]; /* wanted inputs, zero as a rule */
    double applied[CAR_CONTROLS];             /* inputs applied over the step before, if */
    int applied_known;                        /* is not 0; else those of the plan before */
} car_input;

enum {
    CAR_SOLVED,          /* optimal within tolerance */
    CAR_REAL_TIME,       /* real-time iterations: not converged, but the residuals are small */
    CAR_ITERATION_LIMIT, /* the iteration limit was reached before the optimum */
    CAR_STALLED,         /* no further progress was possible before the optimum */
    CAR_TIME_OUT,        /* the deadline passed before the optimum */
    CAR_INFEASIBLE,      /* no input was found that keeps all hard limits from this state */
    CAR_NOT_FINITE,      /* state, reference or prediction is NaN or infinite */
    CAR_FAILED,          /* the solver stopped without an answer */
    CAR_IMPLAUSIBLE,     /* state or reference lies far outside what it can be */
    CAR_NOT_STARTED      /* car_start was forgotten: inputs stay where they are */
};

#if CAR_LEARNS
enum {
    CAR_LEARNED,    /* the sample was learned from */
    CAR_WAITING,    /* there is no sample before this one */
    CAR_QUIET,      /* the regressors say next to nothing new */
    CAR_SURPRISING, /* the prediction error is far outside its usual size */
    CAR_SATURATED,  /* the lateral acceleration is beyond the range in which a linear model holds */
    CAR_OUTSIDE,    /* the speed is outside the models' range */
    CAR_DOUBTFUL    /* the coefficients would have left the region that is trusted, so they stay */
};
#endif

/* Since car_start: plans asked for; those that were no solution, and how many in a row up to now; those that took longer
   than the deadline, and how many in a row up to now; those that began anew. */
typedef struct {
    int64_t plans, fallbacks, fallbacks_in_a_row, overruns, overruns_in_a_row, begun_anew;
} car_health;

typedef struct {
    double command[CAR_CONTROLS];             /* to be applied now */
    double u[CAR_HORIZON][CAR_CONTROLS];      /* over the horizon */
    double x[CAR_NODES][CAR_STATES];          /* predicted states */
#if CAR_DECIDED > 0
    double decided[CAR_DECIDED];              /* once for the whole horizon; NaN of a fallback */
#endif
    double cost, residual, violation;         /* NaN of a fallback */
    double seconds;                           /* by the caller's clock; 0 without */
    int status;                               /* how the solve ended, one of the above */
    int age;                                  /* 0: a solution; k: a fallback, the k-th in a row */
    int stopping;                             /* the stop law, as no recent plan is left: the speed should go to zero */
    int iterations;
    int begun_anew;                           /* what was planned before led nowhere: the solve began anew */
#if CAR_SWITCHES
    double demand; /* share of grip that is needed */
    int active;    /* 0: the calm controller planned, 1: the one for the limit; states of the other one are NaN */
#endif
#if CAR_LEARNS
    int lesson;      /* what was made of this sample, one of the above */
    int64_t samples; /* that have been learned from */
#endif
    car_health health;
} car_output;

typedef struct {
#if defined __GNUC__ || defined __clang__
    __attribute__((aligned(8 * CAR_LANES)))
#endif
    int64_t memory[CAR_BYTES / 8];
@SOLVER@} car_controller;

enum { CAR_OK, CAR_TOO_SMALL, CAR_MISALIGNED };

/* Makes a controller of `bytes` bytes of memory, sizeof(car_controller); CAR_OK, or why not. Call it once, and again for
   a new drive. */
int car_start(car_controller *controller, size_t bytes);

/* Bounds the work of a plan: the most iterations towards an optimum (0: as it was exported) and, where there is a clock,
   the longest time [s] (0: any; below 0 or NaN: none is left, and the plan before goes on as it would without a solution).
   The clock counts seconds and is asked with `of`; one that goes back, or says no number, bounds nothing in that plan.
   car_start forgets all of it: call this after it. */
void car_deadline(car_controller *controller, int iterations, car_seconds seconds, car_seconds (*clock)(void *), void *of);

/* Plans from the state now; returns the status. */
int car_plan(car_controller *controller, const car_input *input, car_output *output);

#ifdef __cplusplus
}
#endif
#endif
