/* Onto the circle through the rear axle, tangent to the vehicle, and a point ahead on the path. */
static double steer(const double *x, const double (*ahead)[CAR_REFERENCES], double v_x, double last)
{
    double X = x[0] - REAR * cos(x[2]), Y = x[1] - REAR * sin(x[2]), psi = x[2];
    double wanted = LOOK_AHEAD * fabs(v_x), before = 0, distance = 0;
    int k = 0;
    if (wanted < SHORTEST)
        wanted = SHORTEST;
    for (; k < CAR_NODES; k++) {
        before = distance;
        distance = hypot(ahead[k][0] - X, ahead[k][1] - Y);
        if (distance >= wanted)
            break;
    }
    int far = k < CAR_NODES;
    if (!far)
        k = CAR_NODES - 1;
    double x1 = ahead[k][0], y1 = ahead[k][1];
    if (far && k > 0 && distance > before) { /* between two rows */
        double t = (wanted - before) / (distance - before);
        x1 = ahead[k - 1][0] + t * (ahead[k][0] - ahead[k - 1][0]);
        y1 = ahead[k - 1][1] + t * (ahead[k][1] - ahead[k - 1][1]);
        distance = wanted;
    }
    double eta = remainder(atan2(y1 - Y, x1 - X) - psi, WHOLE_TURN);
    (void)last;
    return atan2(2 * WHEELBASE * sin(eta), distance > 0.1 ? distance : 0.1);
}
