/* @TITLE@.
   Written by slipangle; SI units and radians, axes of ISO 8855.

   Takes in one sample at a time and tells the state and how sure it is. One struct holds all memory; nothing is allocated,
   no file and no clock is read, and every loop is bounded. */

#ifndef CAR_H
#define CAR_H

#include <stddef.h>
#include <stdint.h>
@INCLUDED@
#ifdef __cplusplus
extern "C" {
#endif

@COUNTS@
#define CAR_BYTES @BYTES@
#define CAR_DT @DT@ /* time from sample to sample [s] */
#define CAR_START {@START@} /* state at the start of the recorded drive */

/* Entries of the state. */
@STATES@
/* Measured outputs, with the standard deviation of their noise and how late they are taken to be. */
@OUTPUTS@
/* Inputs. */
@INPUTS@
/* Estimated parameters. */
@PARAMETERS@
/* Outputs whose sensor has an estimated offset. */
@BIASES@

typedef struct {
    double y[CAR_OUTPUTS];     /* NaN: not measured at this sample; one that is late counts for a sample before */
    double u[CAR_INPUTS_SIZE]; /* finite numbers */
} car_sample;

/* Estimates after a sample, with their standard deviations. */
typedef struct {
    double state[CAR_STATES], state_std[CAR_STATES];
    double innovation[CAR_OUTPUTS], innovation_std[CAR_OUTPUTS]; /* measured less predicted output; NaN: not measured */
#if CAR_PARAMETERS > 0
    double parameter[CAR_PARAMETERS], parameter_std[CAR_PARAMETERS];
#endif
#if CAR_BIASES > 0
    double bias[CAR_BIASES], bias_std[CAR_BIASES];
#endif
    int taken[CAR_OUTPUTS]; /* measured, and no outlier */
@FAILURES@} car_estimate;

typedef struct {
@WINDOW@    int64_t memory[CAR_BYTES / 8];
} car_estimator;

enum { CAR_OK, CAR_TOO_SMALL, CAR_NOT_FINITE, CAR_DIVERGED, CAR_MISALIGNED, CAR_NOT_STARTED };

/* Makes an estimator of `bytes` bytes of memory, sizeof(car_estimator), before its first sample; x is the state that is
   expected there. CAR_OK, or why not. */
int car_start(car_estimator *estimator, size_t bytes, const double x[CAR_STATES]);

/* Forgets the state but neither parameters nor offsets: for a new drive or after a gap; x is the state expected next.
   CAR_OK, or why it stays as it is. */
int car_restart(car_estimator *estimator, const double x[CAR_STATES]);

/* Takes in a sample. CAR_NOT_FINITE where an input or the expected state is no number, CAR_DIVERGED where the estimate
   would leave the finite numbers; the estimate is as before then. CAR_NOT_STARTED, with NaN, before car_start. */
int car_update(car_estimator *estimator, const car_sample *sample, car_estimate *estimate);

#ifdef __cplusplus
}
#endif
#endif
