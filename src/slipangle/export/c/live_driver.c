/* What decides in a live loop: a driver, told what an instrument without errors shows of each channel. */

void car_follow(const double *line);
void car_planner_factors(const double *factors);

static car_driver driver;
static car_measurements told;
static car_commands said;

const double *live_predicted(void) { return car_last_plan(&driver)->x[0]; }
int live_age(void) { return said.planned ? said.plan_age : 0; }

static void begin_deciding(const double *weights)
{
    car_follow(line);
    car_planner_factors(weights);
    (void)car_start(&driver, sizeof driver);
    memset(&said, 0, sizeof said);
}

static void ask(void)
{
    told.t = tick * SAMPLE;
    for (int c = 0; c < CAR_CHANNELS; c++)
        told.value[c] = CHANNELS[c] < 0 ? NAN : CHANNELS[c] < PX ? x[CHANNELS[c]] : acting[CHANNELS[c] - PX];
    (void)car_step(&driver, &told, &said);
}

/* Measures and plans; how the solve ended. */
int live_plan(void)
{
    ask();
    if (n_plans < MOST_PLANS)
        commands[n_plans++] = said.value[0];
    return said.status;
}

static void command(int since)
{
    if (since)
        ask();
    for (int j = 0; j < PU; j++)
        held[j] = COMMANDS[j] < 0 ? 0 : said.value[COMMANDS[j]];
}
