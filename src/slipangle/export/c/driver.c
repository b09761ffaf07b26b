/* From measurements to commands. The same decisions as those of `Driver.step`. */

#define LONGEST_GAP 1.0 /* s between two calls, after which the estimator starts anew */
#define QUARTER ((car_seconds)0.25)

@WATCH@
typedef struct {
    Filter filter;
    double raw[CAR_CHANNELS]; /* what each channel read last, NaN before */
    double pending[NY];       /* outputs measured since the last sample of the filter, NaN where there are none */
    double read[NY];          /* what each output read when it was taken in last */
    double inputs[NU], v_x, s, integral, output, steered, surprise;
    car_seconds v_at, seen[NY], t0, now;
    int64_t started, tick, jumps, restarts;
    int tracking, planned, begun, iterations;
    double seconds;
    car_seconds (*clock)(void *);
    void *of;
    car_planner_input given;
    car_planner_output plan;
    car_commands last;
    Watch watch;
} Driver;

@MEMORY@
/* Whole samples in a time, a quarter of one before it is over. */
static int64_t ticks(car_seconds t)
{
    car_seconds n = t / PERIOD + QUARTER, whole = (car_seconds)(int64_t)n;
    return (int64_t)n - (n < whole);
}

int car_start(car_driver *memory, size_t bytes)
{
    Driver *d = own(memory);
    int code = bytes < sizeof *memory ? CAR_TOO_SMALL : car_planner_start(&memory->planner, sizeof memory->planner);
    if (code != CAR_OK)
        return code;
#ifdef HORIZON
    if (car_window_start(&memory->window, sizeof memory->window) != CAR_WINDOW_OK)
        return CAR_MISALIGNED;
#endif
    memset(d, 0, sizeof *d);
    for (int i = 0; i < CAR_CHANNELS; i++)
        d->raw[i] = NAN;
    for (int i = 0; i < NY; i++)
        d->pending[i] = NAN, d->seen[i] = NAN;
    d->v_x = d->s = NAN, d->tick = -1;
    d->started = STARTED;
    say_nothing(&d->last);
    watch_begin(&d->watch);
#ifdef TRUSTED
    d->surprise = UNKNOWN;
#endif
    return CAR_OK;
}

/* ---- measurements ---------------------------------------------------------------------------------------------- */

/* Whether a value is in the range of its channel; a speed also whether a vehicle can have changed it so much. */
static int believed(Driver *d, int channel, const double *values, car_seconds t)
{
    double value = values[channel];
    if (!(value >= LOWEST[channel] && value <= HIGHEST[channel]))
        return 0;
    if (channel != SPEED || d->v_x != d->v_x)
        return 1;
    int jump = fabs(value - d->v_x) > JUMP + MOST * (double)(t - d->v_at);
    d->jumps = jump ? d->jumps + 1 : 0;
    return !jump || d->jumps > PATIENCE;
}

/* How fast a part of the pose changes now; of other outputs it is not known. [per s] */
static double rate(const Driver *d, int output)
{
    double later[NX];
    int a = POSE_OF_OUTPUT[output];
    if (a < 0 || !d->tracking)
        return 0;
    model_step(d->filter.now.z, d->filter.now.before, later);
    return (later[a] - d->filter.now.z[a]) / CAR_DT;
}

/* Notes new values; a pose is moved to the sample of the filter that it will count for. */
static void gather(Driver *d, const double *value, car_seconds t, int64_t tick)
{
    for (int c = 0; c < CAR_CHANNELS; c++) {
        int same = d->raw[c] == value[c];
        if (!same && !believed(d, c, value, t))
            continue;
        d->watch.told[c] = t;
        if (same)
            continue;
        d->raw[c] = value[c];
        if (c == SPEED)
            d->v_x = value[c], d->v_at = t;
        for (int j = 0; j < NU; j++)
            if (INPUTS[j] == c && j != STEERING)
                d->inputs[j] = value[c];
        for (int i = 0; i < NY; i++)
            if (OUTPUTS[i] == c) {
                car_seconds at = d->t0 + (car_seconds)(tick - LATE[i]) * PERIOD, off = at - (t - (car_seconds)LATE_SECONDS[i]);
                d->pending[i] = value[c] + (double)off * rate(d, i);
            }
    }
}

/* ---- estimate -------------------------------------------------------------------------------------------------- */

