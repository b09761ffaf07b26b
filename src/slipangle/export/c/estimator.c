/* The filter by itself. The same estimates as those of `RecursiveVehicle.update`. */

#define STARTED 0x51195a17 /* of memory that car_start has made an estimator of */

typedef struct {
    Filter filter; /* first, as `own` takes it */
    int64_t started;
} Estimator;

typedef char car_bytes_are_enough[sizeof(Estimator) <= CAR_BYTES ? 1 : -1];

static int64_t *started(car_estimator *e) { return &((Estimator *)(void *)e->memory)->started; }

static Filter *own(car_estimator *e)
{
    Filter *f = (Filter *)(void *)e->memory;
#ifdef HORIZON
    f->past.solver = &e->window;
#endif
    return f;
}

static int all_finite(const double *v, int n)
{
    int all = 1;
    for (int i = 0; i < n; i++)
        all &= is_finite(v[i]);
    return all;
}

int car_start(car_estimator *memory, size_t bytes, const double x[CAR_STATES])
{
    if (bytes < sizeof *memory)
        return CAR_TOO_SMALL;
#ifdef HORIZON
    if (car_window_start(&memory->window, sizeof memory->window) != CAR_WINDOW_OK)
        return CAR_MISALIGNED;
#endif
    filter_begin(own(memory), x);
    *started(memory) = STARTED;
    return all_finite(x, NX) ? CAR_OK : CAR_NOT_FINITE;
}

int car_restart(car_estimator *memory, const double x[CAR_STATES])
{
    Filter *f = own(memory);
    if (*started(memory) != STARTED)
        return CAR_NOT_STARTED;
    if (!all_finite(x, NX))
        return CAR_NOT_FINITE;
    memcpy(f->now.z, x, sizeof(double) * NX);
    for (int a = 0; a < NZ; a++)
        for (int b = 0; b < NZ; b++)
            if (a < NX || b < NX)
                f->now.P[a * NZ + b] = AT_START[a * NZ + b];
    f->now.dt = 0, f->samples = 0; /* the first sample corrects only */
    return CAR_OK;
}

/* What is known before car_start. */
static void say_nothing(car_estimate *to)
{
    memset(to, 0, sizeof *to);
    for (int a = 0; a < NX; a++)
        to->state[a] = NAN, to->state_std[a] = INFINITY;
    for (int i = 0; i < NY; i++)
        to->innovation[i] = to->innovation_std[i] = NAN;
#if CAR_PARAMETERS > 0
    for (int k = 0; k < CAR_PARAMETERS; k++)
        to->parameter[k] = NAN, to->parameter_std[k] = INFINITY;
#endif
#if CAR_BIASES > 0
    for (int k = 0; k < CAR_BIASES; k++)
        to->bias[k] = NAN, to->bias_std[k] = INFINITY;
#endif
}

int car_update(car_estimator *memory, const car_sample *sample, car_estimate *to)
{
    if (*started(memory) != STARTED) {
        say_nothing(to);
        return CAR_NOT_STARTED;
    }
    Filter *f = own(memory);
    const double *z = f->now.z, *P = f->now.P;
    int code = !all_finite(sample->u, NU) ? CAR_NOT_FINITE : filter_take(f, sample->y, sample->u) ? CAR_OK : CAR_DIVERGED;
    memset(to, 0, sizeof *to);
    for (int a = 0; a < NX; a++)
        to->state[a] = z[a], to->state_std[a] = sqrt(P[a * NZ + a]);
    for (int i = 0; i < NY; i++) {
        int fresh = code == CAR_OK && f->fresh[i];
        to->innovation[i] = fresh ? f->error[i] : NAN;
        to->innovation_std[i] = fresh ? sqrt(f->variance[i]) : NAN;
        to->taken[i] = fresh && f->taken[i] > 0;
    }
#if CAR_PARAMETERS > 0
    for (int k = 0; k < CAR_PARAMETERS; k++) {
        int a = NX + k;
        double grown = POSITIVE[k] ? PARAMETERS[k] * exp(z[a]) : PARAMETERS[k] + z[a];
        to->parameter[k] = grown;
        to->parameter_std[k] = sqrt(P[a * NZ + a]) * (POSITIVE[k] ? grown : 1);
    }
#endif
#if CAR_BIASES > 0
    for (int k = 0; k < CAR_BIASES; k++) {
        int a = NX + CAR_PARAMETERS + k;
        to->bias[k] = z[a], to->bias_std[k] = sqrt(P[a * NZ + a]);
    }
#endif
#ifdef HORIZON
    to->failures = f->past.failures;
#endif
    return code;
}
