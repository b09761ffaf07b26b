"""How good an iterate is after a full step, from the values there; the same measures as in solver.c."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime.interpreted_model import bind, columns, newton_columns, only
from slipangle.optimal.realtime.parts import Implicit


@dataclass(frozen=True, kw_only=True, eq=False)
class Promise:
    """What the linear model makes of a step.

    Errors after it times the roots of their weights, limited rows after it and their multipliers, multipliers of the
    model, the curvature of the cost along the step, and how far it reaches: inputs relative to half their range, states
    in `units`.
    """

    errors: np.ndarray
    limited: np.ndarray
    multipliers: np.ndarray
    pi: np.ndarray
    bend: float
    reach: float

    def left(self, errors: np.ndarray, limited: np.ndarray, defects: np.ndarray) -> float:
        """What is left of stationarity.

        Terms of the Lagrangian beyond the model that the step was computed with, over the curvature of that model along
        the step, are about the share of the step by which the next one corrects it.
        """
        beyond = np.abs(errors * (errors - self.errors)).sum() + np.abs(self.pi[1:] * defects).sum()
        beyond += np.abs(self.multipliers * (limited - self.limited)).sum()
        return self.reach * float(2 * beyond / self.bend if 2 * beyond < self.bend else 1.0)


def reach_of(step: np.ndarray, x: np.ndarray, dx: np.ndarray) -> float:
    """How far a step of the scaled inputs and of the states reaches."""
    return max(float(np.abs(step).max()), float((np.abs(dx[1:]) / units(x)).max()))


def units(rows: np.ndarray) -> np.ndarray:
    """One plus the mean change of each column from row to row, which does not depend on where zero is."""
    return 1 + np.abs(np.diff(rows, axis=0)).mean(axis=0)


def moves_on(x: np.ndarray, states: np.ndarray) -> bool:
    """Whether the state now is nearer to that a step ahead than to the first, as when the vehicle moves on."""
    here, ahead = (np.square((x - at) / units(states)).sum() for at in states[:2])
    return bool(ahead <= here)


class StageValues:
    """Next states, errors and limited quantities of all steps and stages, without derivatives.

    Parameters
    ----------
    ocp : OCP
        The problem.
    node, stage : Function
        What `functions` gives.
    """

    def __init__(self, ocp: OCP, node: ca.Function, stage: ca.Function) -> None:
        n, steps = ocp.horizon, int(ocp.nodes[-1])
        self._nodes, self._held = ocp.nodes, ocp.stage_of
        self._node_in = [np.zeros((steps, node.nnz_in(i) // steps)) for i in range(node.n_in())]
        self._stage_in = [np.zeros((n + 1, stage.nnz_in(i) // (n + 1))) for i in range(stage.n_in())]
        self._node, self._node_out = bind(node, steps, self._node_in)
        self._stage, self._stage_out = bind(stage, n + 1, self._stage_in)

    @staticmethod
    def functions(
        ocp: OCP, parts: Implicit | None, node: ca.Function, stage: ca.Function
    ) -> tuple[ca.Function, ca.Function]:
        """Those of `Functions` without derivatives; of implicit models with the stage slopes."""
        plain = only(node, [0, 3] if parts else [0])
        return newton_columns(ocp, parts, plain, int(ocp.nodes[-1])), columns(only(stage, [0, 1]), ocp.horizon + 1)

    def __call__(
        self, x: np.ndarray, u: np.ndarray, w: np.ndarray, p: np.ndarray, k: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States after each step of the model, errors, limited quantities; stage slopes k are brought up to date."""
        given, n = self._node_in, len(u)
        given[0][:], given[1][:], given[2][:] = x[:-1], u[self._held], w[:n][self._held]
        for _ in range(2 if len(given) > 3 else 1):  # of Newton's method: k belongs to the iterate before
            if len(given) > 3:
                given[3][:] = k
            self._node()
            if len(given) > 3:
                k[:] = self._node_out[1]
        given = self._stage_in
        given[0][:], given[3][:] = x[self._nodes], p
        given[1][:-1], given[1][-1] = u, u[-1]
        given[2][:-1], given[2][-1] = w[:n], w[-1]
        self._stage()
        return self._node_out[0], self._stage_out[0], self._stage_out[1]
