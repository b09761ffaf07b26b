"""Difference equations sample by sample, from rest. L. C. Sousa, PhD thesis, PUC-Rio, 2023 (S); L. Ljung, System
Identification, 2nd ed., 1999 (L). Signals before the first sample are zero, or their offsets where there are some.
"""

import numpy as np

from tests.oracles.tires import perceptron


def past(values, k):
    """A sample, or zero before the first."""
    return values[k] if k >= 0 else np.zeros_like(values[0])


def first_order_lag(u, lag, dt):
    """z of ``lag z' = u - z`` at the samples, from rest, u being a parabola through three samples up to it."""
    nodes, weights = np.polynomial.legendre.leggauss(40)
    t, dt_t = (nodes - 1) / 2 * dt, weights / 2 * dt
    u, z = [u[0], u[0], *u], [u[0]]
    for k in range(3, len(u)):
        parabola = np.polyfit([-2 * dt, -dt, 0.0], u[k - 2 : k + 1], 2)
        z.append(z[-1] * np.exp(-dt / lag) + np.sum(dt_t * np.exp(t / lag) / lag * np.polyval(parabola, t)))
    return np.array(z)


def arx(A, B, c, nk, u, y_start):
    """S 4-5 with the sign of table 7.1: y(k) = -A_1 y(k-1) - ... + B_1 u(k-nk) + ... + c, after ``y_start``."""
    y = [np.array(row, dtype=float) for row in y_start]
    for k in range(len(y), len(u)):
        value = np.array(c, dtype=float)
        for i, a in enumerate(A, start=1):
            value = value - a @ y[k - i]
        for j, b in enumerate(B):
            value = value + b @ past(u, k - nk - j)
        y.append(value)
    return np.array(y)


def narx(weights, biases, activation, na, nb, nk, u, y_start):
    """S 4-14: the network of y(k-1), ..., y(k-na), u(k-nk), ..., u(k-nk-nb+1), all channels of a sample together."""
    y = [np.array(row, dtype=float) for row in y_start]
    for k in range(len(y), len(u)):
        lags = [y[k - i] for i in range(1, na + 1)] + [past(u, k - nk - j) for j in range(nb)]
        y.append(np.array(perceptron(np.concatenate(lags), weights, biases, activation)))
    return np.array(y)


def filtered(numerator, denominator, signal):
    """``numerator(q) / denominator(q)`` applied to a signal; coefficients of 1, q^-1, q^-2, ..."""
    out = []
    for k in range(len(signal)):
        value = sum(b * past(signal, k - j) for j, b in enumerate(numerator))
        out.append(value - sum(a * past(out, k - i) for i, a in enumerate(denominator) if i and k >= i))
    return np.array(out)


def polynomial(A, B, C, D, F, nk, u, y, u_offset, y_offset):
    """L 4.33: A y = sum of B_i / F_i u_i + C / D e. The free run, e = 0, and the one-step-ahead prediction.

    ``B`` starts at the delay ``nk``; A, C, D and F go without their leading 1.
    """
    A, C, D = ([1.0, *p] for p in (A, C, D))
    forced = 0.0
    for i, (b, f, delay) in enumerate(zip(B, F, nk, strict=True)):
        forced = forced + filtered([0.0] * delay + list(b), [1.0, *f], u[:, i] - u_offset[i])
    free = filtered([1.0], A, forced) + y_offset
    left = filtered(A, [1.0], y - y_offset) - forced  # C / D e
    e = filtered(D, C, left)
    return free, y - e


def innovation_form(A, B, C, D, K, u, y, u_offset, y_offset):
    """L 4.92: x+ = A x + B (u - u0) + K e, y = C x + D (u - u0) + y0 + e. The one-step-ahead prediction from x = 0."""
    x, found = np.zeros(len(A)), []
    for u_k, y_k in zip(u - u_offset, y, strict=True):
        expected = C @ x + D @ u_k + y_offset
        found.append(expected)
        x = A @ x + B @ u_k + K @ (y_k - expected)
    return np.array(found)


def speed_weights(v, speeds, *, smooth):
    """S fig. 7.3: hat functions of the speeds, constant beyond them; smooth ones rise as 3 t^2 - 2 t^3."""
    hats = [np.interp(v, speeds, row) for row in np.eye(len(speeds))]
    return [h * h * (3 - 2 * h) if smooth else h for h in hats]


def narendra(u):
    """S A-1, A-2, from rest."""
    y = []
    for k in range(len(u)):
        x1, x2, x3 = (y[k - i] if k >= i else 0.0 for i in (1, 2, 3))
        x4, x5 = (u[k - i] if k >= i else 0.0 for i in (1, 2))
        y.append((x1 * x2 * x3 * x5 * (x3 - 1) + x4) / (1 + x2**2 + x3**2))
    return y
