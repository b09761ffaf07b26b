/* Whether values can be true; vector_math.h comes before. */

/* Whether all rows lie within the ranges of their columns; NaN lies in none. */
static int plausible(const double *v, int rows, int n, const double *low, const double *high)
{
    int all = 1;
    for (int i = 0; i < rows; i++)
        for (int j = 0; j < n; j++)
            all &= (v[i * n + j] >= low[j]) & (v[i * n + j] <= high[j]);
    return all;
}

/* Zero, but NaN where a number is NaN, infinite, or so large that its square is. */
INLINE V lost(const double *v)
{
    V w;
    memcpy(&w, v, sizeof w);
    return 0 * (w * w);
}

/* Whether no number is NaN, infinite, or so large that its square is; in sums of four that wait for each other once. */
static int moderate(const double *v, int n)
{
    V all = {0};
    double rest = 0;
    int i = 0;
    for (; i + 4 * LANES <= n; i += 4 * LANES)
        all += lost(v + i) + lost(v + i + LANES) + (lost(v + i + 2 * LANES) + lost(v + i + 3 * LANES));
    for (; i + LANES <= n; i += LANES)
        all += lost(v + i);
    for (; i < n; i++)
        rest += 0 * (v[i] * v[i]);
    return rest == 0 && !v_any(all != 0.0);
}
