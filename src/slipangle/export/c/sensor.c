/* The sensor by itself. The same numbers as those of `SideSlipStream.take`. */

typedef struct {
    double samples[NEEDED * CAR_CHANNELS]; /* oldest first */
    int64_t known, started;
} Sensor;

#define STARTED 0x51195a17 /* of memory that car_start has made a sensor of */

typedef char car_bytes_are_enough[sizeof(Sensor) <= CAR_BYTES ? 1 : -1];

static Sensor *own(car_sensor *s) { return (Sensor *)(void *)s->memory; }

int car_start(car_sensor *memory, size_t bytes)
{
    if (bytes < sizeof *memory)
        return CAR_TOO_SMALL;
    memset(own(memory), 0, sizeof(Sensor));
    own(memory)->started = STARTED;
    return CAR_OK;
}

void car_restart(car_sensor *memory) { own(memory)->known = 0; }

int car_update(car_sensor *memory, const double channels[CAR_CHANNELS], car_estimate *to)
{
    Sensor *s = own(memory);
    double told[2], seen[LIMITED];
    to->v_y = NAN, to->side_slip = NAN;
    if (s->started != STARTED)
        return CAR_NOT_STARTED;
    memmove(s->samples, s->samples + CAR_CHANNELS, sizeof(double) * (NEEDED - 1) * CAR_CHANNELS);
    memcpy(s->samples + (NEEDED - 1) * CAR_CHANNELS, channels, sizeof(double) * CAR_CHANNELS);
    s->known = s->known < NEEDED ? s->known + 1 : NEEDED;
    if (s->known < NEEDED)
        return CAR_SILENT;
    say(s->samples, told, seen);
    int inside = fabs(told[0]) < INFINITY && channels[CAR_C_V_X] > SLOWEST;
    for (int i = 0; i < LIMITED; i++)
        inside &= seen[i] >= LOWEST[i] && seen[i] <= HIGHEST[i];
    if (!inside)
        return CAR_SILENT;
    to->side_slip = told[0], to->v_y = told[1];
    return CAR_OK;
}
