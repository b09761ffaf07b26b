/* How far a position may be off since it was believed last, by errors of speed and yaw rate that no filter knows. [m] */
typedef struct {
    double off;
    car_seconds seen;
} Blind;

static void blind_move(Blind *b, double way, car_seconds now)
{
    b->off += fabs(way) * (WAY_OFF + TURN_OFF * (double)(now - b->seen));
}

/* The position was believed, or is all that is known of a vehicle that stands. */
static void blind_see(Blind *b, car_seconds now) { b->off = 0, b->seen = now; }

