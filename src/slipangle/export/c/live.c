/* A closed loop that drives in a web page: plant, controller, path and speed law, step by step as `closed_loop` has it.
   The page writes the settings, then begins, plans and goes on in turns, and reads the rows. */

#define ROW (9 + USES) /* t, s, e_y, v_x, X, Y, psi, steering that acts, plan that it came from; tire force used */
#define FAR 20.0       /* m from the path: the drive is over */
#define WINDOW 15.0    /* m around the last place on the path, in which the next one is looked for */

enum { GOES_ON, FINISHED, LEFT_PATH, OUT_OF_TIME, NO_NUMBER };

void car_weigh(car_controller *memory, const double *factors);

static double settings[N_SETTINGS], rows[MOST_ROWS][ROW], commands[MOST_PLANS];
static double line[9 * LINE_ROWS];
static double x[PX], acting[PU], held[PU], model_x[CAR_STATES], model_u[MU], place, seen_place, integral, wanted, slope;
static double late[MOST_DELAY + 1];
static int n_rows, n_plans, tick, delayed, next_late;
static car_controller controller;
static car_input given;
static car_output plan;

double *live_settings(void) { return settings; }
const double *live_rows(void) { return rows[0]; }
const double *live_commands(void) { return commands; }
const double *live_predicted(void) { return plan.x[0]; }
int live_count(void) { return n_rows; }
int live_plans(void) { return n_plans; }
int live_age(void) { return plan.age; }

static double within(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

/* Wanted speed at a place: the profile's, or none where the controller wants to stop. [m/s] */
static double speed(double s) { return plan.stopping ? 0 : speed_at(line, SHAPE, SIZE, s); }

static double project(double X, double Y, double near, double window, double *e_y)
{
    double found[3];
    foot(line, SHAPE, SIZE, X, Y, near, window, found);
    *e_y = found[1];
    return found[0];
}

static void note(double e_y)
{
    double *row = rows[n_rows++];
    row[0] = tick * SAMPLE, row[1] = seen_place, row[2] = e_y, row[3] = x[SPEED], row[4] = x[POSE[0]];
    row[5] = x[POSE[1]], row[6] = x[POSE[2]], row[7] = acting[STEERING], row[8] = n_plans - 1;
#if USES > 0
    plant_use(x, acting, settings, row + 9);
#endif
}

/* Starts a drive with the settings as they are now. */
void live_begin(void)
{
    double weights[N_WEIGHTS], e_y;
    memcpy(weights, settings + WEIGHTS, sizeof weights);
    (void)car_start(&controller, sizeof controller);
    car_weigh(&controller, weights);
    memset(&plan, 0, sizeof plan);
    for (int i = 0; i < LINE_ROWS; i++) {
        memcpy(line + 9 * i, LINE + 9 * i, sizeof(double[9]));
        line[9 * i + 4] *= settings[PACE];
    }
    n_rows = n_plans = tick = next_late = 0, integral = 0;
    delayed = (int)within(floor(settings[DELAY] / STEP + 0.5), 0, MOST_DELAY);
    memset(late, 0, sizeof late);
    memset(acting, 0, sizeof acting);
    memset(held, 0, sizeof held);
    plant_start(line + 4, x);
    place = project(x[POSE[0]], x[POSE[1]], 0, -1, &e_y);
    seen_place = place;
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

/* Drive and brake that hold the speed, into the inputs that are held over a sample. */
static void hold_speed(void)
{
    double v_x = x[SPEED], error = wanted - v_x, free = KP * error + integral + FEEDFORWARD * slope;
    double output = within(free, BRAKE_MOST * within(v_x / 0.5, 0, 1), DRIVE_MOST), back = KP > 0 ? KI / KP : 1;
    integral += SAMPLE * (KI * error + back * (output - free));
    for (int j = 0; j < PU; j++)
        held[j] = output * (output >= 0 ? DRIVE[j] : BRAKE[j]);
    held[STEERING] = plan.command[0];
}

static void advance(void)
{
    double next[PX];
    for (int k = 0; k < PER_SAMPLE; k++) {
        late[next_late] = held[STEERING];
        next_late = (next_late + 1) % (MOST_DELAY + 1);
        for (int j = 0; j < PU; j++) {
            int then = (next_late + MOST_DELAY - delayed) % (MOST_DELAY + 1);
            double u = j == STEERING ? late[then] : held[j];
            acting[j] = SHARE[j] < 1 ? acting[j] + SHARE[j] * (u - acting[j]) : u;
        }
        plant_moved(x, acting, settings, next);
        memcpy(x, next, sizeof x);
    }
    tick++;
}

/* Goes on until the next plan is due; whether and why the drive is over. */
int live_go(void)
{
    for (int k = 0; k < PER_PLAN; k++) {
        double e_y, sum = 0;
        for (int i = 0; i < PX; i++)
            sum += x[i];
        if (!(fabs(sum) < INFINITY))
            return NO_NUMBER;
        seen_place = project(x[POSE[0]], x[POSE[1]], seen_place, WINDOW, &e_y);
        note(e_y);
        if (fabs(e_y) > FAR)
            return LEFT_PATH;
        if (seen_place >= SIZE[1])
            return FINISHED;
        if (n_rows >= MOST_ROWS || n_plans >= MOST_PLANS)
            return OUT_OF_TIME;
        hold_speed();
        advance();
    }
    return GOES_ON;
}
