/* @TITLE@.
   Written by slipangle; SI units and radians, axes of ISO 8855.

   From measurements to commands: an estimator finds the state of the vehicle and what pushes it, a controller plans along the
   path. One struct holds all memory; nothing is allocated, no file and no clock is read, and every loop is bounded.
   Commands are always finite and within limits, whatever is given. Ranges are those beyond which a measurement is taken
   for a fault. */

#ifndef CAR_H
#define CAR_H

#include "car_planner.h"
@INCLUDED@
#ifdef __cplusplus
extern "C" {
#endif

@COUNTS@
#define CAR_BYTES @BYTES@ /* beside those of the controller */
#define CAR_DT @DT@ /* @WHEN@ */

typedef double car_seconds; /* of a clock */

/* What may be measured. */
@CHANNELS@
/* Commands. */
@COMMANDS@
/* Entries of the estimated state. */
@STATES@
/* Outputs that the estimator takes in, with the standard deviation of their noise and how late they are taken to be. */
@OUTPUTS@

typedef struct {
    car_seconds t;              /* time of the call, at most 1e10, which Unix time is [s] */
    double value[CAR_CHANNELS]; /* NaN: not measured now; what reads exactly as before is not new either */
} car_measurements;

/* Where commands come from. */
enum {
    CAR_PLANNED,       /* a plan; its status says how that was found */
    CAR_SPEED_UNKNOWN, /* the wheels stay where they are: no speed was measured yet */
    CAR_STANDING,      /* the wheels stay where they are: the vehicle stands or creeps */
    CAR_POSE_UNKNOWN,  /* the wheels stay where they are: no pose was measured yet */
    CAR_LOST,          /* the position is not known any more: the vehicle should stop, as for the next six */
    CAR_SPEED_LOST,    /* the speed was not measured for a second */
    CAR_CONTRADICTED,  /* speed and positions contradict each other */
    CAR_TURN_CONTRADICTED, /* yaw rate and headings do */
    CAR_ENDED,         /* the path has ended */
    CAR_FACING_AWAY,   /* the vehicle faces away from the path */
    CAR_RECEDING,      /* the vehicle is far beside the path and gets ever farther */
    CAR_BESIDE         /* a plan, far beside the path */
};

typedef struct {
    double value[CAR_COMMANDS];
    double wanted_v_x;            /* speed that the vehicle should have; 0: it should stop [m/s] */
    double s, e_y;                /* place on the path, and how far the vehicle is to the left of it, as estimated [m] */
    double state[CAR_STATES];     /* estimated */
    double state_std[CAR_STATES]; /* their standard deviations; infinite where nothing is known */
    double age[CAR_OUTPUTS];      /* how long ago each output was measured and believed; NaN: never [s] */
    int64_t restarts;             /* how often the estimator had to start anew */
    int reason;                   /* one of the above */
    int planned;                  /* 0: there is no plan, and the next four say nothing */
    int status, plan_age, stopping; /* as in car_planner_output */
    car_planner_health health;
} car_commands;

typedef struct {
    car_planner_controller planner;
@WINDOW@    int64_t memory[CAR_BYTES / 8];
} car_driver;

enum { CAR_OK, CAR_TOO_SMALL, CAR_MISALIGNED, CAR_WRONG_TIME, CAR_NOT_STARTED };

/* Makes a driver of `bytes` bytes of memory, sizeof(car_driver); CAR_OK, or why not. Call it once, and again for a new
   drive. */
int car_start(car_driver *driver, size_t bytes);

/* Bounds the work of a plan, as car_planner_deadline does; car_start forgets it: call this after it. */
void car_deadline(car_driver *driver, int iterations, car_seconds seconds, car_seconds (*clock)(void *), void *of);

/* Takes in what was measured and says what to do; CAR_WRONG_TIME, with the commands as they were, where time is no number,
   beyond 1e10 s or before that of the last call: these are old then, a position that is lost before the first, and the
   vehicle should stop. CAR_NOT_STARTED, with commands of zero and a position that is lost, before car_start. */
int car_step(car_driver *driver, const car_measurements *measured, car_commands *commands);

/* The last plan; all zero before the first. */
const car_planner_output *car_last_plan(const car_driver *driver);
@MORE@
#ifdef __cplusplus
}
#endif
#endif
