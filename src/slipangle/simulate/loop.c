/* A closed loop whose plant and driver are both compiled, sample by sample as `drive` has it in Python. Comes after
 * the path's `line.c`, and is handed a `Loop`, which `compiled.py` lays out alike. */
#include <string.h>

#define FAR 20.0    /* m from the path: the drive is over */
#define WINDOW 15.0 /* m around the last place on the path, in which the next one is looked for */

enum { GOES_ON, FINISHED, OUT_OF_TIME, LEFT_PATH, NO_NUMBER, REFUSED };

/* An instrument that samples: `error` is what each sample is off by, `lost` whether it is, 2: without a trace. */
typedef struct {
    long of, every, late, next, room, first, waiting;
    double gain, bias, quantum, low, high, shown;
    const double *error;
    const signed char *lost;
    double *values;
    long *arrivals;
} Stream;

typedef struct {
    /* the plant */
    void (*step)(double *x, const double *u, double *out, long rows, long hold);
    double *x; /* states, then the inputs that act */
    long n_states, n_inputs, steps, most_late;
    const long *late;    /* steps that an input is late by */
    const double *share; /* of the way to its command that an actuator moves in a step */
    double *past;        /* the last commands, [most_late][n_inputs] */
    double *moved;       /* [steps][n_inputs] */
    double *states;      /* [steps][n_states] */
    long n_streams, tick;
    Stream *streams;
    /* the path, and where X, Y, psi, v_x are in x */
    const double *grid, *size;
    const long *shape, *judged;
    double place, sample, limit;
    long to_the_end;
    /* the driver */
    int (*decide)(void *memory, const double *told, void *commands);
    const void *(*last_plan)(const void *memory);
    void *memory;
    long n_channels, plan_bytes, commands_bytes, wanted, planned, begun;
    const long *channels; /* where in x, or -1 */
    const long *sensors;  /* which stream, or -1 */
    const double *std;
    double *told; /* t, then the channels */
    unsigned char *said, *before;
    const long *command; /* of each input: which command; -1 held, -2 the wanted speed */
    double *held;        /* inputs over a sample */
    /* what is kept */
    const double *noise; /* standard normal, [samples][n_channels] */
    double *rows;        /* t, s, e_y, e_psi, v_x, x; [samples][5 + n_states + n_inputs] */
    unsigned char *plans;
    double *seconds;
    long *planned_at;
    long n_rows, n_plans;
} Loop;

static void take(Stream *s, long tick, const double *x, const double *u, long n_states)
{
    if (tick % s->every) return;
    const long k = s->next++;
    const double v = s->of < n_states ? x[s->of] : u[s->of - n_states];
    double shown = (1.0 + s->gain) * v + s->bias + s->error[k];
    if (s->lost[k] == 2) return;
    if (s->quantum > 0) shown = s->quantum * rint(shown / s->quantum);
    shown = shown < s->low ? s->low : shown > s->high ? s->high : shown;
    const long at = (s->first + s->waiting++) % s->room;
    s->values[at] = s->lost[k] ? NAN : shown;
    s->arrivals[at] = tick + s->late;
}

static double shown(Stream *s, long tick)
{
    for (; s->waiting && s->arrivals[s->first] <= tick; s->waiting--) {
        s->shown = s->values[s->first];
        s->first = (s->first + 1) % s->room;
    }
    return s->shown;
}

/* Holds the commands for a sample. */
static void advance(Loop *l)
{
    const long n = l->n_inputs, most = l->most_late;
    double *acting = l->x + l->n_states;
    for (long k = 0; k < l->steps; k++)
        for (long j = 0; j < n; j++) {
            const long then = most - l->late[j] + k;
            const double wanted = then < most ? l->past[then * n + j] : l->held[j];
            const double now = k ? l->moved[(k - 1) * n + j] : acting[j];
            l->moved[k * n + j] = l->share[j] < 1 ? now + l->share[j] * (wanted - now) : wanted;
        }
    for (long i = 0; i < most; i++)
        memcpy(l->past + i * n, i + l->steps < most ? l->past + (i + l->steps) * n : l->held, (size_t)n * sizeof(double));
    l->step(l->x, l->moved, l->states, l->steps, 1);
    memcpy(acting, l->moved + (l->steps - 1) * n, (size_t)n * sizeof(double));
    for (long i = 0; i < l->n_streams; i++)
        for (long k = 0; k < l->steps; k++)
            take(l->streams + i, l->tick + 1 + k, l->states + k * l->n_states, l->moved + k * n, l->n_states);
    l->tick += l->steps;
}

