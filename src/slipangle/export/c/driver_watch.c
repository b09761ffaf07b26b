/* What a driver looks at beside its plan, and for which the vehicle should stop. */

#define POSE_GAP ((car_seconds)WATCH_POSE_GAP)
#define SPEED_GAP ((car_seconds)WATCH_SPEED_GAP)

typedef struct {
    car_seconds told[CAR_CHANNELS], from_t; /* when each channel said what can be, NaN before; positions */
    double from[2], way, read, nearest; /* the last: least distance since it was far beside the path */
    car_seconds headed_t;
    double headed, turned; /* heading at that time, and how far it turned since by the yaw rate */
    Blind blind;
    int counted, odd, turns, odd_turns;
} Watch;

static void watch_begin(Watch *w)
{
    memset(w, 0, sizeof *w);
    for (int c = 0; c < CAR_CHANNELS; c++)
        w->told[c] = NAN;
    w->nearest = INFINITY;
}

static int speed_known(const Watch *w, car_seconds now) { return now - w->told[SPEED] <= SPEED_GAP; }

static int pose_known(const Watch *w, car_seconds now)
{
    int all = 1;
    for (int k = 0; k < 3; k++)
        all &= now - w->told[POSE[k]] <= POSE_GAP;
    return all;
}

/* Counts the way by the speed since the last call, and sets it beside that from position to position. A speed that
   contradicts the positions is believed again when they agree and it reads otherwise than then. */
static void watch_move(Watch *w, car_seconds now, double v_x, double passed, int posed, double X, double Y)
{
    double way = v_x == v_x ? v_x * passed : 0;
    blind_move(&w->blind, way, now);
    w->way += way;
    if (!posed)
        return;
    if (w->counted) {
        double seconds = (double)(now - w->from_t);
        if (seconds < WATCH_WINDOW)
            return;
        double dx = X - w->from[0], dy = Y - w->from[1], between = sqrt(dx * dx + dy * dy);
        double most = w->way > between ? w->way : between;
        int bent = between < w->way && seconds > WATCH_LONG * WATCH_WINDOW; /* a turn may have brought it back */
        if (fabs(between - w->way) > WATCH_APART * most + WATCH_SLOW * seconds && !bent)
            w->odd++, w->read = v_x;
        else if (w->odd < WATCH_TWICE || v_x != w->read)
            w->odd = 0;
    }
    w->counted = 1, w->from_t = now, w->from[0] = X, w->from[1] = Y, w->way = 0;
}

/* Counts the turn by the yaw rate since the last call, and sets it beside that from heading to heading. Where they
   contradict each other only a turn in which they agree is believed. */
static void watch_turn(Watch *w, car_seconds now, double r, double passed, int headed, double psi)
{
    w->turned += r * passed;
    if (!headed)
        return;
    if (w->turns) {
        double seconds = (double)(now - w->headed_t), between = remainder(psi - w->headed, FULL_TURN);
        if (seconds < WATCH_WINDOW)
            return;
        double turned = fabs(w->turned), most = turned > fabs(between) ? turned : fabs(between);
        double left = WATCH_TURN_SLOW * seconds;
        if (turned < WATCH_MOST_TURN) {
            if (fabs(between - w->turned) > WATCH_APART * most + left)
                w->odd_turns++;
            else if (w->odd_turns < WATCH_TWICE || fabs(between) > left)
                w->odd_turns = 0;
        }
    }
    w->turns = 1, w->headed_t = now, w->headed = psi, w->turned = 0;
}

/* Why the vehicle should stop, or that it is far beside the path; else CAR_PLANNED. */
static int watch_reason(Watch *w, car_seconds now, double std, double s, double e_y, double e_psi)
{
    if (!(std + w->blind.off <= LOST))
        return CAR_LOST;
    if (!speed_known(w, now))
        return CAR_SPEED_LOST;
    if (w->odd >= WATCH_TWICE)
        return CAR_CONTRADICTED;
    if (w->odd_turns >= WATCH_TWICE)
        return CAR_TURN_CONTRADICTED;
    if (!SHAPE[1] && s > SIZE[1])
        return CAR_ENDED;
    if (!(fabs(e_psi) <= WATCH_AWAY))
        return CAR_FACING_AWAY;
    if (fabs(e_y) <= WATCH_FAR) {
        w->nearest = INFINITY;
        return CAR_PLANNED;
    }
    w->nearest = fabs(e_y) < w->nearest ? fabs(e_y) : w->nearest;
    return fabs(e_y) <= w->nearest + WATCH_FAR ? CAR_BESIDE : CAR_RECEDING;
}
