"""The package's function against an oracle: numbers, a batch of numbers, and symbols."""

import casadi as ca
import numpy as np


def agree(ours, oracle, points, tol=1e-10):
    """Assert that ``ours(*columns)`` equals ``oracle(*columns)`` at every row of ``points``, in numbers and symbols.

    Both return a sequence of scalars; each is compared relative to its largest value.
    """
    points = np.asarray(points, dtype=float)
    wanted = np.array([np.broadcast_to(v, len(points)) for v in oracle(*points.T)], dtype=float)
    assert np.isfinite(wanted).all()
    limit = tol * np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-12)
    batch = np.array([np.broadcast_to(v, len(points)) for v in ours(*points.T)], dtype=float)
    _within(batch, wanted, limit, "numbers")
    symbols = [ca.SX.sym(f"z{i}") for i in range(points.shape[1])]
    values = ours(*symbols)
    column = ca.vertcat(*[values[i] for i in range(len(wanted))])
    found = np.asarray(ca.Function("ours", symbols, [column]).map(len(points))(*points.T[:, None, :]))
    _within(found, wanted, limit, "symbols")


def _within(found, wanted, limit, kind):
    miss = ~(np.abs(found - wanted) <= limit)  # NaN misses too
    worst = np.abs(found - wanted).max(axis=1) / np.maximum(np.abs(wanted).max(axis=1), 1e-300)
    assert not miss.any(), (
        f"{kind}: {miss.any(axis=0).sum()} of {wanted.shape[1]} points differ; largest difference of each result over "
        f"its largest value: {np.array2string(worst, precision=2)}"
    )


def uniform(seed, n, *ranges):
    """``n`` random rows, a column per (low, high)."""
    low, high = np.array(ranges, dtype=float).T
    return np.random.default_rng(seed).uniform(low, high, (n, len(ranges)))