/* Notes where the plant is; why the drive is over, if it is. */
static int note(Loop *l)
{
    const long n = l->n_states + l->n_inputs;
    double found[3], *row = l->rows + l->n_rows * (5 + n);
    for (long i = 0; i < l->n_states; i++)
        if (!isfinite(l->x[i])) return NO_NUMBER;
    foot(l->grid, l->shape, l->size, l->x[l->judged[0]], l->x[l->judged[1]], l->place, WINDOW, found);
    l->place = found[0];
    row[0] = (double)(l->tick / l->steps) * l->sample;
    row[1] = found[0], row[2] = found[1];
    row[3] = remainder(l->x[l->judged[2]] - found[2], 6.283185307179586);
    row[4] = l->x[l->judged[3]];
    memcpy(row + 5, l->x, (size_t)n * sizeof(double));
    l->n_rows++;
    if (fabs(found[1]) > FAR) return LEFT_PATH;
    if (l->to_the_end && found[0] >= l->size[1]) return FINISHED;
    return row[0] >= l->limit - 1e-9 ? OUT_OF_TIME : GOES_ON;
}

/* Asks the driver, who is told what the sensors show; whether it takes the time that it is called at. */
static int ask(Loop *l)
{
    l->told[0] = l->rows[(l->n_rows - 1) * (5 + l->n_states + l->n_inputs)];
    for (long c = 0; c < l->n_channels; c++) {
        double v = l->sensors[c] >= 0 ? shown(l->streams + l->sensors[c], l->tick) : l->channels[c] >= 0 ? l->x[l->channels[c]] : NAN;
        if (l->std[c] > 0) v += l->std[c] * l->noise[(l->n_rows - 1) * l->n_channels + c];
        l->told[1 + c] = v;
    }
    const double began = monotonic();
    if (l->decide(l->memory, l->told, l->said)) return 0;
    const double spent = monotonic() - began;
    int planned;
    memcpy(&planned, l->said + l->planned, sizeof planned);
    if (planned && !(l->begun && memcmp(l->said, l->before, (size_t)l->commands_bytes) == 0)) {
        memcpy(l->plans + l->n_plans * l->plan_bytes, l->last_plan(l->memory), (size_t)l->plan_bytes);
        l->seconds[l->n_plans] = spent;
        l->planned_at[l->n_plans++] = l->n_rows - 1;
    }
    l->begun = 1;
    memcpy(l->before, l->said, (size_t)l->commands_bytes);
    for (long j = 0; j < l->n_inputs; j++) {
        const long at = l->command[j] == -2 ? l->wanted : l->command[j] * (long)sizeof(double);
        if (l->command[j] != -1) memcpy(l->held + j, l->said + at, sizeof(double));
    }
    return 1;
}

/* Drives on for so many samples; whether and why the drive is over. */
int loop_drive(void *loop, long samples)
{
    Loop *l = loop;
    l->n_rows = l->n_plans = 0;
    for (long i = 0; i < l->n_streams; i++) l->streams[i].next = 0;
    for (long k = 0; k < samples; k++) {
        const int end = note(l);
        if (end == NO_NUMBER) return end;
        if (!ask(l)) return REFUSED;
        if (end != GOES_ON) return end;
        advance(l);
    }
    return GOES_ON;
}

/* Asks many drivers, those that still drive; how many refuse the time. Memories are `bytes` apart. `seconds` has what
 * each took in place of whether it drives. */
int loop_ask(void *decide, unsigned char *memory, long bytes, const double *told, long n_told, unsigned char *said, long n_said, double *seconds, long n)
{
    int (*step)(void *, const double *, void *), refused = 0;
    memcpy(&step, &decide, sizeof step);
    for (long i = 0; i < n; i++)
        if (seconds[i] > 0) {
            const double began = monotonic();
            refused += step(memory + i * bytes, told + i * n_told, said + i * n_said) != 0;
            seconds[i] = monotonic() - began;
        }
    return refused;
}