static double known(const Driver *d, int channel)
{
    return channel < 0 ? NAN : channel == INPUTS[STEERING] ? d->steered : d->raw[channel];
}

/* Starts the filter where the last measurements say the vehicle is. */
static void start_filter(Driver *d)
{
    double x[NX];
    for (int a = 0; a < NX; a++) {
        double said = known(d, STATES[a]);
        x[a] = said == said ? said : known(d, PLAIN[a]);
    }
    filter_begin(&d->filter, x);
    for (int i = 0; i < NY; i++)
        d->read[i] = BEGUN[i] >= 0 ? x[BEGUN[i]] : NAN; /* what a state began at is not taken in again */
    d->tracking = 1, d->planned = 0, d->s = NAN;
}

/* Takes in the inputs now and, where `fresh`, what was measured; what reads exactly as before is held by its instrument. */
static int take(Driver *d, int fresh)
{
    double y[NY], u[NU];
    for (int j = 0; j < NU; j++)
        u[j] = j == STEERING ? d->steered : d->inputs[j];
    for (int i = 0; i < NY; i++) {
        int j = SAME_INPUT[i], waits = fresh && d->pending[i] == d->pending[i];
        y[i] = waits ? d->pending[i] : j >= 0 ? u[j] : NAN;
        if (waits && j >= 0)
            u[j] = d->pending[i];
        if (y[i] == d->read[i])
            y[i] = NAN;
        if (y[i] == y[i])
            d->read[i] = y[i];
    }
    return filter_take(&d->filter, y, u);
}

/* Brings the estimate to now, `behind` samples after the last; what hinders, CAR_PLANNED if nothing does. */
static int observe(Driver *d, int64_t behind)
{
    int X = OUTPUT_OF_POSE[0], Y = OUTPUT_OF_POSE[1], stale = !speed_known(&d->watch, d->now);
    int posed = X >= 0 && Y >= 0 && d->pending[X] == d->pending[X] && d->pending[Y] == d->pending[Y];
    watch_move(&d->watch, d->now, d->v_x, (double)behind * CAR_DT, posed, d->raw[POSE[0]], d->raw[POSE[1]]);
    double r = TURN_RATE >= 0 ? d->raw[TURN_RATE >= 0 ? TURN_RATE : 0] : NAN;
    int heading = OUTPUT_OF_POSE[2], headed = heading >= 0 && d->pending[heading] == d->pending[heading];
    watch_turn(&d->watch, d->now, r, (double)behind * CAR_DT, headed, d->raw[POSE[2]]);
    double moving = stale && !d->tracking ? NAN : d->v_x; /* a car that moves goes on with what it knows, and should stop */
    if (!(moving >= SLOWEST)) {
        d->tracking = d->planned = 0;
        for (int i = 0; i < NY; i++)
            d->pending[i] = NAN;
        if (posed)
            blind_see(&d->watch.blind, d->now);
        return moving != moving ? CAR_SPEED_UNKNOWN : CAR_STANDING;
    }
    int begun = 0;
    if (!d->tracking || (double)behind * CAR_DT > LONGEST_GAP) {
        if (!pose_known(&d->watch, d->now))
            return CAR_POSE_UNKNOWN;
        start_filter(d);
        behind = 1, begun = 1;
    }
    int good = 1;
    for (int64_t k = 1; good && k < behind; k++)
        good = take(d, 0);
    if (!(good && take(d, 1) && plausible(d->filter.now.z))) {
        d->restarts++;
        start_filter(d);
        take(d, 0);
    }
    for (int i = 0; i < NY; i++) {
        int began_at = begun && BEGUN[i] >= 0 && d->pending[i] == d->pending[i];
        if ((d->filter.fresh[i] && d->filter.taken[i] > 0) || began_at)
            d->seen[i] = d->now;
        d->pending[i] = NAN;
    }
    if (X >= 0 && Y >= 0 && d->seen[X] == d->now && d->seen[Y] == d->now)
        blind_see(&d->watch.blind, d->now);
#ifdef TRUSTED
    wonder(&d->filter, &d->surprise);
#endif
    return CAR_PLANNED;
}

/* ---- plan ------------------------------------------------------------------------------------------------------ */

static double speed(double s) { return speed_at(LINE, SHAPE, SIZE, s); }

