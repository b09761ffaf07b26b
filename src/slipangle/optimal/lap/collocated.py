"""A lap's program in numbers: values and derivatives, an interval at a time, by the points' equations in C.

`slipangle.optimal.lap.program` says the same in CasADi's symbols, for Ipopt and for the worth of parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import emit, preamble
from slipangle.optimal.lap.car import LapCar
from slipangle.optimal.lap.program import N_STATES, RADAU, point_of

_VALUES = 14  # of a point: rates, pace, what is limited, yaw
LIMITED = slice(6, 13)
_LOOP = """
void lap_values(long n, const double *z, const double *k, const double *rest, double *out)
{
    for (long i = 0; i < n; i++)
        values(z + 9 * i, k + i, rest, rest + FELT, rest + FELT + 9, out + 14 * i);
}
void lap_slopes(long n, const double *z, const double *k, const double *rest, const double *by, double *out,
                double *J, double *H)
{
    for (long i = 0; i < n; i++)
        slopes(z + 9 * i, k + i, rest, rest + FELT, rest + FELT + 9, by + 14 * i, out + 14 * i, J + 98 * i, H + 49 * i);
}
"""


@lru_cache(maxsize=1)
def compiled() -> Any:
    """The points' equations and the recursion in C; None without a compiler."""
    point = point_of()
    given = [ca.SX.sym(point.name_in(i), point.sparsity_in(i)) for i in range(point.n_in())]
    rates, pace, limited, yaw = point.call(given)
    out, by, z = ca.vertcat(rates, pace, limited, yaw), ca.SX.sym("by", _VALUES), given[0]
    J = ca.jacobian(out, z)[:, :N_STATES]
    H = ca.jacobian(ca.mtimes(J.T, by), z)[:, :N_STATES]
    values = ca.Function("values", given, [out])
    slopes = ca.Function("slopes", [*given, by], [out, J, H], {"cse": True})
    source = (files("slipangle.optimal.lap") / "interior.c").read_text(encoding="utf-8")
    code = [preamble("double"), emit(values, "values"), emit(slopes, "slopes")]
    loop = _LOOP.replace("FELT", str(len(LapCar.felt())))
    return library("\n".join([*code, loop, source]), name="lap", flags=("-O3",))


@dataclass(frozen=True, kw_only=True, eq=False)
class Lapped:
    """A lap's program in numbers, see `slipangle.optimal.lap.program.program`, whose scaled variables these are.

    Parameters
    ----------
    rest : array
        The car's parameters, the variables' sizes, and which axles have no peak.
    weights : array, shape (3,)
        Of yaw acceleration and of the scaled rates.
    per_second : array, shape (2,)
        Scaled change of steering angle and force by a unit of their rates.
    k, h : array, shape (n,), (n / 2,)
        Curvature at the points, lengths of the intervals.
    closed : bool
        Whether the last point is where the first interval begins.
    """

    rest: np.ndarray
    weights: np.ndarray
    per_second: np.ndarray
    k: np.ndarray
    h: np.ndarray
    closed: bool


class At(NamedTuple):
    """The program at a place: cost, gaps of the equations (N, 14) and of the limits' slacks. (n, 7)

    ``first`` and ``passed`` are the times from an interval's beginning to its points. [s]
    """

    cost: float
    gap: np.ndarray
    limit: np.ndarray
    first: np.ndarray
    passed: np.ndarray


class Slopes(NamedTuple):
    """Slopes of cost and Lagrangian by the variables, of equations by stage values (E) and inputs (G), of limits (D).

    H are the Lagrangian's Hessians by stage values and inputs, shape (N, 16, 16).
    """

    cost: np.ndarray
    lagrangian: np.ndarray
    E: np.ndarray
    G: np.ndarray
    H: np.ndarray
    D: np.ndarray


