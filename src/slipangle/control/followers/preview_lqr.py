"""LQR with preview: the optimal steering law of the linear bicycle that knows the curvature ahead."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import linalg

from slipangle.control.followers.followers import PathFollower, pose_of, posed_bicycle
from slipangle.errors import ParameterError
from slipangle.fields import NotNegative, Positive
from slipangle.models.model import Model
from slipangle.models.vehicles.parameters import BicycleParams


@dataclass(frozen=True, kw_only=True)
class PreviewLQR(PathFollower):
    """Linear-quadratic regulator of the bicycle's path errors that knows the curvature ahead. [1]_, [2]_

    The errors ``e_y, e_y', e_psi, e_psi'`` of the linear bicycle obey a linear system disturbed by the path's
    curvature; discretised at ``dt`` and augmented by the steering angle, so that its change is weighted, its optimal
    law is feedback plus a weighted sum of the curvatures at every step of the horizon. Gains are computed at `speeds`
    and interpolated.

    Parameters
    ----------
    params : BicycleParams
        Car with cornering stiffness per axle; one with downforce ``at_speed``, that at which it is driven.
    weight_y, weight_psi : float
        On the squared distance [1/m2] and heading error [1/rad2].
    weight_change : float
        On the squared change of steering angle per step. [1/rad2]
    speeds : sequence of float
        Where the gains are computed, rising. [m/s]
    slip : float
        Largest slip angle asked of the front tires, past whose peak more steering no longer helps. [rad]

    The others are those of `PathFollower`.

    References
    ----------
    .. [1] R. Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, sec. 2.5 and 3.1.
    .. [2] R. S. Sharp, V. Valtetsiotis, Optimal preview car steering control, Vehicle System Dynamics 35 (2001).
    """

    params: BicycleParams  # type: ignore[override]  # the narrower set
    weight_y: Positive = 1.0
    weight_psi: NotNegative = 20.0
    weight_change: Positive = 300.0
    speeds: Sequence[float] = (2.0, 5.0, 8.0, 11.0, 14.0, 17.0, 20.0, 25.0, 30.0, 40.0, 55.0)
    slip: float = 0.12

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.speeds) <= 0 or any(not b > a for a, b in pairwise(self.speeds)):
            raise ParameterError(f"the schedule's speeds are {tuple(self.speeds)}; expected positive, rising ones")

    @cached_property
    def model(self) -> Model:  # type: ignore[override]  # made once
        """The bicycle on the ground."""
        return posed_bicycle(self.params, self.dt)

    def errors(self, v_x: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (4, 4), B (4, 1) and E (4, 1) of ``e' = A e + B delta + E v_x curvature`` at a speed. [1]_ eq. 2.45"""
        p, v = self.params, v_x
        f, r = p.C_f, p.C_r
        a = (f + r) / p.mass
        b = (f * p.l_f - r * p.l_r) / p.mass
        c = (f * p.l_f - r * p.l_r) / p.inertia_z
        d = (f * p.l_f**2 + r * p.l_r**2) / p.inertia_z
        A = np.array([[0, 1, 0, 0], [0, -a / v, a, -b / v], [0, 0, 0, 1], [0, -c / v, c, -d / v]], dtype=float)
        B = np.array([[0.0], [f / p.mass], [0.0], [f * p.l_f / p.inertia_z]])
        E = np.array([[0.0], [-b / v - v], [0.0], [-d / v]])
        return A, B, E

    @cached_property
    def gains(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the errors and the last angle, shape (n_speeds, 5); of the curvatures, (n_speeds, horizon + 1)."""
        feedback, preview = zip(*[self._gains(v) for v in self.speeds], strict=True)
        return np.array(feedback), np.array(preview)

    def _gains(self, v: float) -> tuple[np.ndarray, np.ndarray]:
        """Riccati equation with the change of angle as input; then the disturbance's share, step by step."""
        A, B, E = self.errors(v)
        block = np.zeros((6, 6))
        block[:4, :4], block[:4, 4:5], block[:4, 5:] = A, B, E * v
        hold = linalg.expm(block * self.dt)
        F = np.zeros((5, 5))
        F[:4, :4], F[:4, 4], F[4, 4] = hold[:4, :4], hold[:4, 4], 1.0
        G = np.append(hold[:4, 4], 1.0)[:, None]
        D = np.append(hold[:4, 5], 0.0)
        Q = np.diag([self.weight_y, 0.0, self.weight_psi, 0.0, 0.0])
        P = linalg.solve_discrete_are(F, G, Q, np.array([[self.weight_change]]))
        inverse = 1.0 / float(self.weight_change + (G.T @ P @ G)[0, 0])
        K = inverse * (G.T @ P @ F)[0]
        closed = F - G @ K[None]
        share, effect = np.empty(self.horizon + 1), P @ D
        for j in range(self.horizon + 1):
            share[j] = inverse * float(G[:, 0] @ effect)
            effect = closed.T @ effect
        return K, share

    def law(self, x: np.ndarray, ahead: np.ndarray, v_x: float, last: float) -> float:
        """See the class."""
        v_y, r, X, Y, psi = x
        x0, y0, angle = pose_of(ahead, 0)
        e_y = -(X - x0) * math.sin(angle) + (Y - y0) * math.cos(angle)
        e_psi = math.remainder(psi - angle, 2 * math.pi)
        rates = v_y + v_x * e_psi, r - v_x * float(ahead[0, 3])
        v = min(max(v_x, self.speeds[0]), self.speeds[-1])
        feedback, preview = (_between(v, self.speeds, table) for table in self.gains)
        error = np.array([e_y, rates[0], e_psi, rates[1], last])
        angle = last - float(feedback @ error) - float(preview @ ahead[:, 3])
        along = math.atan2(v_y + self.params.l_f * r, max(v_x, self.speeds[0]))  # where the front axle goes
        return min(max(angle, along - self.slip), along + self.slip)


def _between(v: float, speeds: Sequence[float], table: np.ndarray) -> np.ndarray:
    """Row of a table at a speed, straight lines between."""
    i = int(np.clip(np.searchsorted(speeds, v) - 1, 0, len(speeds) - 2))
    t = (v - speeds[i]) / (speeds[i + 1] - speeds[i])
    return (1 - t) * table[i] + t * table[i + 1]
