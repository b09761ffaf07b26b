/* The law, asked about the state when its steering acts, and what it lacks in steady driving. */

/* The law's angle at the steering wheel. */
static double answer(const double *x, const double (*ahead)[CAR_REFERENCES], double v_x, double before)
{
    return follow(x, ahead, v_x, LAW_GAIN * (before - LAW_OFFSET)) / LAW_GAIN + LAW_OFFSET;
}

/* The state after so many steps as the steering is late, held as it is. */
static void later(const double *x, double delta, double v_x, double *state)
{
    double u[MODEL_INPUTS], next[CAR_STATES] = {0};
    memcpy(state, x, sizeof next);
    for (int j = 0; j < MODEL_INPUTS; j++)
        u[j] = j == STEERING ? delta : v_x;
    for (int k = 0; k < LEAD_STEPS; k++) {
        model_step(state, u, next);
        memcpy(state, next, sizeof next);
    }
}

/* Lateral velocity and steering that keep the car on a bend, pushed as it is. */
static void steady(double v_x, double r, const double *x, double *slip, double *steering)
{
    int i = 0;
    double v = v_x > STEADY_SPEEDS[0] ? v_x : STEADY_SPEEDS[0], *to[2] = {slip, steering};
    v = v < STEADY_SPEEDS[N_STEADY - 1] ? v : STEADY_SPEEDS[N_STEADY - 1];
    while (i < N_STEADY - 2 && STEADY_SPEEDS[i + 1] <= v)
        i++;
    double share = (v - STEADY_SPEEDS[i]) / (STEADY_SPEEDS[i + 1] - STEADY_SPEEDS[i]);
    for (int what = 0; what < 2; what++) {
        const double *low = STEADY + (2 * i + what) * N_TERMS, *high = low + 2 * N_TERMS;
        double sum = (1 - share) * low[0] + share * high[0] + ((1 - share) * low[1] + share * high[1]) * r;
        for (int k = 2; k < N_TERMS; k++)
            sum += ((1 - share) * low[k] + share * high[k]) * x[PUSHES[k - 2]];
        *to[what] = sum;
    }
}

static double steer(const double *x, const double (*ahead)[CAR_REFERENCES], double v_x, double before)
{
    const double(*rows)[CAR_REFERENCES] = ahead + LEAD_STEPS;
    double state[CAR_STATES], seen[LAW_STATES], target[LAW_STATES], bend[LAW_NODES][CAR_REFERENCES], slip, steering;
    double psi = rows[0][2], curvature = rows[0][3], v = v_x > 1e-3 ? v_x : 1e-3;
    later(x, before, v_x, state);
    steady(v_x, v_x * curvature, x, &slip, &steering);
    const double known[] = {rows[0][0], rows[0][1], psi - atan2(slip, v), slip, v_x * curvature};
    for (int a = 0; a < LAW_STATES; a++)
        seen[a] = state[SEEN[a]], target[a] = known[TARGET[a]];
    for (int k = 0; k < LAW_NODES; k++) {
        double along = v_x * STEP * (double)k, half = 0.5 * (curvature * along);
        double chord = half != 0 ? along * (sin(half) / half) : along;
        bend[k][0] = rows[0][0] + chord * cos(psi + half), bend[k][1] = rows[0][1] + chord * sin(psi + half);
        bend[k][2] = psi + curvature * along, bend[k][3] = curvature, bend[k][4] = rows[k][4];
    }
    double held = steering > -LIMIT ? steering : -LIMIT;
    held = held < LIMIT ? held : LIMIT;
    return answer(seen, rows, v_x, before) + steering - answer(target, (const double(*)[CAR_REFERENCES])bend, v_x, held);
}
