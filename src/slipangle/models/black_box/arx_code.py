"""C of the free run of an ARX model: past inputs in blocks, past outputs as a recursion, no copy of the record."""

import numpy as np

from slipangle.codegen.compiler import library

LONGEST = 16  # lags up to which the recursion of one output is unrolled

_HEAD = """\
#include <string.h>

#define BLOCK 1024

/* v[k] += sum over t of taps[t] x[k - t] */
static void drive(long n, long count, const double *restrict taps, const double *restrict x, double *restrict v)
{
    long t = 0;
    for (; t + 4 <= count; t += 4) {
        const double a = taps[t], b = taps[t + 1], c = taps[t + 2], d = taps[t + 3];
        for (long k = 0; k < n; k++) v[k] += (a * x[k - t] + b * x[k - t - 1]) + (c * x[k - t - 2] + d * x[k - t - 3]);
    }
    for (; t < count; t++) {
        const double a = taps[t];
        for (long k = 0; k < n; k++) v[k] += a * x[k - t];
    }
}

/* y[k] = v[k] - sum over i of a[i - 1] y[k - i] */
static inline __attribute__((always_inline)) void recur(
    long n, long na, const double *restrict a, const double *restrict v, double *y)
{
    double one = y[-1], two = na > 1 ? y[-2] : 0.0; /* in registers: memory would be in the way of the next sample */
    for (long k = 0; k < n; k++) {
        double sum = v[k];
        for (long i = na; i > 2; i--) sum -= a[i - 1] * y[k - i];
        if (na > 1) sum -= a[1] * two;
        sum -= a[0] * one;
        two = one;
        y[k] = one = sum;
    }
}

static void one_output(long n, long na, const double *a, const double *v, double *y)
{
    switch (na) {
CASES
    default: recur(n, na, a, v, y);
    }
}

static void many_outputs(long n, long na, long ny, const double *a, const double *v, double *y)
{
    for (long k = 0; k < n; k++)
        for (long o = 0; o < ny; o++) {
            const double *row = a + o * na * ny;
            double sum = v[o * BLOCK + k];
            for (long i = na; i > 0; i--)
                for (long p = 0; p < ny; p++) sum -= row[(i - 1) * ny + p] * y[(k - i) * ny + p];
            y[k * ny + o] = sum;
        }
}
"""

_RUN = """
/* a: [output][lag][output], taps: [output][input][lag], c: [output]; past_y, past_u: oldest first; strides in doubles.
   work: past outputs and a block of them, blocks of v, one input with its past. */
void free_run(long n, long na, long ny, long nu, long count, const double *a, const double *taps, const double *c,
              const double *past_y, const double *past_u, const double *u, long row, long column,
              double *out, long out_row, double *work)
{
    const long back = count - 1;
    double *y = work + na * ny, *v = y + BLOCK * ny, *x = v + BLOCK * ny + back;
    memcpy(work, past_y, na * ny * sizeof(double));
    for (long first = 0; first < n; first += BLOCK) {
        const long m = n - first < BLOCK ? n - first : BLOCK;
        for (long o = 0; o < ny; o++)
            for (long k = 0; k < m; k++) v[o * BLOCK + k] = c[o];
        for (long j = 0; j < nu; j++) {
            const double *from = u + j * column;
            for (long k = 1; k <= back; k++)
                x[-k] = first - k >= 0 ? from[(first - k) * row] : past_u[(back + first - k) * nu + j];
            if (row == 1) memcpy(x, from + first, m * sizeof(double));
            else for (long k = 0; k < m; k++) x[k] = from[(first + k) * row];
            for (long o = 0; o < ny; o++) drive(m, count, taps + (o * nu + j) * count, x, v + o * BLOCK);
        }
        if (ny == 1) one_output(m, na, a, v, y);
        else many_outputs(m, na, ny, a, v, y);
        if (out_row == ny) memcpy(out + first * ny, y, m * ny * sizeof(double));
        else
            for (long k = 0; k < m; k++) memcpy(out + (first + k) * out_row, y + k * ny, ny * sizeof(double));
        memmove(work, y + (m - na) * ny, na * ny * sizeof(double));
    }
}
"""
BLOCK = 1024


def source() -> str:
    """C of ``free_run``."""
    cases = "\n".join(f"    case {na}: recur(n, {na}, a, v, y); return;" for na in range(1, LONGEST + 1))
    return _HEAD.replace("CASES", cases) + _RUN


def free_run(
    a: np.ndarray, taps: np.ndarray, c: np.ndarray, past: tuple[np.ndarray, np.ndarray], u: np.ndarray, out: np.ndarray
) -> bool:
    """Write the free run to ``out``; false without a compiler.

    Coefficients of past outputs, on the left of the equation, have shape (n_outputs, na, n_outputs), ``taps``, of the
    present and past inputs, (n_outputs, n_inputs, n_taps), the constants (n_outputs,); ``past`` are outputs and inputs
    before the first row, oldest first. Inputs may have any strides, rows of ``out`` are consecutive numbers.
    """
    loaded = library(source(), name="arx", flags=("-ffp-contract=fast",))
    if loaded is None:
        return False
    ny, na, _ = a.shape
    nu, count = taps.shape[1:]
    if max(na, count) > BLOCK:
        return False
    if any(s % 8 for s in u.strides):
        u = np.ascontiguousarray(u)
    work = np.empty(na * ny + 2 * BLOCK * ny + count + BLOCK)
    past_y, past_u, *coefficients = (np.ascontiguousarray(v, dtype=float) for v in (*past, a, taps, c))
    pointers = [v.ctypes.data for v in (*coefficients, past_y, past_u, u)]
    target = out.ctypes.data, out.strides[0] // 8, work.ctypes.data
    loaded.free_run(len(u), na, ny, nu, count, *pointers, *(s // 8 for s in u.strides), *target)
    return True
