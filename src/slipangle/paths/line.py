"""`Line`: a path's samples in compiled C, for what loops ask of it at every step."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files

import numpy as np

from slipangle.codegen.compiler import library

FLAGS = ("-ffp-contract=off",)  # so that the nearest sample is the same one as in NumPy
_FARTHEST = 1e9  # m, arc length and window up to which rows can be counted


class Line:
    """The compiled functions on one path.

    Parameters
    ----------
    grid : array, shape (n, 9)
        X, Y, psi, curvature, v_x, right, left, cos(psi), sin(psi) of each sample.
    closed : bool
        Whether the last sample is the first one again.
    spacing, length : float
        Between samples, of the whole line. [m]
    """

    def __init__(self, loaded: ctypes.CDLL, grid: np.ndarray, closed: bool, spacing: float, length: float) -> None:
        self._kept = grid, np.array([len(grid), closed], dtype=ctypes.c_long), np.array([spacing, length])
        self.data = tuple(array.ctypes.data for array in self._kept)  # addresses of grid, shape and size in C
        self._at, self._feet, self._foot = loaded.line_at, loaded.line_feet, loaded.line_foot
        self._ahead = loaded.line_ahead

    @classmethod
    def of(cls, columns: Sequence[np.ndarray], *, closed: bool, spacing: float, length: float) -> Line | None:
        """From X, Y, psi, curvature, v_x, right, left, shape (n,) each; None without a compiler."""
        source = (files("slipangle.paths") / "line.c").read_text(encoding="utf-8")
        loaded = library(source, name="line", flags=FLAGS)
        if loaded is None:
            return None
        psi = columns[2]
        grid = np.ascontiguousarray(np.column_stack([*columns, np.cos(psi), np.sin(psi)]))
        return cls(loaded, grid, closed, spacing, length)

    def at(self, s: np.ndarray) -> np.ndarray:
        """X, Y, psi, curvature, v_x, right, left at places, shape (7, n)."""
        s = np.ascontiguousarray(s)
        out = np.empty((7, len(s)))
        self._at(*self.data, s.ctypes.data, len(s), out.ctypes.data)
        return out

    def foot(self, X: float, Y: float, near_s: float | None, window: float) -> tuple[float, float, float] | None:
        """s, e_y and psi of the foot of a point; None where the search is beyond counting."""
        near = 0.0 if near_s is None else near_s
        if not (abs(near) < _FARTHEST and 0 <= window < _FARTHEST):
            return None
        out = (ctypes.c_double * 3)()
        self._foot(*self.data, X, Y, near, -1.0 if near_s is None else window, ctypes.addressof(out))
        return out[0], out[1], out[2]

    def feet(self, X: np.ndarray, Y: np.ndarray, near_s: float | None, window: float) -> np.ndarray:
        """Feet of consecutive points, shape (n, 3)."""
        X, Y = np.ascontiguousarray(X), np.ascontiguousarray(Y)
        out = np.empty((len(X), 3))
        near, search = (0.0, -window) if near_s is None else (near_s, window)
        self._feet(*self.data, X.ctypes.data, Y.ctypes.data, len(X), near, search, out.ctypes.data)
        return out

    def ahead(self, s: float, strides: Sequence[tuple[int, float]], v: float, *, constant: bool) -> np.ndarray:
        """Rows ahead, shape (8, n): places, then as `at`; ``v`` is the speed, or what the profile is off by. [m/s]"""
        counts, _, where = _packed(tuple(strides))
        rows = len(counts) + 1
        out = np.empty((8, rows))
        self._ahead(*self.data, s, int(constant), v, *where, rows, out.ctypes.data)
        return out


@lru_cache(maxsize=64)
def _packed(strides: tuple[tuple[int, float], ...]) -> tuple[np.ndarray, np.ndarray, tuple[int, int]]:
    counts = np.array([count for count, _ in strides], dtype=ctypes.c_long)
    steps = np.array([step for _, step in strides])
    return counts, steps, (counts.ctypes.data, steps.ctypes.data)
