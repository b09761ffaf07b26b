/* What a path is asked at every step: where it is, the foot of a point, the look ahead. As `path.py` has it in Python.
 *
 * The grid has a row per sample: X, Y, psi, curvature, v_x, right, left, cos(psi), sin(psi). `shape` is n_samples and
 * whether the line is closed, `size` the spacing and the length.
 */
#include <math.h>

#define COLUMNS 9

static double hermite(double a, double b, double da, double db, double t)
{
    return a + t * (da + t * (3 * (b - a) - 2 * da - db + t * (2 * (a - b) + da + db)));
}

static double edge(double a, double b, double t)
{
    if (isfinite(a) && isfinite(b)) return (1 - t) * a + t * b;
    return fmin(a, b);
}

/* X, Y, psi, curvature, v_x, right, left at s; NaN where s is none. */
static void at(const double *grid, const long *shape, const double *size, double s, double *out)
{
    const long n = shape[0], closed = shape[1];
    const double h = size[0], length = size[1];
    const double turns = closed ? floor(s / length) : 0.0;
    const double inside = closed ? s - turns * length : fmin(fmax(s, 0.0), length);
    const double beyond = closed ? 0.0 : s - inside;
    if (!(isfinite(s) && inside >= -length && inside <= 2 * length)) {
        for (int k = 0; k < 7; k++) out[k] = NAN;
        return;
    }
    long i = (long)(inside / h);
    if (i > n - 2) i = n - 2;
    if (i < 0) i = 0;
    const double t = inside / h - (double)i;
    const double *a = grid + i * COLUMNS, *b = a + COLUMNS;
    const double psi = hermite(a[2], b[2], h * a[3], h * b[3], t) + turns * (grid[(n - 1) * COLUMNS + 2] - grid[2]);
    out[0] = hermite(a[0], b[0], h * a[7], h * b[7], t);
    out[1] = hermite(a[1], b[1], h * a[8], h * b[8], t);
    if (beyond != 0.0) {
        out[0] += beyond * cos(psi);
        out[1] += beyond * sin(psi);
    }
    out[2] = psi;
    out[3] = beyond == 0.0 ? (1 - t) * a[3] + t * b[3] : 0.0;
    out[4] = (1 - t) * a[4] + t * b[4];
    out[5] = edge(a[5], b[5], t);
    out[6] = edge(a[6], b[6], t);
}

static double speed_at(const double *grid, const long *shape, const double *size, double s)
{
    const long n = shape[0];
    const double length = size[1];
    double place;
    if (shape[1]) {
        place = fmod(s, length);
        if (place < 0) place += length;
    } else {
        place = fmin(fmax(s, 0.0), length);
    }
    const double position = place / size[0];
    long i = isfinite(position) ? (long)position : 0;
    if (i > n - 2) i = n - 2;
    const double *a = grid + i * COLUMNS;
    return a[4] + (position - (double)i) * (a[COLUMNS + 4] - a[4]);
}

static double squared(const double *row, double X, double Y)
{
    const double x = row[0] - X, y = row[1] - Y;
    return x * x + y * y;
}

/* The sample from row `low` to `high` that is nearest to the point; rows of a closed line go on over its end. */
static double nearest(const double *grid, const long *shape, double X, double Y, double low, double high)
{
    const long n = shape[0], lap = n - 1;
    if (!shape[1]) {
        low = fmin(fmax(low, 0.0), (double)lap);
        high = fmin(fmax(high, 0.0), (double)lap);
    }
    double best = INFINITY, found = low;
    double place = shape[1] ? fmod(low, (double)lap) : low;
    if (place < 0) place += (double)lap;
    long i = (long)place;
    const long rows = (long)(high - low);
    for (long k = 0; k <= rows; k++) {
        const double d = squared(grid + i * COLUMNS, X, Y);
        if (d < best) {
            best = d;
            found = low + (double)k;
        }
        i++;
        if (shape[1] && i == lap) i = 0;
    }
    return found;
}

/* s, e_y, psi of the foot of a point; `search` is near_s and the window, or the window below zero for the whole line. */
static void foot(
    const double *grid, const long *shape, const double *size, double X, double Y, double near, double window, double *out)
{
    const double h = size[0], length = size[1];
    double p[7], s;
    if (window < 0) {
        double best = INFINITY;
        s = 0;
        for (long i = 0; i < shape[0]; i++) {
            const double d = squared(grid + i * COLUMNS, X, Y);
            if (d < best) {
                best = d;
                s = h * (double)i;
            }
        }
    } else {
        s = h * nearest(grid, shape, X, Y, floor((near - window) / h), ceil((near + window) / h));
    }
    for (int k = 0; k < 8; k++) {
        at(grid, shape, size, s, p);
        const double dx = X - p[0], dy = Y - p[1], c = cos(p[2]), d = sin(p[2]);
        const double along = dx * c + dy * d, e_y = dy * c - dx * d;
        const double move = along / fmax(1.0 - p[3] * e_y, 0.3);
        s += (shape[1] || (0 < s && s < length)) ? fmin(fmax(move, -2 * h), 2 * h) : move;
        if (fabs(move) < 1e-10) break;
    }
    at(grid, shape, size, s, p);
    out[0] = s;
    out[1] = (Y - p[1]) * cos(p[2]) - (X - p[0]) * sin(p[2]);
    out[2] = p[2];
}

/* The line at places s[rows], out[7][rows]. */
void line_at(const double *grid, const long *shape, const double *size, const double *s, long rows, double *out)
{
    double p[7];
    for (long k = 0; k < rows; k++) {
        at(grid, shape, size, s[k], p);
        for (int i = 0; i < 7; i++) out[i * rows + k] = p[i];
    }
}

/* Feet out[rows][3] of points, each searched near the one before; a window below zero searches the whole line first. */
void line_feet(const double *grid, const long *shape, const double *size, const double *X, const double *Y, long rows, double near, double window, double *out)
{
    const double width = fabs(window);
    for (long k = 0; k < rows; k++) {
        foot(grid, shape, size, X[k], Y[k], near, window, out + 3 * k);
        near = out[3 * k];
        window = width;
    }
}

/* The foot out[3] of one point. */
void line_foot(const double *grid, const long *shape, const double *size, double X, double Y, double near, double window, double *out)
{
    foot(grid, shape, size, X, Y, near, window, out);
}

/* Rows ahead of s, out[8][rows]: places, then as `line_at`, with the speed that is driven: `mode` 0 the profile plus
 * `v`, never below zero, 1 the speed `v`. Between rows k and k + 1 lie counts[k] strides of steps[k] seconds. */
void line_ahead(const double *grid, const long *shape, const double *size, double s, int mode, double v, const long *counts, const double *steps, long rows, double *out)
{
    double p[7];
    for (long k = 0; k < rows; k++) {
        const double now = mode ? v : fmax(speed_at(grid, shape, size, s) + v, 0.0);
        at(grid, shape, size, s, p);
        out[k] = s;
        for (int i = 0; i < 7; i++) out[(i + 1) * rows + k] = p[i];
        out[5 * rows + k] = now;
        if (k == rows - 1) break;
        for (long j = 0; j < counts[k]; j++) {
            const double h = steps[k];
            if (mode) {
                s += h * v;
            } else {
                const double half = s + 0.5 * h * fmax(speed_at(grid, shape, size, s) + v, 0.0);
                s += h * fmax(speed_at(grid, shape, size, half) + v, 0.0);
            }
        }
    }
}
