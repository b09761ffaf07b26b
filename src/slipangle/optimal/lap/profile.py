"""The quasi-steady speed profile of a line: as fast as the car's g-g-v allows, in passes forward and back."""

from __future__ import annotations

import math

import numpy as np

from slipangle.optimal.lap.envelope import Envelope

_LAPS, _SAME = 200, 1e-6  # around a closed line, until its first speed is again the last


def speed_profile(
    curvature: np.ndarray,
    step: np.ndarray,
    limits: Envelope,
    *,
    closed: bool,
    v_start: float | None = None,
    v_end: float | None = None,
) -> np.ndarray:
    """Largest speeds, shape (n,), along a line. [m/s]

    Parameters
    ----------
    curvature : array, shape (n,)
        Of the line. [1/m]
    step : array, shape (n,) if closed, the last one back to the first sample, else (n - 1,)
        Between the samples, along the line. [m]
    v_start, v_end : float, optional
        Speed at the ends of an open line; free by default. [m/s]
    """
    k = np.abs(np.asarray(curvature, dtype=float))
    v = limits.cornering_speed(k)
    if not closed:
        v[0] = min(v[0], v_start) if v_start is not None else v[0]
        v[-1] = min(v[-1], v_end) if v_end is not None else v[-1]
        v = _pass(v, k, step, limits, limits.drive)
        return _pass(v[::-1], k[::-1], step[::-1], limits, limits.brake)[::-1]
    slow = int(np.argmin(v))  # nothing before the slowest place bounds what comes after it
    v, k, step = np.roll(v, -slow), np.roll(k, -slow), np.roll(step, -slow)
    v, k = np.append(v, v[0]), np.append(k, k[0])
    for _ in range(_LAPS):
        v = _pass(v, k, step, limits, limits.drive)
        v = _pass(v[::-1], k[::-1], step[::-1], limits, limits.brake)[::-1]
        before, v[0] = v[0], min(v[0], v[-1])  # a bend that is no bound for a car that gets no faster until it
        v[-1] = v[0]
        if before - v[0] < _SAME * before:
            break
    return np.roll(v[:-1], slow)


def _pass(v: np.ndarray, k: np.ndarray, step: np.ndarray, limits: Envelope, table: np.ndarray) -> np.ndarray:
    """Speeds that rise no faster than a table of accelerations allows."""
    speeds, shares, most = v.tolist(), limits.share, limits.a_y.tolist()
    grid, rows = limits.v, table.tolist()
    first, spacing, last = float(grid[0]), float(grid[1] - grid[0]), len(grid) - 2
    angle = np.arcsin(shares)
    columns, turn = len(shares) - 2, float(angle[1])
    bend, lengths = k.tolist(), step.tolist()
    for i in range(len(speeds) - 1):
        now = speeds[i]
        at = min(max((now - first) / spacing, 0.0), last + 1.0)
        j = min(int(at), last)
        f = at - j
        limit = most[j] + f * (most[j + 1] - most[j])
        use = min(now * now * bend[i] / limit, 1.0)
        across = math.asin(use) / turn
        c = min(int(across), columns)
        e = across - c
        low, high = rows[j], rows[j + 1]
        a = (1 - f) * (low[c] + e * (low[c + 1] - low[c])) + f * (high[c] + e * (high[c + 1] - high[c]))
        square = now * now + 2 * lengths[i] * a
        speeds[i + 1] = min(speeds[i + 1], math.sqrt(max(square, 0.25 * now * now)))
    return np.array(speeds)
