/* Linear feedback of the path errors plus a weighted sum of the curvatures ahead, both by speed. */
static double steer(const double *x, const double (*ahead)[CAR_REFERENCES], double v_x, double last)
{
    double v_y = x[0], r = x[1], dx = x[2] - ahead[0][0], dy = x[3] - ahead[0][1], heading = ahead[0][2];
    double e_y = -dx * sin(heading) + dy * cos(heading), e_psi = remainder(x[4] - heading, WHOLE_TURN);
    double slowest = SPEEDS[0], fastest = SPEEDS[N_SPEEDS - 1], v = v_x < slowest ? slowest : v_x;
    double error[5] = {e_y, v_y + v_x * e_psi, e_psi, r - v_x * ahead[0][3], last}, angle = last;
    int i = 0;
    v = v > fastest ? fastest : v;
    while (i < N_SPEEDS - 2 && SPEEDS[i + 1] < v)
        i++;
    double t = (v - SPEEDS[i]) / (SPEEDS[i + 1] - SPEEDS[i]);
    for (int a = 0; a < 5; a++)
        angle -= ((1 - t) * FEEDBACK[5 * i + a] + t * FEEDBACK[5 * (i + 1) + a]) * error[a];
    for (int k = 0; k < CAR_NODES; k++)
        angle -= ((1 - t) * AHEAD[CAR_NODES * i + k] + t * AHEAD[CAR_NODES * (i + 1) + k]) * ahead[k][3];
    double along = atan2(v_y + FRONT * r, v_x > slowest ? v_x : slowest); /* where the front axle goes */
    angle = angle > along - SLIP ? angle : along - SLIP;
    return angle < along + SLIP ? angle : along + SLIP;
}
