/* What a racer learns lap by lap: as `Learned` and `Sectors` have it. */

#define FULL 0.99 /* throttle from which its force is learned */

/* ---- tables ---------------------------------------------------------------------------------------------------- */

/* The place on a lap. [m] */
static double on_lap(double s)
{
    double place = fmod(s, SIZE[1]);
    return place < 0 ? place + SIZE[1] : place;
}

/* The last of rising places up to one, -1 before all. */
static int last_up_to(const double *places, int n, double x)
{
    int low = -1, high = n;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (places[middle] <= x)
            low = middle;
        else
            high = middle;
    }
    return low;
}

/* On the straight line between two values; the first one at its place. */
static double between(double x, const double *places, double from, double to)
{
    double slope = (to - from) / (places[1] - places[0]);
    return x == places[0] ? from : slope * (x - places[0]) + from;
}

static double interpolated(const double *places, int n, double x, const double *values)
{
    int j = last_up_to(places, n, x);
    if (j < 0 || j == n - 1)
        return values[j < 0 ? 0 : j];
    return between(x, places + j, values[j], values[j + 1]);
}

/* ---- engine and brakes ----------------------------------------------------------------------------------------- */

/* The gear at a speed [m/s], from one before on. */
static int geared(double v_x, int gear)
{
    while (gear <= SHIFTS && v_x > UP[gear - 1])
        gear++;
    while (gear > 1 && v_x < DOWN[gear - 2])
        gear--;
    return gear;
}

/* A force at a speed in a gear. [N] */
static double pedal(const double *forces, double v_x, int gear)
{
    return interpolated(PEDAL_SPEEDS, N_SPEEDS, v_x, forces + (GEARS > 1 ? gear - 1 : 0) * N_SPEEDS);
}

/* ---- grip, and what full throttle gives ------------------------------------------------------------------------ */

static void begin_learning(Learned *l)
{
    l->grip = l->mean = 1, l->grip_std = GRIP_STD, l->known = KNOWN;
    for (int i = 0; i < PARTS; i++)
        l->share[i] = 1, l->nearest[i] = i;
}

static int part(double s) { return (int)(on_lap(s) / SIZE[1] * PARTS) % PARTS; }

/* What full throttle gives at a place, over what it is believed to. */
static double share_at(const Learned *l, double s) { return l->share[l->nearest[part(s)]]; }

/* Grip to plan with where the filter reads `grip`. */
static double here(const Learned *l, double grip) { return l->mean < grip ? l->mean : grip; }

/* A sample: place, force over that of full throttle, throttle, grip and its standard deviation. */
static void learn_here(Learned *l, double s, double share, double throttle, const double *grip)
{
    double std = SUREST > grip[1] ? SUREST : grip[1], weight = 1 / (std * std), off = grip[0] - l->average;
    l->samples += 1, l->weights += weight;
    l->average += weight / l->weights * off;
    l->spread += weight * off * (grip[0] - l->average);
    double sure = CAR_DT * weight;
    l->known = l->known * REMEMBERED + sure;
    l->mean += sure / l->known * (grip[0] - l->mean);
    l->pressed = throttle > FULL ? l->pressed + CAR_DT : 0;
    if (l->pressed < FULL_FOR)
        return;
    int at = part(s);
    share = within(share, LEAST_SHARE, MOST_SHARE);
    if (l->seen[at]) {
        l->share[at] += OF_NEW * (share - l->share[at]);
        return;
    }
    int first = 1;
    for (int i = 0; i < PARTS; i++)
        first &= !l->seen[i];
    l->share[at] = share, l->seen[at] = 1;
    for (int i = 0; i < PARTS; i++) { /* of two as near, the first */
        int near = abs(i - l->nearest[i]), now = abs(i - at);
        near = PARTS - near < near ? PARTS - near : near, now = PARTS - now < now ? PARTS - now : now;
        if (first || now < near || (now == near && at < l->nearest[i]))
            l->nearest[i] = at;
    }
}

/* Takes the lap's mean grip; how much more speed a corner is tried with at most. */
static double learn_lap(Learned *l)
{
    if (l->samples > 0) {
        double wandering = sqrt(l->spread / l->weights), own_std = sqrt(l->samples / l->weights);
        l->grip = l->average, l->grip_std = own_std > wandering ? own_std : wandering;
    }
    l->samples = l->weights = l->average = l->spread = 0;
    return 0.5 * (BOLD * (l->grip - l->grip_std) * MU_F / LAP_MU_F - 1);
}

/* ---- sectors --------------------------------------------------------------------------------------------------- */

static void begin_sector_times(Sectors *r)
{
    for (int k = 0; k < SECTORS; k++)
        r->times[k] = NAN, r->room[k] = INFINITY;
}

static void begin_sectors(Sectors *r)
{
    for (int k = 0; k < SECTORS; k++)
        r->trial[k] = TRIAL, r->quickest[k] = INFINITY;
    r->entered = NAN;
    begin_sector_times(r);
}

/* Values of the sectors, which blend into each other. */
static double along(const double *values, double s)
{
    double place = on_lap(s);
    int j = last_up_to(BLENDS, 2 * SECTORS + 2, place), from = (j + 2 * SECTORS - 1) % (2 * SECTORS) / 2;
    return between(place, BLENDS + j, values[from], values[j % (2 * SECTORS) / 2]);
}

static double faster_at(const Sectors *r, double s) { return 1 + along(r->faster, s); }

/* A sample of the drive: arc length, going on over the start line, time, room beside the vehicle. */
static void see_sector(Sectors *r, double s, car_seconds t, double room)
{
    int now = last_up_to(ENDS, SECTORS, on_lap(s)) + 1;
    now = now < SECTORS ? now : SECTORS - 1;
    r->room[now] = room < r->room[now] ? room : r->room[now];
    if (r->seen && !(s > r->s))
        return;
    double turns = floor(r->s / SIZE[1]) * SIZE[1];
    for (int k = 0; r->seen && k < SECTORS; k++) {
        double end = ENDS[k] + turns;
        if (r->s < end && end <= s) {
            car_seconds passed = r->at + (t - r->at) * (car_seconds)(end - r->s) / (car_seconds)(s - r->s);
            r->times[k] = (double)(passed - r->entered);
            r->entered = passed;
        }
    }
    r->s = s, r->at = t, r->seen = 1;
}

/* Judges every sector that was driven through, and says how fast the next lap takes it. */
static void judge_sectors(Sectors *r, double most)
{
    for (int k = 0; k < SECTORS; k++) {
        double little = KEPT_ROOM - r->room[k], lowest = -SLOWER;
        if (!is_finite(r->times[k]))
            continue;
        if (little > 0) {
            double narrower = r->narrower[k] + little, least = r->faster[k] < r->best[k] ? r->faster[k] : r->best[k];
            r->narrower[k] = NARROWEST < narrower ? NARROWEST : narrower;
            r->trial[k] *= 0.5;
            r->best[k] = r->faster[k] = lowest > least - TRIAL ? lowest : least - TRIAL;
            r->quickest[k] = INFINITY;
            continue;
        }
        if (r->times[k] < r->quickest[k] - BETTER)
            r->quickest[k] = r->times[k], r->best[k] = r->faster[k];
        else
            r->trial[k] *= 0.5;
        double tried = r->best[k] + (r->trial[k] >= LEAST_TRIAL && r->room[k] > ENOUGH_ROOM ? r->trial[k] : 0);
        tried = most < tried ? most : tried;
        r->faster[k] = lowest > tried ? lowest : tried;
    }
    begin_sector_times(r);
}
