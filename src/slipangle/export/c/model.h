/* @TITLE@.
   Written by slipangle; SI units and radians, axes of ISO 8855.

   A discrete-time state space: the state x at a sample belongs to that sample, y = output(x, u), and a step leads to the
   state of the next one. The functions keep nothing between calls; nothing is allocated, no file and no clock is read. */

#ifndef CAR_H
#define CAR_H

#ifdef __cplusplus
extern "C" {
#endif

@COUNTS@
#define CAR_DT @DT@ /* time from sample to sample [s] */

/* Entries of the state, with where a recorded drive has it at its start. */
@STATES@
/* Inputs. */
@INPUTS@
/* Outputs. */
@OUTPUTS@

/* State one sample later, the inputs held; `next` must be other memory than x. */
void car_step(const double x[CAR_STATES], const double u[CAR_INPUTS_SIZE], double next[CAR_STATES]);

/* Outputs at the same sample. */
void car_output(const double x[CAR_STATES], const double u[CAR_INPUTS_SIZE], double y[CAR_OUTPUTS]);

/* State after measuring y at the same sample; `corrected` must be other memory than x. */
void car_correct(const double x[CAR_STATES], const double u[CAR_INPUTS_SIZE], const double y[CAR_OUTPUTS],
                 double corrected[CAR_STATES]);

#ifdef __cplusplus
}
#endif
#endif
