/* From measurements to commands of a vehicle at its limit. The same decisions as those of `Racer.step`. */


typedef struct {
    double grip, grip_std, known, mean, pressed; /* of the lap before; while driving; s of full throttle */
    double weights, average, spread, samples;    /* of this lap */
    double share[PARTS]; /* of what full throttle is believed to give, by place */
    int seen[PARTS], nearest[PARTS];
} Learned;

typedef struct {
    double faster[SECTORS], narrower[SECTORS]; /* of speed [-], of the track on each side [m] */
    double best[SECTORS], trial[SECTORS], quickest[SECTORS];
    double times[SECTORS], room[SECTORS]; /* of this lap */
    double s;
    car_seconds at, entered; /* when it was at s; when it came into the sector, NaN where that was not seen */
    int seen;
} Sectors;

typedef struct {
    double delta, F_x;
} Asked;

@BLIND@
typedef struct {
    Filter filter;
    Learned learned;
    Sectors sectors;
    double read[NY]; /* what each channel read when it was taken in last, NaN before */
    Asked asked, heard, coming[WAITING]; /* of steering and pedals, last, as far as it came, and between, a ring */
    double steered, driving, braking;      /* what the vehicle has done of it */
    double s, from, turns, d_v_x, d_r;     /* from: where the drive began; d: what the model does not explain */
    Blind blind;
    car_seconds seen[NY], now;
    int64_t started, tick, asks, laps, restarts;
    int tracking, agreed, planned, lost, begun, gear, iterations;
    double seconds;
    car_seconds (*clock)(void *);
    void *of;
    car_planner_input given;
    car_planner_output plan;
    car_commands last;
} Driver;

@MEMORY@
@LEARNS@
static double acting(const Driver *d) { return d->driving + d->braking; }

int car_start(car_driver *memory, size_t bytes)
{
    Driver *d = own(memory);
    int code = bytes < sizeof *memory ? CAR_TOO_SMALL : car_planner_start(&memory->planner, sizeof memory->planner);
    if (code != CAR_OK)
        return code;
    memset(d, 0, sizeof *d);
    for (int i = 0; i < NY; i++)
        d->seen[i] = NAN;
    d->started = STARTED, d->s = d->from = NAN, d->tick = -1, d->gear = 1;
    say_nothing(&d->last);
    begin_learning(&d->learned);
    begin_sectors(&d->sectors);
    return CAR_OK;
}

/* ---- measurements ---------------------------------------------------------------------------------------------- */

/* Takes in what a sensor can read, NaN for nothing; whether the state stays a vehicle's and, before a second pose, agrees
   with what is measured of it. What reads exactly as before is held by its instrument. */
static int follows(Driver *d, const double *given)
{
    double y[NY], u[NU] = {d->steered, acting(d)};
    for (int i = 0; i < NY; i++) {
        y[i] = given[i] == d->read[i] ? NAN : given[i];
        d->read[i] = given[i] == given[i] ? given[i] : d->read[i];
    }
    if (!filter_take(&d->filter, y, u) || !plausible(d->filter.now.z))
        return 0;
    int agrees = 1;
    for (int i = 0; i < NY; i++)
        agrees &= !(BEGINS[i] && d->filter.fresh[i] && is_finite(d->filter.error[i]) && !(d->filter.taken[i] > 0));
    return agrees || d->agreed;
}

/* Forgets an estimate that is no vehicle's any more. */
static void drop(Driver *d) { d->tracking = d->agreed = 0, d->restarts++; }

/* Whether the position is not known any more. */
static int is_lost(const car_commands *c, double blind)
{
    double X = c->state_std[0], Y = c->state_std[1];
    return !((Y > X ? Y : X) + blind <= UNCERTAIN);
}

/* Whether a state is known with what was measured now. */
static int sense(Driver *d, const double *value)
{
    double given[NY];
    int whole = 1;
    for (int i = 0; i < NY; i++) {
        given[i] = value[i] >= LOWEST[i] && value[i] <= HIGHEST[i] ? value[i] : NAN;
        whole &= given[i] == given[i] || !OF_POSE[i];
    }
    if (d->tracking && !follows(d, given))
        drop(d);
    if (d->tracking)
        d->agreed |= whole;
    else if (whole) {
        double x[NX];
        for (int a = 0; a < NX; a++)
            x[a] = READ_BY[a] < 0 ? 0 : given[READ_BY[a]];
        filter_begin(&d->filter, x);
        for (int i = 0; i < NY; i++)
            d->read[i] = NAN;
        d->tracking = 1;
        if (!follows(d, given))
            drop(d);
    }
    for (int i = 0; d->tracking && i < NY; i++)
        if (d->filter.fresh[i] && d->filter.taken[i] > 0)
            d->seen[i] = d->now;
    if (d->tracking && d->seen[AT_X] == d->now && d->seen[AT_Y] == d->now)
        blind_see(&d->blind, d->now);
    else if (d->tracking)
        blind_move(&d->blind, d->filter.now.z[3] * CAR_DT, d->now);
    return d->agreed;
}

@PLANS@
/* ---- steering and pedals --------------------------------------------------------------------------------------- */