/* Steady lateral velocity at no yaw rate, and its derivatives by that and by what pushes the car. */
static void steady(double v_x, double *slip)
{
    int i = 0;
    while (i < N_SPEEDS - 2 && SPEEDS[i + 1] <= v_x)
        i++;
    double place = (double)i + (v_x - SPEEDS[i]) * (1 / (SPEEDS[i + 1] - SPEEDS[i]));
    place = within(place, 0, N_SPEEDS - 1);
    double share = place - (double)i;
    for (int k = 0; k < N_SLIPS; k++)
        slip[k] = (1 - share) * SLIPS[i * N_SLIPS + k] + share * SLIPS[(i + 1) * N_SLIPS + k];
}

static void plan(car_driver *memory, Driver *d)
{
    enum { ROWS = CAR_PLANNER_NODES };
    double ahead[8 * ROWS], slip[N_SLIPS], push = 0;
    const double *x = d->filter.now.z, *curvature = ahead + 4 * ROWS, *v = ahead + 5 * ROWS;
    car_planner_input *in = &d->given;
    line_ahead(LINE, SHAPE, SIZE, d->s, 0, d->v_x - speed(d->s), COUNTS, STRIDES, ROWS, ahead);
    memcpy(in->x, x, sizeof in->x);
    steady(d->v_x, slip);
    for (int k = 2; k < N_SLIPS; k++)
        push += slip[k] * (k - 2 < N_STATES_PUSH ? x : d->inputs)[PUSHES[k - 2]];
    for (int k = 0; k < ROWS; k++) {
#if CAR_PLANNER_REFERENCES > 0
        for (int p = 0; p < CAR_PLANNER_REFERENCES; p++) {
            int of = REFERENCES[p];
            double wanted = of == YAW_RATE ? curvature[k] * v[k] : of >= 0 ? ahead[of * ROWS + k] : 0;
            if (of == HEADING)
                wanted -= atan2(slip[0] + slip[1] * (curvature[k] * v[k]) + push, v[k] > SLOWEST ? v[k] : SLOWEST);
            in->tracked[k][p] = wanted;
        }
#endif
#if CAR_PLANNER_EXOGENOUS > 0
        int at = k < ROWS - 1 ? k : ROWS - 2;
        for (int w = 0; w < CAR_PLANNER_EXOGENOUS && k < CAR_PLANNER_EXOGENOUS_ROWS; w++) {
            int of = EXOGENOUS[w];
            double change = (v[at + 1] - v[at]) / (TIMES[at + 1] - TIMES[at]);
            in->exogenous[k][w] = of == SPEED_AHEAD ? v[k] : of == SPEED_CHANGE ? change : d->inputs[of];
        }
#endif
#if CAR_PLANNER_CORRIDOR
        in->corridor[k][0] = ahead[6 * ROWS + k], in->corridor[k][1] = ahead[7 * ROWS + k];
#endif
    }
    in->applied[0] = d->steered, in->applied_known = 1;
    if (!d->planned)
        plan_anew(memory, d);
#ifdef TRUSTED
    car_planner_trust(&memory->planner, within(d->surprise / SURE, 1, TRUST_MOST));
#endif
    (void)car_planner_plan(&memory->planner, in, &d->plan);
    d->planned = 1;
    d->steered = d->plan.command[0];
    d->filter.now.before[STEERING] = d->steered; /* from this sample on */
}

/* ---- speed ----------------------------------------------------------------------------------------------------- */

#if N_SHARES > 0
static double scheduled(const double *gains, double v_x)
{
    int i = 0;
    while (i < N_GAINS && GAIN_SPEEDS[i] <= v_x)
        i++;
    if (i == 0 || i == N_GAINS)
        return gains[i < N_GAINS - 1 ? i : N_GAINS - 1];
    double slope = (gains[i] - gains[i - 1]) / (GAIN_SPEEDS[i] - GAIN_SPEEDS[i - 1]);
    return slope * (v_x - GAIN_SPEEDS[i - 1]) + gains[i - 1];
}

/* What the tires leave for driving and braking where the vehicle is now; all of it where nothing is known. */
static double grip(const Driver *d)
{
    double left = 1;
#ifdef GRIP
    double u[NU];
    for (int j = 0; j < NU; j++)
        u[j] = j == STEERING ? d->steered : d->inputs[j];
    if (d->tracking)
        grip_left(d->filter.now.z, u, &left);
#else
    (void)d;
#endif
    return within(left, 0, 1);
}

