/* ---- plan ------------------------------------------------------------------------------------------------------ */

void car_planner_limit(car_planner_controller *memory, const double *bounds);
int car_planner_plan_from(
    car_planner_controller *memory, const car_planner_input *in, const double *u, const double *x, car_planner_output *out);

/* As `Planner` has it: states of the lap at the speeds of its sectors, nodes, what is known of them, and limits. */

static void at_speed(double *x, double faster)
{
    for (int a = 0; a < NXP; a++)
        x[a] *= SPEED_IN[a] == 0 ? 1 : SPEED_IN[a] == 1 ? faster : faster * faster;
}

/* The state of the lap at an arc length, at the speed of its sector. */
static void lap_at(const Driver *d, double s, double *x)
{
    double place = on_lap(s);
    int j = last_up_to(LAP, N_LAP, place);
    for (int a = 0; a < NXP; a++)
        x[a] = between(place, LAP + j, LAP_STATES[j * NXP + a], LAP_STATES[(j + 1) * NXP + a]);
    at_speed(x, faster_at(&d->sectors, place));
}

/* State and arc length behind what is on its way to steering and pedals. */
static void drive_on(Driver *d, double *x, double *s, double grip)
{
#if DELAY > 0
    Asked before = d->heard;
    for (int k = 0; k < DELAY; k++) {
        const Asked *next = &d->coming[(d->asks + k) % DELAY];
        double line[7], later[NXP], pace, turn = (next->delta - before.delta) / CAR_DT;
        at(LINE, SHAPE, SIZE, *s, line);
        pace_at(x, line + 3, &pace);
        double way = CAR_DT / pace;
        double u[] = {turn, (next->F_x - before.F_x) / CAR_DT, line[3], way, grip * MU_F, grip * MU_R, d->d_v_x, d->d_r};
        along_step(x, u, later);
        memcpy(x, later, sizeof later);
        *s += way, before = *next;
    }
#else
    (void)d, (void)x, (void)s, (void)grip;
#endif
}

/* Arc lengths of the stages: at the lap's speeds, as much faster or slower as the vehicle is now. */
static void nodes_from(const Driver *d, double s, double v_x, double *nodes)
{
    double now[NXP], faster = faster_at(&d->sectors, s);
    lap_at(d, s, now);
    nodes[0] = s;
    for (int k = 1; k < CAR_PLANNER_NODES; k++) {
        double place = on_lap(nodes[k - 1]);
        int j = last_up_to(LAP, N_LAP, place);
        double rate = faster * between(place, LAP + j, LAP_RATE[j], LAP_RATE[j + 1]) + (v_x - now[2]);
        nodes[k] = nodes[k - 1] + STAGE_SECONDS * (SLOWEST > rate ? SLOWEST : rate);
    }
}

/* Force at full throttle at the nodes and the speeds there, from the gear that the vehicle is in on. */
static void most_at(const Driver *d, const double *nodes, double (*wanted)[NXP], double *most)
{
    int gear = d->gear;
    for (int k = 0; k < CAR_PLANNER_NODES; k++) {
        gear = geared(wanted[k][2], gear);
        most[k] = share_at(&d->learned, nodes[k]) * pedal(FULL_THROTTLE, wanted[k][2], gear);
    }
}

/* No state of the lap is much faster than full throttle, or the brake of one that is lost, makes it from now on. */
static void keep_within_reach(const Driver *d, const double *nodes, double v, double (*wanted)[NXP])
{
    double most[CAR_PLANNER_NODES];
    most_at(d, nodes, wanted, most);
    for (int k = 0; k < CAR_PLANNER_NODES; k++) {
        double way = k + 1 < CAR_PLANNER_NODES ? nodes[k + 1] - nodes[k] : 0;
        v = wanted[k][2] < v ? wanted[k][2] : v;
        double reached = (v + (d->lost ? 0 : REACHED)) / wanted[k][2], down = DOWN_F * v * v + DOWN_R * v * v;
        double pull = d->lost ? STOP_FORCE : most[k];
        double gain = (pull - (DRAG * v * v + ROLLING * (WEIGHT + down))) / MASS, square = v * v + 2 * gain * way;
        v = sqrt(SLOWEST_SQUARED > square ? SLOWEST_SQUARED : square);
        at_speed(wanted[k], reached < 1 ? reached : 1);
    }
}

