/* The solver behind the functions of the header: what is known of one part is spread over the horizons of all. */

#define ALIGNED sizeof(V)
#define ROW(i) ((i) < LEAD ? 0 : ((i) - LEAD) % (ONE_N + 1)) /* of the one part, at a node of all */

typedef char car_joined_bytes_are_enough[sizeof(Work) <= CAR_JOINED_BYTES ? 1 : -1];

static Work *own(car_joined *j) { return (Work *)(void *)j->memory; }

int car_joined_start(car_joined *memory, size_t bytes)
{
    Work *s = own(memory);
    if (bytes < sizeof(Work))
        return CAR_JOINED_TOO_SMALL;
    if ((uintptr_t)s % ALIGNED)
        return CAR_JOINED_MISALIGNED;
    memset(s, 0, sizeof *s);
    begin_solver(s);
    return CAR_JOINED_OK;
}

static double within(double v, int j) { return smaller(larger(v, INPUT_LOW[j]), INPUT_HIGH[j]); }

/* State and input now, and what is wanted and known at the nodes of all parts. */
static void spread(Work *s, const car_joined_task *of)
{
    memset(s->x0, 0, sizeof s->x0);
    memcpy(s->x0, of->x, sizeof(double) * ONE_NX);
    for (int j = 0; j < NU; j++)
        s->applied[j] = within(j < ONE_NU ? of->applied[j] : REST[j], j);
    for (int i = 0; i <= N; i++) {
        int k = ROW(i);
        for (int j = 0; j < NP; j++)
            s->p[i * NP + j] = of->tracked[k * NP + j];
        for (int j = 0; j < NW; j++)
            s->w[i * NW + j] = KNOWN[j] >= 0  ? of->exogenous[k * ONE_NW + KNOWN[j]]
                               : BACK[j] >= 0 ? of->x[BACK[j]]
                                              : FIXED_W[i * NW + j];
        s->corridor[2 * i] = i < LEAD ? INFINITY : of->corridor[2 * k];
        s->corridor[2 * i + 1] = i < LEAD ? INFINITY : of->corridor[2 * k + 1];
        for (int j = 0; i < N && j < NU; j++)
            s->r[i * NU + j] = i >= LEAD && k < ONE_N && j < ONE_NU ? of->inputs[k * ONE_NU + j] : s->applied[j];
    }
}

/* The guess of one part for all, with the first inputs as those that are in common. */
static void take_guess(Work *s, const car_joined_task *of)
{
    double kept[M1(NX - ONE_NX)];
    for (int a = 0; a < NX - N_BEFORE - ONE_NX; a++)
        kept[a] = a >= N_ONCE ? of->guess_u[a - N_ONCE] : ONCE_FROM[a] >= 0 ? of->exogenous[ONCE_FROM[a]] : ONCE[a];
    memset(s->x, 0, sizeof s->x);
    memcpy(s->x, s->x0, sizeof s->x0);
    for (int i = 0; i <= N; i++) {
        int k = ROW(i), in = i >= LEAD && k < ONE_N;
        for (int j = 0; i < N && j < NU; j++)
            s->u[i * NU + j] = j >= ONE_NU + N_ONCE ? REST[j]
                               : j >= ONE_NU        ? kept[j - ONE_NU]
                               : in                 ? of->guess_u[k * ONE_NU + j]
                                                    : s->applied[j];
        if (i >= LEAD)
            memcpy(s->x + i * NX, of->guess_x + k * ONE_NX, sizeof(double) * ONE_NX);
        for (int a = ONE_NX; i > 0 && a < NX - N_BEFORE; a++)
            s->x[i * NX + a] = kept[a - ONE_NX];
        for (int a = 0; i >= LEAD && k > 0 && a < N_BEFORE; a++)
            s->x[i * NX + NX - N_BEFORE + a] = of->guess_u[(k - 1) * ONE_NU + BEFORE[a]];
    }
}

int car_joined_solve(car_joined *memory, const car_joined_task *of, car_joined_answer *answer)
{
    Work *s = own(memory);
    int begin = of->begin;
    spread(s, of);
    if (!(moderate(s->u, N * NU) && moderate(s->x, (N + 1) * NX) && moderate(s->k, (N + 1) * NK) &&
          moderate(s->working, 1 + 2 * QT)))
        begin = begin == GIVEN ? GIVEN : GIVEN_INPUTS;
    if (begin == GIVEN)
        take_guess(s, of);
    if (begin == GIVEN_INPUTS) {
        inputs_after(s->u, 1, s->u_later);
        memcpy(s->u, s->u_later, sizeof s->u);
    }
    s->fresh = begin;
    s->max_iterations = of->most, s->time_limit = of->seconds;
    s->qp.clock = of->clock, s->qp.clock_of = of->clock_of;
    int status = rt_solve(s), first = LEAD + LIKELY * (ONE_N + 1);
    for (int i = 0; i <= ONE_N; i++)
        memcpy(s->way_x + i * ONE_NX, s->x + (first + i) * NX, sizeof(double) * ONE_NX);
    for (int i = 0; i < ONE_N; i++)
        memcpy(s->way_u + i * ONE_NU, s->u + (first + i) * NU, sizeof(double) * ONE_NU);
    answer->u = s->way_u, answer->x = s->way_x, answer->iterations = s->iterations;
    answer->begun_anew = s->anew;
    answer->cost = s->cost, answer->residual = s->residual, answer->violation = s->violation;
    int whole = moderate(s->u, N * NU) && moderate(s->x, (N + 1) * NX);
    return (status == SOLVED || status == ITERATED) && !whole ? NOT_FINITE : status;
}

const double *car_joined_decided(const car_joined *memory)
{
    return ((const Work *)(const void *)memory->memory)->x + LEAD * NX + ONE_NX;
}
