"""Newton's steps of a lap's program: a Riccati recursion over its intervals, in C.

The stage values of an interval follow from its first state and inputs; the cost of the rest of the lap is a parabola in
its first state, of which the recursion goes backward [1]_. A closed lap closes by seven multipliers.

.. [1] G. Frison, J. B. Jorgensen, Efficient implementation of the Riccati recursion, IEEE CCA 2013.
"""

from __future__ import annotations

import numpy as np

from slipangle.optimal.lap.collocated import Collocated, Slopes

_PENALTY = 10.0  # on the gap of a closed lap, which changes no step; so that each interval is convex by itself


class Steps:
    """Newton's steps at one place: a factorisation, and as many right-hand sides as there are corrections."""

    def __init__(self, program: Collocated, fixed: np.ndarray) -> None:
        self.program, self.fixed = program, fixed
        N = program.N
        self._work = np.empty(N * program.code.lap_interval_bytes(), dtype=np.uint8)
        self._shifts = np.empty(N * program.code.lap_shift_bytes(), dtype=np.uint8)
        self._K, self._V, self._S = np.empty((14, 14)), np.empty((7, 7)), np.empty((7, 14))

    def factor(self, at: Slopes, sigma: np.ndarray, shift: float) -> bool:
        """Whether the Hessian, with the barrier's ``sigma`` and a shift on its diagonal, is convex on the equations."""
        program = self.program
        N = program.N
        s_Z, s_R, s_first, self.s_S = program.parts(sigma)
        H = at.H.copy()
        limits = np.einsum("nki,nk,nkj->nij", at.D, self.s_S, at.D, optimize=True)
        for j in range(2):
            H[:, 7 * j : 7 * j + 7, 7 * j : 7 * j + 7] += limits[j::2]
        diagonal = H.reshape(N, 256)[:, ::17]
        diagonal[:, :14] += s_Z.reshape(N, 14) + shift
        diagonal[:, 14:] += s_R + shift
        self.H, self.D = H, at.D
        closed = int(program.lap.closed)
        given = (array.ctypes.data for array in (at.E, at.G, H, self._work, self._V, self._S, self._K))
        if not program.code.lap_factor(N, closed, _PENALTY, *given):
            return False
        K = self._K.copy() if closed else np.zeros((7, 7))
        K[:7, :7] += self._V
        if closed:
            K[:7] += self._S
            K[:, :7] += self._S.T
        else:
            K += np.diag(s_first + shift)
            K[self.fixed], K[:, self.fixed] = 0.0, 0.0
            K[self.fixed, self.fixed] = 1.0
        self.K = 0.5 * (K + K.T)
        if not np.isfinite(K).all():
            return False
        scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(self.K)), 1e-300))
        values = np.linalg.eigvalsh(self.K * scale[:, None] * scale)
        return int((values > 0).sum()) == 7 and int((values < 0).sum()) == len(K) - 7

    def solve(self, slope: np.ndarray, gap: np.ndarray, limit: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Change of the variables, and the multipliers after it, from the barrier's slope and the gaps."""
        program = self.program
        N = program.N
        g_Z, g_R, g_first, g_S = program.parts(slope)
        g = np.empty((N, 16))
        pushed = g_Z + np.einsum("nki,nk->ni", self.D, g_S + self.s_S * limit)
        g[:, :14], g[:, 14:] = pushed.reshape(N, 14), g_R
        gap = np.ascontiguousarray(gap)
        p0, k0, v, lam = np.empty(7), np.empty(14), np.empty((N, 16)), np.empty((N, 14))
        addresses = [a.ctypes.data for a in (self.H, gap, g, self._work, self._shifts, p0, k0)]
        program.code.lap_backward(N, *addresses)
        parameters = np.zeros(14)
        if program.lap.closed:
            right = k0
            right[:7] += p0
            parameters[:] = -np.linalg.solve(self.K, right)
        else:
            right = p0 + g_first
            right[self.fixed] = 0.0
            parameters[:7] = -np.linalg.solve(self.K, right)
        first = parameters[:7].copy()
        given = (self.H, g, first, parameters if program.lap.closed else np.zeros(14), self._work, self._shifts, v, lam)
        program.code.lap_forward(N, *(a.ctypes.data for a in given))
        step = np.empty(program.size)
        d_Z, d_R, d_first, d_S = program.parts(step)
        d_Z[:], d_R[:] = v[:, :14].reshape(program.n, 7), v[:, 14:]
        if program.opened:
            d_first[:] = first
        d_S[:] = np.einsum("nki,ni->nk", self.D, d_Z) + limit
        return step, lam, g_S + self.s_S * d_S
