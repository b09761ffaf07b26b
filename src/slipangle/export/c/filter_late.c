/* What an extended Kalman filter does with a sample. */

#if DEEPEST > 0
static Sample *ago(Filter *f, int steps) { return &f->past.kept[(f->samples - 1 - steps) % (DEEPEST + 1)]; }

/* Takes in a sample that was kept, and begins the one after it with what comes out. */
static void run_kept(Filter *f, int age)
{
    f->now = *ago(f, age);
    run(f);
    if (age > 0) {
        memcpy(ago(f, age - 1)->z, f->z, sizeof f->z);
        memcpy(ago(f, age - 1)->P, f->P, sizeof f->P);
    }
}

/* Takes in late outputs where they belong, and what came since once more; 0 where that leaves the finite numbers. */
static int again(Filter *f)
{
    double y[NY], gate[NY], error[NY] = {0}, variance[NY] = {0}, taken[NY] = {0};
    int back = 0;
    memcpy(y, f->now.y, sizeof y);
    memcpy(gate, f->now.gate, sizeof gate);
    for (int i = 0; i < NY; i++)
        if (LATE[i] > 0)
            f->now.seen[i] = 0;
    f->samples++;
    *ago(f, 0) = f->now;
    for (int i = 0; i < NY; i++)
        if (LATE[i] > 0 && f->fresh[i] && LATE[i] < f->samples) {
            ago(f, LATE[i])->y[i] = y[i], ago(f, LATE[i])->seen[i] = 1;
            back = LATE[i] > back ? LATE[i] : back;
        }
    for (int age = back; age >= 0; age--) {
        for (int i = 0; i < NY; i++)
            if (LATE[i] == age && f->fresh[i])
                ago(f, age)->gate[i] = gate[i];
        run_kept(f, age);
        for (int i = 0; i < NY; i++)
            if (LATE[i] == age && f->fresh[i])
                error[i] = f->error[i], variance[i] = f->variance[i], taken[i] = f->taken[i];
    }
    if (!stays_finite(f)) { /* forget this sample, and what of it belonged to samples before */
        for (int i = 0; i < NY; i++)
            if (LATE[i] > 0 && f->fresh[i] && LATE[i] < f->samples)
                ago(f, LATE[i])->seen[i] = 0;
        for (int age = back; age > 0; age--)
            run_kept(f, age);
        f->now = *ago(f, 0);
        f->samples--;
        memcpy(f->now.gate, gate, sizeof gate);
        return 0;
    }
    memcpy(f->now.gate, gate, sizeof gate);
    memcpy(f->error, error, sizeof error);
    memcpy(f->variance, variance, sizeof variance);
    memcpy(f->taken, taken, sizeof taken);
    return 1;
}
#else
static int again(Filter *f)
{
    run(f);
    return stays_finite(f);
}
#endif
