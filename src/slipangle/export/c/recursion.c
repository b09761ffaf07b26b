/* The recursion by itself. The same estimates as those of `RecursiveARX.update`. */

typedef struct {
    double state[N_STATE];
    int64_t started;
} Recursion;

#define STARTED 0x51195a17 /* of memory that car_start has made a recursion of */

typedef char car_bytes_are_enough[sizeof(Recursion) <= CAR_BYTES ? 1 : -1];

static Recursion *own(car_recursion *r) { return (Recursion *)(void *)r->memory; }

int car_start(car_recursion *memory, size_t bytes)
{
    if (bytes < sizeof *memory)
        return CAR_TOO_SMALL;
    memcpy(own(memory)->state, AT_START, sizeof own(memory)->state);
    own(memory)->started = STARTED;
    return CAR_OK;
}

void car_restart(car_recursion *memory) { own(memory)->state[FILLED] = 0; }

int car_update(car_recursion *memory, const double y[CAR_OUTPUTS], const double u[CAR_INPUTS], car_estimate *to)
{
    double sample[CAR_OUTPUTS + CAR_INPUTS], next[N_STATE];
    Recursion *r = own(memory);
    int code = CAR_OK;
    if (r->started != STARTED) {
        for (int i = 0; i < CAR_OUTPUTS; i++) {
            to->error[i] = NAN;
            for (int j = 0; j < CAR_REGRESSORS; j++)
                to->theta[i][j] = NAN;
            for (int j = 0; j < CAR_OUTPUTS; j++)
                to->noise[i][j] = NAN;
        }
        return CAR_NOT_STARTED;
    }
    memcpy(sample, y, sizeof(double) * CAR_OUTPUTS);
    memcpy(sample + CAR_OUTPUTS, u, sizeof(double) * CAR_INPUTS);
    for (int i = 0; i < CAR_OUTPUTS + CAR_INPUTS; i++)
        if (!(fabs(sample[i]) < INFINITY))
            code = CAR_NOT_FINITE;
        else if (code == CAR_OK && fabs(sample[i]) > LARGEST)
            code = CAR_DIVERGED;
    if (code == CAR_OK) {
        advance(r->state, sample, SETTINGS, next);
        for (int i = 0; i < N_STATE; i++)
            if (!(fabs(next[i]) < INFINITY))
                code = CAR_DIVERGED;
    }
    if (code == CAR_OK)
        memcpy(r->state, next, sizeof next);
    else if (code == CAR_DIVERGED)
        r->state[FILLED] = 0;
    memcpy(to->error, r->state, sizeof to->error);
    memcpy(to->theta, r->state + CAR_OUTPUTS, sizeof to->theta);
    memcpy(to->noise, r->state + CAR_OUTPUTS * (1 + CAR_REGRESSORS), sizeof to->noise);
    return code;
}