/* Asks for rates of the road-wheel angle and of the force along the vehicle, over a sample; throttle and brake for that. */
static void ask(Driver *d, double turn, double rise, double v_x, double most, double *pedals)
{
    Asked a = {within(d->asked.delta + CAR_DT * turn, -DELTA_MAX, DELTA_MAX), 0};
    a.F_x = within(d->asked.F_x + CAR_DT * rise, -BRAKE_FORCE, most);
    d->asked = d->heard = a;
#if DELAY > 0
    Asked *oldest = &d->coming[d->asks++ % DELAY];
    d->heard = *oldest, *oldest = a;
#endif
    double F_x = most < d->heard.F_x ? most : d->heard.F_x;
    d->heard.F_x = F_x;
    d->steered = d->heard.delta - BEHIND * (d->heard.delta - d->steered);
    double closed = pedal(CLOSED, v_x, d->gear), full = pedal(BRAKES, v_x, d->gear), least = NO_PEDAL * full;
    double range = most - closed, throttle = ((F_x > 0 ? F_x : 0) - closed) / (least > range ? least : range);
    double brake = F_x < 0 ? -F_x / full : 0;
    pedals[0] = within(throttle, 0, 1), pedals[1] = brake > 1 ? 1 : brake;
    d->driving += (pedals[0] * range + closed - d->driving) * DRIVE_SHARE;
    d->braking += (-pedals[1] * full - d->braking) * BRAKE_SHARE;
}

/* Commands of a sample, and what the vehicle does with them. */
static void act(Driver *d, const double *grip, car_commands *c)
{
    const double *x = d->filter.now.z;
    double turn = d->plan.command[0], rise = d->plan.command[1];
    if (d->plan.stopping || (d->lost && x[3] <= CREEPING)) {
        double wanted = (STOP_FORCE - d->asked.F_x) / CAR_DT;
        turn = 0, rise = within(wanted, -FORCE_RATE, 0);
    }
    double believed = pedal(FULL_THROTTLE, x[3], d->gear), most = share_at(&d->learned, d->s) * believed;
    ask(d, turn, rise, x[3], most, c->value + 1);
    double least = NO_FORCE > believed ? NO_FORCE : believed;
    double share = (acting(d) + MASS * x[6]) / least;
    int spinning = believed > SPINS && share < SHORT; /* a wheel, not a weak engine */
    learn_here(&d->learned, d->s, share, spinning ? 0 : c->value[1], grip);
}

/* ---- commands -------------------------------------------------------------------------------------------------- */

/* Says how the next lap is driven where the vehicle crosses the start line. */
static void count_laps(Driver *d)
{
    double turns = floor(d->s / SIZE[1]);
    if (d->from != d->from)
        d->from = d->s, d->turns = turns;
    if (BETWEEN && turns > d->turns && d->s - d->from > 0.5 * SIZE[1]) {
        judge_sectors(&d->sectors, learn_lap(&d->learned));
        d->laps++;
    }
    d->turns = turns > d->turns ? turns : d->turns;
}

/* Commands from the estimate now. */
static void decide(car_driver *memory, Driver *d, car_commands *c)
{
    double found[3], lane[7], grip[2];
    const double *x = d->filter.now.z;
    say_state(d, c);
    d->lost = is_lost(c, d->blind.off);
    grip[0] = GRIP * exp(x[NX]), grip[1] = sqrt(d->filter.now.P[NX * NZ + NX] * (grip[0] * grip[0]));
    project(d, x[0], x[1], found);
    d->gear = geared((1 + (d->driving > 0 ? SPIN : 0)) * x[3], d->gear);
    d->d_v_x += SETTLING * (x[6] - d->d_v_x), d->d_r += SETTLING * (x[7] - d->d_r);
    at(LINE, SHAPE, SIZE, d->s, lane);
    double left = lane[6] - found[1], right = lane[5] + found[1];
    see_sector(&d->sectors, d->s, d->now, d->lost ? INFINITY : (right < left ? right : left) - HALF_WIDTH);
    count_laps(d);
    if (!d->planned || d->tick % EVERY == 0)
        plan(memory, d, found, here(&d->learned, grip[0]));
    act(d, grip, c);
    c->s = d->s, c->e_y = found[1], c->reason = d->lost ? CAR_LOST : CAR_PLANNED;
    double wanted[NXP];
    lap_at(d, d->s, wanted);
    c->wanted_v_x = d->lost || d->plan.stopping ? 0 : wanted[2];
}

int car_step(car_driver *memory, const car_measurements *measured, car_commands *commands)
{
    Driver *d = own(memory);
    car_commands *c = &d->last;
    int code = CAR_WRONG_TIME;
    if (!begun_with(d, commands))
        return CAR_NOT_STARTED;
    if (in_order(d, measured->t)) {
        d->now = measured->t, d->begun = 1, d->tick++;
        memset(c, 0, sizeof *c);
        if (sense(d, measured->value))
            decide(memory, d, c);
        else {
            d->planned = 0, c->reason = CAR_POSE_UNKNOWN;
            for (int a = 0; a < NX; a++)
                c->state_std[a] = INFINITY;
        }
        c->value[0] = d->asked.delta;
        for (int i = 0; i < NY; i++)
            c->age[i] = d->agreed ? (double)(d->now - d->seen[i]) : NAN;
        c->restarts = d->restarts;
        say_plan(d, c);
        code = CAR_OK;
    }
    *commands = d->last;
    return code;
}

void car_learned_by_now(const car_driver *memory, car_learned *to)
{
    const Driver *d = (const Driver *)(const void *)memory->memory;
    memset(to, 0, sizeof *to);
    if (d->started != STARTED)
        return;
    to->laps = d->laps, to->grip = d->learned.grip, to->grip_std = d->learned.grip_std;
    memcpy(to->faster, d->sectors.faster, sizeof to->faster);
    memcpy(to->narrower, d->sectors.narrower, sizeof to->narrower);
}
