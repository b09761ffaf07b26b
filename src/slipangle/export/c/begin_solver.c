/* What a solver is made with: weights, limits and settings of its problem. */
static void begin_solver(Work *s)
{
    rt_begin(s);
    memcpy(s->q, OF_ERRORS, sizeof s->q);
    memcpy(s->wr, OF_INPUTS, sizeof s->wr);
    memcpy(s->ws, OF_CHANGES, sizeof s->ws);
    if (N_LIMITS > 0) {
        memcpy(s->plain, PLAIN, sizeof s->plain);
        memcpy(s->square, SQUARE, sizeof s->square);
    }
#ifdef BOUNDS_OF_NODES
    memcpy(s->bounds, BOUNDS, sizeof s->bounds);
#else
    for (int i = 0; i < (N + 1) * NL * 2; i++)
        s->bounds[i] = (i < N * NL * 2 ? BOUNDS : END_BOUNDS)[i % (2 * M1(NL))];
#endif
    s->tolerance = TOLERANCE, s->newton = NEWTON, s->accept = ACCEPT, s->time_limit = INFINITY;
    s->max_iterations = MAX_ITERATIONS, s->fixed = FIXED;
}
