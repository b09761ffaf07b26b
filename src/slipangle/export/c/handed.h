/* What a controller leaves to one that plans in its place: state now, its last plan, and the good one that this follows. */
typedef struct {
    const double *now, *u, *x, *kept_u, *kept_x; /* x and kept_x: NULL where the states are others, kept_u: where there is none */
    int age, stopping, kept_age;
} car_handed;

void car_take_over(car_controller *memory, const car_handed *from);
void car_leave(car_controller *memory, car_handed *to);