/* What the planner is told of the nodes, and the limits there. */
static void refer(Driver *d, const double *nodes, double (*wanted)[NXP], double grip, double (*limits)[LIMITED][2])
{
    enum { LAST = CAR_PLANNER_NODES - 1 };
    double most[CAR_PLANNER_NODES], line[CAR_PLANNER_NODES][7];
    most_at(d, nodes, wanted, most);
    for (int k = 0; k <= LAST; k++)
        at(LINE, SHAPE, SIZE, nodes[k], line[k]);
    for (int k = 0; k <= LAST; k++) {
        int from = k < LAST ? k : LAST - 1;
        double stage = nodes[from + 1] - nodes[from], bend = (line[from + 1][2] - line[from][2]) / stage;
        double known[] = {k < LAST ? bend : line[k][3], stage, grip * MU_F, grip * MU_R,
                          d->d_v_x * FADING[k], d->d_r * FADING[k]};
        double room = ROOM + along(d->sectors.narrower, nodes[k]), right = room - line[k][5], left = line[k][6] - room;
        memcpy(limits[k], LIMITS, sizeof limits[k]);
        limits[k][LIMIT_N][0] = left < right ? left : right, limits[k][LIMIT_N][1] = left < right ? right : left;
        limits[k][LIMIT_F][0] = -BRAKE_FORCE, limits[k][LIMIT_F][1] = most[k];
        wanted[k][0] = within(wanted[k][0], limits[k][LIMIT_N][0], limits[k][LIMIT_N][1]);
        for (int p = 0; p < CAR_PLANNER_REFERENCES; p++)
            d->given.tracked[k][p] = wanted[k][TRACKED[p]];
        for (int w = 0; w < CAR_PLANNER_EXOGENOUS && k < CAR_PLANNER_EXOGENOUS_ROWS; w++)
            d->given.exogenous[k][w] = known[EXOGENOUS[w]];
    }
}

/* Plans from the place `found` on the path: s, e_y, heading. */
static void plan(car_driver *memory, Driver *d, const double *found, double grip)
{
    double nodes[CAR_PLANNER_NODES], wanted[CAR_PLANNER_NODES][NXP], limits[CAR_PLANNER_NODES][LIMITED][2];
    double u[CAR_PLANNER_HORIZON][2], s = d->s;
    const double *z = d->filter.now.z;
    double all[] = {found[1],   remainder(z[2] - found[2], FULL_TURN), z[3], z[4], z[5],
                    d->steered, acting(d), d->heard.F_x, d->heard.delta};
    double *x = d->given.x;
    memcpy(x, all, sizeof d->given.x);
    drive_on(d, x, &s, grip);
    nodes_from(d, s, x[2], nodes);
    for (int k = 0; k < CAR_PLANNER_NODES; k++)
        lap_at(d, nodes[k], wanted[k]);
    keep_within_reach(d, nodes, x[2], wanted);
    refer(d, nodes, wanted, grip, limits);
    if (!d->planned)
        plan_anew(memory, d);
    car_planner_limit(&memory->planner, limits[0][0]);
    (void)car_planner_plan(&memory->planner, &d->given, &d->plan);
    d->planned = 1;
    if (d->plan.age == 0)
        return;
    for (int k = 0; k < CAR_PLANNER_HORIZON; k++) { /* from the lap itself */
        u[k][0] = within((wanted[k + 1][5] - wanted[k][5]) / STAGE_SECONDS, RATES[0], RATES[1]);
        u[k][1] = within((wanted[k + 1][7] - wanted[k][7]) / STAGE_SECONDS, RATES[2], RATES[3]);
    }
    (void)car_planner_plan_from(&memory->planner, &d->given, u[0], wanted[0], &d->plan);
}