/* Drive and brake that hold a speed; the last ones while a speed is no number. */
static void hold_speed(Driver *d, double wanted)
{
    double a_x = (speed(d->last.s + 0.5) - speed(d->last.s - 0.5)) * wanted;
    double v_x = wanted == 0 ? fabs(d->v_x) : d->v_x; /* brakes stop a vehicle that rolls back, too */
    if (fabs(wanted) <= 1e3 && fabs(v_x) <= 1e3 && fabs(a_x) <= 1e3) {
        double kp = scheduled(KP, v_x), ki = scheduled(KI, v_x), error = wanted - v_x;
        double free = kp * error + d->integral + FEEDFORWARD * a_x, rolling = within(v_x / 0.5, 0, 1);
        double most = grip(d), least = most > BRAKED ? most : BRAKED;
        double output = within(free, BRAKE_MOST * rolling * least, DRIVE_MOST * most), back = kp > 0 ? ki / kp : 1;
        d->integral = d->integral + CAR_DT * (ki * error + back * (output - free));
        if (!(fabs(d->integral) <= 1e12))
            d->integral = 0;
        d->output = output;
    }
    for (int k = 0; k < N_SHARES; k++)
        d->last.value[1 + k] = d->output * (d->output >= 0 ? DRIVE[k] : BRAKE[k]);
}
#else
static void hold_speed(Driver *d, double wanted) { (void)d, (void)wanted; }
#endif

/* ---- commands -------------------------------------------------------------------------------------------------- */

/* Commands from the estimate now. */
static void decide(car_driver *memory, Driver *d, int hindered)
{
    car_commands *c = &d->last;
    double found[3];
    memset(c, 0, sizeof *c);
    c->reason = hindered;
    if (hindered) {
        double X = d->raw[POSE[0]], Y = d->raw[POSE[1]], psi = d->raw[POSE[2]];
        int reason = CAR_LOST;
        if (X == X && Y == Y) {
            project(d, X, Y, found);
            double std = pose_known(&d->watch, d->now) ? 0 : INFINITY;
            double off = psi == psi ? remainder(psi - found[2], FULL_TURN) : 0;
            reason = watch_reason(&d->watch, d->now, std, found[0], found[1], off);
        }
        c->s = is_finite(d->s) ? d->s : 0;
        c->wanted_v_x = reason == CAR_PLANNED || reason == CAR_BESIDE ? speed(c->s) : 0;
        if (reason && hindered == CAR_STANDING)
            c->reason = reason;
        for (int a = 0; a < NX; a++)
            c->state_std[a] = INFINITY;
    } else {
        double most = 0;
        say_state(d, c);
        for (int k = 0; k < 2; k++)
            most = c->state_std[MOTION[k]] > most ? c->state_std[MOTION[k]] : most;
        project(d, c->state[MOTION[0]], c->state[MOTION[1]], found);
        c->s = d->s, c->e_y = found[1];
        plan(memory, d);
        double off = remainder(c->state[MOTION[2]] - found[2], FULL_TURN);
        c->reason = watch_reason(&d->watch, d->now, most, found[0], found[1], off);
        c->wanted_v_x = d->plan.stopping || (c->reason && c->reason != CAR_BESIDE) ? 0 : speed(d->s);
    }
    c->value[0] = d->steered;
    hold_speed(d, c->wanted_v_x);
    for (int i = 0; i < NY; i++)
        c->age[i] = (double)(d->now - d->seen[i]);
    c->restarts = d->restarts;
    say_plan(d, c);
}

int car_step(car_driver *memory, const car_measurements *measured, car_commands *commands)
{
    Driver *d = own(memory);
    car_seconds t = measured->t;
    int code = CAR_WRONG_TIME;
    if (!begun_with(d, commands))
        return CAR_NOT_STARTED;
    if (in_order(d, t)) {
        if (!d->begun)
            d->t0 = t;
        d->now = t;
        int64_t due = ticks(t - d->t0), next = d->tick + (due == d->tick);
        gather(d, measured->value, t, due > next ? due : next);
        if (due != d->tick || !d->begun) {
            int64_t behind = due - d->tick;
            d->tick = due;
            decide(memory, d, observe(d, behind));
        }
        d->begun = 1, code = CAR_OK;
    }
    *commands = d->last;
    return code;
}
