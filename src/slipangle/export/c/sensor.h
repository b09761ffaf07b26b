/* @TITLE@.
   Written by slipangle; SI units and radians, axes of ISO 8855.

   Takes in one sample at a time and tells the lateral velocity of the centre of gravity, learned from a log in which it was
   measured. It says nothing, NaN, in the first samples, below @SLOWEST@ m/s, and as long as one of the last @NEEDED@ samples lacks
   a channel or is unlike those that it has learned from. One struct holds all memory; nothing is allocated, no file and no
   clock is read, and every loop is bounded. */

#ifndef CAR_H
#define CAR_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define CAR_CHANNELS 4
#define CAR_BYTES @BYTES@
#define CAR_DT @DT@ /* time from sample to sample [s] */
#define CAR_SIDE_SLIP_STD @STD@ /* standard deviation of the side slip angle, on stretches not learned from [rad] */

/* Measured channels. */
@CHANNELS@

/* What is said of a sample; NaN where nothing. */
typedef struct {
    double v_y;       /* lateral velocity [m/s] */
    double side_slip; /* the angle whose tangent is v_y over v_x [rad] */
} car_estimate;

typedef struct {
    int64_t memory[CAR_BYTES / 8];
} car_sensor;

enum { CAR_OK, CAR_TOO_SMALL, CAR_SILENT, CAR_NOT_STARTED };

/* Makes a sensor of `bytes` bytes of memory, sizeof(car_sensor), before its first sample. */
int car_start(car_sensor *sensor, size_t bytes);

/* Forgets all samples: after a gap. */
void car_restart(car_sensor *sensor);

/* Takes in a sample, NaN for what was not measured; CAR_SILENT where nothing can be said,
   CAR_NOT_STARTED before car_start. */
int car_update(car_sensor *sensor, const double channels[CAR_CHANNELS], car_estimate *to);

#ifdef __cplusplus
}
#endif
#endif
