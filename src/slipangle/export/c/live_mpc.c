/* The controller of a live loop: an MPC that knows the state of the car, and the law that holds the speed. */

void car_weigh(car_controller *memory, const double *factors);

static double model_x[CAR_STATES], model_u[MU], place, integral, wanted, slope;
static car_controller controller;
static car_input given;
static car_output plan;

const double *live_predicted(void) { return plan.x[0]; }
int live_age(void) { return plan.age; }

/* Wanted speed at a place: the profile's, or none where the controller wants to stop. [m/s] */
static double speed(double s) { return plan.stopping ? 0 : speed_at(line, SHAPE, SIZE, s); }

static void begin_deciding(const double *weights)
{
    double e_y;
    (void)car_start(&controller, sizeof controller);
    car_weigh(&controller, weights);
    memset(&plan, 0, sizeof plan);
    integral = 0;
    place = project(x[POSE[0]], x[POSE[1]], 0, -1, &e_y);
    for (int i = 0; i < CAR_STATES; i++)
        model_x[i] = STATES[i] < 0 ? 0 : x[STATES[i]];
}

/* Brings the state of the controller's model to now. */
static void estimate(double *u)
{
    double y[MY], moved[CAR_STATES] = {0}, corrected[CAR_STATES] = {0};
    for (int j = 0; j < MU; j++)
        u[j] = INPUTS[j] >= 0 ? x[INPUTS[j]] : n_plans ? commands[n_plans - 1] : acting[STEERING];
    for (int i = 0; i < MY; i++)
        y[i] = x[OUTPUTS[i]];
    if (n_plans) {
        model_step(model_x, model_u, moved);
        memcpy(model_x, moved, sizeof moved);
    }
    model_correct(model_x, u, y, corrected);
    memcpy(model_x, corrected, sizeof corrected);
}

/* Measures and plans; how the solve ended. */
int live_plan(void)
{
    enum { ROWS = CAR_NODES };
    double ahead[8 * ROWS], u[MU], e_y;
    const double *curvature = ahead + 4 * ROWS, *v = ahead + 5 * ROWS;
    estimate(u);
    place = project(x[POSE[0]], x[POSE[1]], place, WINDOW, &e_y);
    double off = x[SPEED] - speed_at(line, SHAPE, SIZE, place);
    line_ahead(line, SHAPE, SIZE, place, 0, off, COUNTS, STRIDES, ROWS, ahead);
    memcpy(given.x, model_x, sizeof given.x);
    for (int k = 0; k < ROWS; k++) {
#if CAR_REFERENCES > 0
        for (int p = 0; p < CAR_REFERENCES; p++) {
            int of = REFERENCES[p];
            given.tracked[k][p] = of == YAW_RATE ? curvature[k] * v[k] : of >= 0 ? ahead[of * ROWS + k] : 0;
        }
#endif
#if CAR_EXOGENOUS > 0
        int at = k < ROWS - 1 ? k : ROWS - 2;
        for (int w = 0; w < CAR_EXOGENOUS && k < CAR_EXOGENOUS_ROWS; w++)
            given.exogenous[k][w] =
                EXOGENOUS[w] >= 0 ? ahead[EXOGENOUS[w] * ROWS + k] : (v[at + 1] - v[at]) / (TIMES[at + 1] - TIMES[at]);
#endif
#if CAR_CORRIDOR
        given.corridor[k][0] = ahead[6 * ROWS + k], given.corridor[k][1] = ahead[7 * ROWS + k];
#endif
    }
    int status = car_plan(&controller, &given, &plan);
    if (n_plans < MOST_PLANS)
        commands[n_plans++] = plan.command[0];
    memcpy(model_u, u, sizeof model_u);
    for (int j = 0; j < MU; j++)
        if (INPUTS[j] < 0)
            model_u[j] = plan.command[0];
    wanted = speed(place);
    slope = (speed(place + 0.5) - speed(place - 0.5)) * wanted;
    return status;
}

/* Steering, and drive and brake that hold the speed, into the inputs that are held over a sample. */
static void command(int since)
{
    (void)since;
    double v_x = x[SPEED], error = wanted - v_x, free = KP * error + integral + FEEDFORWARD * slope;
    double output = within(free, BRAKE_MOST * within(v_x / 0.5, 0, 1), DRIVE_MOST), back = KP > 0 ? KI / KP : 1;
    integral += SAMPLE * (KI * error + back * (output - free));
    for (int j = 0; j < PU; j++)
        held[j] = output * (output >= 0 ? DRIVE[j] : BRAKE[j]);
    held[STEERING] = plan.command[0];
}
