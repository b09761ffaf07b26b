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

/* Whether no number is NaN, infinite, or so large that its square is. */
static int moderate(const double *v, int n)
{
    V all = {0}, w;
    double rest = 0;
    int i = 0;
    for (; i + LANES <= n; i += LANES) {
        memcpy(&w, v + i, sizeof w);
        all += 0 * (w * w);
    }
    for (; i < n; i++)
        rest += 0 * (v[i] * v[i]);
    return rest == 0 && !v_any(all != 0.0);
}
