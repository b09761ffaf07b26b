"""The quadratic program of one step without a compiler: limits of inputs, rates and states, hard or at a price."""

from __future__ import annotations

import daqp
import numpy as np

from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime.interpreted_truth import FACTORED
from slipangle.optimal.realtime.parts import input_scale, slack_of_rows
from slipangle.optimal.solution import Status

STAYS = 0.9  # share of an excess over hard limits that a step leaves where nothing brings it down
BENT = 1e-9  # curvature lent to slacks, which may have none of their own


class LimitedStep:
    """Best step of the scaled inputs within all limits, by DAQP; one slack per soft limit.

    ``plain`` and ``square`` are the weights of an excess over each limited row, ``soft`` says where plain is finite,
    ``rated`` which changes of inputs have limits.
    """

    def __init__(self, ocp: OCP) -> None:
        n, nu = ocp.horizon, len(ocp.controls)
        self._ocp, self._scale = ocp, np.tile(input_scale(ocp), n)
        self.plain, self.square = slack_of_rows(ocp)
        self.soft = np.isfinite(self.plain)
        self._hard = np.flatnonzero(~self.soft)
        self.rated = np.flatnonzero(np.isfinite(ocp.step_bounds).any(axis=2))
        self.reach = np.inf  # most that a step may change an input, in units of its range
        self._change = (np.eye(n * nu) - np.eye(n * nu, k=-nu))[self.rated] * self._scale

    def price(self, price: float) -> None:
        """Put hard limits at a price, where no step keeps them, or, without one, make them hard again."""
        self.plain[self._hard] = price or np.inf
        self.soft[self._hard] = price > 0

    def missed(self, limited: np.ndarray, bounds: np.ndarray) -> float:
        """Largest excess of values of the limited rows over limits that are hard."""
        over = np.maximum(limited - bounds[:, 1], bounds[:, 0] - limited)[self._hard]
        return float(over.max(initial=0.0))

    def stays(self, limited: np.ndarray, after: np.ndarray, bounds: np.ndarray) -> bool:
        """Whether a step leaves nearly as much excess over limits that are hard as there is."""
        low, high = bounds[self._hard].T
        both = limited[self._hard], after[self._hard]
        here, later = (np.maximum(np.maximum(v - high, low - v), 0.0).sum() for v in both)
        return bool(later >= STAYS * here)

    def solve(
        self, H: np.ndarray, g: np.ndarray, L: np.ndarray, u: np.ndarray, applied: np.ndarray, bounds: np.ndarray
    ) -> tuple[Status, np.ndarray, np.ndarray]:
        """Scaled step and multipliers of the limited rows.

        Parameters
        ----------
        H, g : array, shape (n, n) and (n,)
            Hessian and gradient by the scaled inputs.
        L : array, shape (n_rows, n + 1)
            Limited rows by the scaled inputs and, in the last column, their values without a step.
        u, applied : array, shape (horizon, n_controls) and (n_controls,)
            Inputs now and before.
        bounds : array, shape (n_rows, 2)
            Of the limited rows.
        """
        ocp, n, size = self._ocp, len(u), len(g)
        soft, hard, limits = np.flatnonzero(self.soft), np.flatnonzero(~self.soft), len(self.plain)
        many, rates = len(soft), len(self.rated)
        H = H + np.eye(size) * FACTORED * max(np.diag(H).max(), 1e-300)
        low, high = ((np.tile(b, n) - u.ravel()) / self._scale for b in ocp.input_bounds.T)
        low, high = np.maximum(low, -self.reach), np.minimum(high, self.reach)
        change = (u - np.vstack([applied, u[:-1]])).ravel()[self.rated]
        step_low, step_high = (ocp.step_bounds[..., k].ravel()[self.rated] - change for k in (0, 1))
        below, above = bounds[:, 0] - L[:, -1], bounds[:, 1] - L[:, -1]
        if rates == 0 and limits == 0:
            A, lower, upper = np.zeros((0, size)), low, high
        else:
            top = np.hstack([np.vstack([self._change, L[hard, :-1]]), np.zeros((rates + len(hard), many))])
            one, inf = np.eye(many), np.full(many, np.inf)
            A = np.vstack([top, np.hstack([L[soft, :-1], -one]), np.hstack([L[soft, :-1], one])])
            lower = np.concatenate([low, np.zeros(many), step_low, below[hard], -inf, below[soft]])
            upper = np.concatenate([high, inf, step_high, above[hard], above[soft], inf])
            own = np.diag(self.square[soft] + BENT)
            H = np.block([[H, np.zeros((size, many))], [np.zeros((many, size)), own]])
            g = np.concatenate([g, self.plain[soft]])
        given = np.ascontiguousarray(H), g, np.ascontiguousarray(A), np.minimum(upper, 1e30), np.maximum(lower, -1e30)
        z, flag, info = _solved(given)
        paid = np.asarray(z)[size:] if flag == 1 else np.zeros(0)
        if paid.any():  # once more with that curvature about what is paid, where it changes nothing
            again = _solved((given[0], np.concatenate([g[:size], g[size:] - BENT * paid]), *given[2:]))
            z, flag, info = again if again[1] == 1 else (z, flag, info)
        multipliers = np.zeros(limits)
        if flag != 1:
            return (Status.INFEASIBLE if flag == -1 else Status.FAILED), np.zeros(size), multipliers
        if limits:
            lam = np.asarray(info["lam"])[size + many + rates :]
            multipliers[hard] = lam[: len(hard)]
            multipliers[soft] = lam[len(hard) : len(hard) + many] + lam[len(hard) + many :]
        return Status.SOLVED, np.asarray(z)[:size], multipliers


def _solved(given: tuple[np.ndarray, ...]) -> tuple[np.ndarray, int, dict]:
    """Solution, flag and what else DAQP says."""
    z, _, flag, info = daqp.solve(*given, primal_tol=1e-9, dual_tol=1e-10)
    if flag not in (1, -1):  # it may go in circles among slacks of plain weight, whose own curvature is tiny
        z, _, flag, info = daqp.solve(*given, primal_tol=1e-9, dual_tol=1e-10, eps_prox=1e-6)
    if flag not in (1, -1):  # or about multipliers that are large beside its tolerance
        size = max(float(np.abs(given[1]).max()), 1.0)
        z, _, flag, info = daqp.solve(given[0] / size, given[1] / size, *given[2:], primal_tol=1e-9, dual_tol=1e-10)
        info["lam"] = size * np.asarray(info["lam"])
    return z, flag, info


def secant(H: np.ndarray, step: np.ndarray, change: np.ndarray) -> np.ndarray:
    """BFGS correction, damped after Powell."""
    z = H @ step
    old, seen = float(z @ step), float(change @ step)
    if not old > 0:
        return H
    keep = 0.8 * old / (old - seen) if seen < 0.2 * old else 1.0
    y = keep * change + (1 - keep) * z
    return H + np.outer(y, y) / float(y @ step) - np.outer(z, z) / old
