/* Along the path and towards it, seen from the front axle. */
static double steer(const double *x, const double (*ahead)[CAR_REFERENCES], double v_x, double last)
{
    double r = x[1], psi = x[4], front_x = x[2] + FRONT * cos(psi), front_y = x[3] + FRONT * sin(psi), least = INFINITY;
    int k = 0;
    for (int i = 0; i < CAR_NODES; i++) {
        double distance = hypot(ahead[i][0] - front_x, ahead[i][1] - front_y);
        if (distance < least)
            least = distance, k = i;
    }
    double dx = front_x - ahead[k][0], dy = front_y - ahead[k][1], angle = ahead[k][2], curvature = ahead[k][3];
    double along = dx * cos(angle) + dy * sin(angle);
    double e = -dx * sin(angle) + dy * cos(angle) - 0.5 * curvature * along * along;
    double e_psi = remainder(angle + curvature * along - psi, WHOLE_TURN);
    double pull = atan2(-PULL * e, SOFTENING + fabs(v_x));
    (void)last;
    return e_psi + pull + DAMPING * (curvature * v_x - r);
}
