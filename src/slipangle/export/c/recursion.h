/* @TITLE@.
   Written by slipangle; SI units and radians, axes of ISO 8855.

   Takes in one sample at a time and tells the coefficients of the model y = theta phi, whose regressors phi are past outputs,
   inputs and 1. One struct holds all memory; nothing is allocated, no file and no clock is read, and every loop is bounded. */

#ifndef CAR_H
#define CAR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

@COUNTS@
#define CAR_BYTES @BYTES@
#define CAR_DT @DT@ /* time from sample to sample [s] */

/* Outputs. */
@OUTPUTS@
/* Inputs. */
@INPUTS@
/* Regressors. */
@REGRESSORS@

/* Estimates after a sample. */
typedef struct {
    double error[CAR_OUTPUTS];                 /* measured minus predicted output, before the sample counted */
    double theta[CAR_OUTPUTS][CAR_REGRESSORS]; /* coefficients */
    double noise[CAR_OUTPUTS][CAR_OUTPUTS];    /* covariance of the errors, over the same memory */
} car_estimate;

typedef struct {
    int64_t memory[CAR_BYTES / 8];
} car_recursion;

enum { CAR_OK, CAR_TOO_SMALL, CAR_NOT_FINITE, CAR_DIVERGED, CAR_NOT_STARTED };

/* Makes a recursion of `bytes` bytes of memory, sizeof(car_recursion), with the estimate that was exported. A drive begins:
   CAR_LAGS samples fill past outputs and inputs before the next is learned from. */
int car_start(car_recursion *recursion, size_t bytes);

/* Forgets past outputs and inputs but not the estimate, as car_start does: for a new drive or after a gap. */
void car_restart(car_recursion *recursion);

/* Takes in a sample. The estimate is as it was where a number is none, CAR_NOT_FINITE, and where one is so large that the
   estimate would leave the finite numbers, CAR_DIVERGED; CAR_LAGS samples are not learned from after the latter. CAR_NOT_STARTED,
   with NaN, before car_start. */
int car_update(car_recursion *recursion, const double y[CAR_OUTPUTS], const double u[CAR_INPUTS], car_estimate *to);

#ifdef __cplusplus
}
#endif
#endif
