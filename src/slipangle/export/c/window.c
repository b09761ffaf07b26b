/* The solver behind the functions of the header. */

#define ALIGNED sizeof(V)

typedef char car_window_bytes_are_enough[sizeof(Work) <= CAR_WINDOW_BYTES ? 1 : -1];

static Work *own(car_window *w) { return (Work *)(void *)w->memory; }

int car_window_start(car_window *memory, size_t bytes)
{
    Work *s = own(memory);
    if (bytes < sizeof(Work))
        return CAR_WINDOW_TOO_SMALL;
    if ((uintptr_t)s % ALIGNED)
        return CAR_WINDOW_MISALIGNED;
    memset(s, 0, sizeof *s);
    begin_solver(s);
    return CAR_WINDOW_OK;
}

car_window_parts car_window_at(car_window *memory)
{
    Work *s = own(memory);
    car_window_parts parts = {s->x0, s->w, s->u, s->x};
    return parts;
}

int car_window_solve(car_window *memory)
{
    Work *s = own(memory);
    s->fresh = GIVEN;
    int status = rt_solve(s);
    return status == SOLVED || status == ITERATED;
}