class Collocated:
    """The functions of a lap's program on one flat array: points (n, 7), rates (N, 2), first state (7,), slacks."""

    def __init__(self, lap: Lapped, code: Any) -> None:
        self.lap, self.code = lap, code
        self.n, self.N = len(lap.k), len(lap.h)
        self.opened = 0 if lap.closed else N_STATES
        cuts = np.cumsum([7 * self.n, 2 * self.N, self.opened, 7 * self.n])
        self.cuts = [slice(a, b) for a, b in zip([0, *cuts[:-1]], cuts, strict=True)]
        self.size = int(cuts[-1])
        self._z = np.zeros((self.n, 9))
        self._J, self._H = np.zeros((self.n, _VALUES, N_STATES)), np.zeros((self.n, N_STATES, N_STATES))

    def parts(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points, rates, first state and slacks, as views."""
        Z, R, first, S = (w[c] for c in self.cuts)
        return Z.reshape(self.n, 7), R.reshape(self.N, 2), first, S.reshape(self.n, 7)

    def __call__(self, w: np.ndarray) -> At:
        """Values."""
        Z, R, _, _ = self.parts(w)
        z, out, lap = self._z, np.zeros((self.n, _VALUES)), self.lap
        z[:, :7] = Z
        given = (z.ctypes.data, lap.k.ctypes.data, lap.rest.ctypes.data)
        self.code.lap_values(self.n, *given, out.ctypes.data)
        return self._gathered(w, R, out)

    def _gathered(self, w: np.ndarray, R: np.ndarray, out: np.ndarray) -> At:
        lap, (Z, _, first, S) = self.lap, self.parts(w)
        h, A, B = lap.h, out[0::2], out[1::2]
        before = np.roll(Z[1::2], 1, axis=0)
        if self.opened:
            before[0] = first
        turned = [h * (row[0] * A[:, 5] + row[1] * B[:, 5]) for row in RADAU]
        gap = np.empty((self.N, 14))
        for j, row in enumerate(RADAU):
            to = gap[:, 7 * j : 7 * j + 7]
            to[:] = Z[j::2] - before
            to[:, :5] -= h[:, None] * (row[0] * A[:, :5] + row[1] * B[:, :5])
            to[:, 5:] -= turned[j][:, None] * R * lap.per_second
        effort = 1.0 + R**2 @ lap.weights[1:]
        jerk = h @ (RADAU[1][0] * A[:, 13] + RADAU[1][1] * B[:, 13])
        cost = float(turned[1] @ effort + lap.weights[0] * jerk)
        return At(cost, gap, out[:, LIMITED] - S, turned[0], turned[1])

    def slopes(self, w: np.ndarray, at: At, lam: np.ndarray, mu: np.ndarray) -> Slopes:
        """Derivatives, with multipliers of the equations (N, 14) and of the limits. (n, 7)"""
        Z, R, _, _ = self.parts(w)
        lap, h, n, N = self.lap, self.lap.h, self.n, self.N
        turn = R * lap.per_second
        effort = 1.0 + R**2 @ lap.weights[1:]
        by, plain = np.zeros((n, _VALUES)), np.zeros((n, _VALUES))
        for j in range(2):
            mixed = RADAU[0][j] * lam[:, :7] + RADAU[1][j] * lam[:, 7:]
            by[j::2, :5] = -h[:, None] * mixed[:, :5]
            plain[j::2, 5] = h * RADAU[1][j] * effort
            by[j::2, 5] = plain[j::2, 5] - h * np.sum(mixed[:, 5:] * turn, axis=1)
            plain[j::2, 13] = by[j::2, 13] = h * RADAU[1][j] * lap.weights[0]
        by[:, LIMITED] = mu
        J, H, out = self._J, self._H, np.zeros((n, _VALUES))
        self._z[:, :7] = Z
        given = (self._z.ctypes.data, lap.k.ctypes.data, lap.rest.ctypes.data, by.ctypes.data)
        self.code.lap_slopes(n, *given, out.ctypes.data, J.ctypes.data, H.ctypes.data)
        cost, lagrangian = np.zeros(self.size), np.zeros(self.size)
        cost_Z, cost_R, _, _ = self.parts(cost)
        L_Z, L_R, L_first, L_S = self.parts(lagrangian)
        cost_Z[:] = np.einsum("nij,ni->nj", J[:, [5, 13]], plain[:, [5, 13]])
        cost_R[:] = 2 * at.passed[:, None] * lap.weights[1:] * R
        both = lam[:, :7] + lam[:, 7:]
        L_Z[:] = np.einsum("nij,ni->nj", J, by)
        L_Z[0::2] += lam[:, :7]
        L_Z[1::2] += lam[:, 7:]
        if self.opened:
            L_Z[1:-1:2] -= both[1:]
            L_first[:] = -both[0]
        else:
            L_Z[1::2] -= np.roll(both, -1, axis=0)
        timed = at.first[:, None] * lam[:, 5:7] + at.passed[:, None] * lam[:, 12:]
        L_R[:] = cost_R - timed * lap.per_second
        L_S[:] = -mu
        E, G, HH = np.zeros((N, 14, 14)), np.zeros((N, 14, 2)), np.zeros((N, 16, 16))
        for i in range(2):
            for j in range(2):
                block = E[:, 7 * i : 7 * i + 7, 7 * j : 7 * j + 7]
                Jj, share = J[j::2], -h * RADAU[i][j]
                block[:, :5] = share[:, None, None] * Jj[:, :5]
                block[:, 5:] = share[:, None, None] * turn[:, :, None] * Jj[:, 5][:, None, :]
            for m in range(7):
                E[:, 7 * i + m, 7 * i + m] += 1.0
            for m in range(2):
                G[:, 7 * i + 5 + m, m] = -(at.first, at.passed)[i] * lap.per_second[m]
        for j in range(2):
            HH[:, 7 * j : 7 * j + 7, 7 * j : 7 * j + 7] = H[j::2]
            mixed = RADAU[0][j] * lam[:, 5:7] + RADAU[1][j] * lam[:, 12:]
            share = h[:, None] * (2 * RADAU[1][j] * lap.weights[1:] * R - mixed * lap.per_second)
            cross = J[j::2, 5][:, :, None] * share[:, None, :]
            HH[:, 7 * j : 7 * j + 7, 14:] = cross
            HH[:, 14:, 7 * j : 7 * j + 7] = cross.transpose(0, 2, 1)
        for m in range(2):
            HH[:, 14 + m, 14 + m] = 2 * lap.weights[1 + m] * at.passed
        return Slopes(cost, lagrangian, E, G, HH, J[:, LIMITED].copy())
