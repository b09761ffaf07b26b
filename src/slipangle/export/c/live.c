/* A closed loop that drives in a web page: plant, path and what decides, step by step as in Python.
   The page writes the settings, then begins, plans and goes on in turns, and reads the rows. */

#define ROW (9 + USES) /* t, s, e_y, v_x, X, Y, psi, steering that acts, plan that it came from; tire force used */
#define FAR 20.0       /* m from the path: the drive is over */
#define WINDOW 15.0    /* m around the last place on the path, in which the next one is looked for */

enum { GOES_ON, FINISHED, LEFT_PATH, OUT_OF_TIME, NO_NUMBER };

static double settings[N_SETTINGS], rows[MOST_ROWS][ROW], commands[MOST_PLANS];
static double line[9 * LINE_ROWS];
static double x[PX], acting[PU], held[PU], seen_place;
static double late[MOST_DELAY + 1];
static int n_rows, n_plans, tick, delayed, next_late;

double *live_settings(void) { return settings; }
const double *live_rows(void) { return rows[0]; }
const double *live_commands(void) { return commands; }
int live_count(void) { return n_rows; }
int live_plans(void) { return n_plans; }

/* What decides, in the file that follows: it begins a drive with weights times these factors, and sets what is held over
   the next sample, so many samples after the plan. */
static void begin_deciding(const double *weights);
static void command(int since);

static double within(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

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
    double e_y;
    for (int i = 0; i < LINE_ROWS; i++) {
        memcpy(line + 9 * i, LINE + 9 * i, sizeof(double[9]));
        line[9 * i + 4] *= settings[PACE];
    }
    n_rows = n_plans = tick = next_late = 0;
    delayed = (int)within(floor(settings[DELAY] / STEP + 0.5), 0, MOST_DELAY);
    memset(late, 0, sizeof late);
    memset(acting, 0, sizeof acting);
    memset(held, 0, sizeof held);
    plant_start(line + 4, x);
    seen_place = project(x[POSE[0]], x[POSE[1]], 0, -1, &e_y);
    begin_deciding(settings + WEIGHTS);
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
        command(k);
        advance();
    }
    return GOES_ON;
}
