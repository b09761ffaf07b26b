/* Steering for the curvature ahead by the understeer gradient, and towards the path. */

/* By how much the lateral acceleration follows the steering late. [s] */
static double response(double v)
{
    double stiffness = COUPLED / (v * v) + TURNING, late = LONGEST;
    if (stiffness > 0) {
        late = DAMPED / v / stiffness - REAR / v;
        late = late > 0 ? late : 0;
        late = late < LONGEST ? late : LONGEST;
    }
    return late;
}

static double curvature_at(const double (*ahead)[CAR_REFERENCES], double t)
{
    int j = 0;
    if (t >= TIMES[CAR_NODES - 1])
        return ahead[CAR_NODES - 1][3];
    while (j < CAR_NODES - 2 && TIMES[j + 1] <= t)
        j++;
    double slope = (ahead[j + 1][3] - ahead[j][3]) / (TIMES[j + 1] - TIMES[j]);
    return slope * (t - TIMES[j]) + ahead[j][3];
}

static double steer(const double *x, const double (*ahead)[CAR_REFERENCES], double v_x, double last)
{
    double v = v_x > SLOWEST ? v_x : SLOWEST, heading = ahead[0][2], curvature = curvature_at(ahead, LEAD + response(v));
    double length = WHEELBASE + UNDERSTEER * (v * v), least = SHORTEST * WHEELBASE;
    double e_y = -(x[2] - ahead[0][0]) * sin(heading) + (x[3] - ahead[0][1]) * cos(heading);
    double beta = (REAR - SLIPPING * (v * v)) * ahead[0][3];
    double course = remainder(x[4] - heading, WHOLE_TURN) + beta;
    double gain = BANDWIDTH * BANDWIDTH * (length > least ? length : least) / (v * v);
    double far = 2 * DAMPING * v / BANDWIDTH + LEAD * v;
    (void)last;
    return length * curvature - gain * (e_y + far * course);
}
