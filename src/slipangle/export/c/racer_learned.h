/* What a racer learned in whole laps; sectors are corners with half of the straights beside them, in order. */
typedef struct {
    int64_t laps;                  /* that it crossed the start line after */
    double grip, grip_std;         /* of the tires over the believed one, of the last lap, and its standard deviation */
    double faster[CAR_SECTORS];    /* speed over that of the lap, less one */
    double narrower[CAR_SECTORS];  /* room that is kept from the edges beside the margin [m] */
} car_learned;

/* What is known by now; all zero before car_start. */
void car_learned_by_now(const car_driver *driver, car_learned *to);
