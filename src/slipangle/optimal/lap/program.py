"""The time-optimal lap as a nonlinear program: two-stage Radau IIA collocation over arc length.

Trapezoidal and Gauss collocation let the stiff lateral motion of a slow car ring from point to point; Radau IIA damps
it. Everything that differs between cars and tracks is a parameter, so that a program is built once for a size.

.. [1] E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., 1996, sec. IV.5.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.models.tires.magic_formula.terms import curved
from slipangle.optimal.lap.car import LapCar, rates, slip

STATES = ("n", "chi", "v_x", "v_y", "r", "delta", "F_x")
N_STATES, N_INPUTS = 7, 2
GRIP = 0.98  # share of an axle's longitudinal limit that is used
WIDEST = 0.21  # rad, slip angle of tires without a peak
RADAU = np.array([[5.0, -1.0], [9.0, 3.0]]) / 12.0  # [1]_ table 5.5
BARRIERS = {1e-4: 0.5, 1e-5: 0.25, 1e-3: 0.25}  # first weights, tried in turn, and their shares of the iterations
_COLUMN = N_STATES + N_INPUTS
_ONLY = {"is_diff_in": [True, False, False, False, False]}  # derivatives by the states alone


class Program(NamedTuple):
    """The program of a size.

    ``nlp`` has the variables, one column of states and input rates per point, and the constraints; ``times`` are the
    durations of the intervals from variables and parameters. [s]
    """

    nlp: dict[str, Any]
    times: ca.Function


def scales(car: LapCar) -> np.ndarray:
    """Usual sizes of the states and of the rates of steering [rad/s] and force. [N/s]"""
    grip, size = 9.81 * 0.5 * (car.mu_f + car.mu_r), car.wheelbase / 2.7
    v = 30.0 * np.sqrt(size * grip / 15.0)
    states = [3.0 * size, 0.1, v, v / 30.0, 15.0 / v, 0.05, 0.5 * car.weight]
    return np.array([*states, 0.3 * car.delta_rate, 0.25 * car.force_rate * car.weight])


def without_peak(car: LapCar) -> tuple[float, float]:
    """For each axle 1 if its lateral force does not peak below a slip angle of `WIDEST`, else 0."""
    found = saturation(WIDEST, WIDEST, car, (0.0, 0.0))
    return float(found[0] < 1.0), float(found[1] < 1.0)


def saturation(alpha_f: Any, alpha_r: Any, p: LapCar, peakless: Any) -> tuple[Any, Any]:
    """How far the axles' slip angles are from those at their peaks, -1 to 1 on the stable side."""
    out = []
    for i, (alpha, C, mu, E, arm) in enumerate(
        ((alpha_f, p.C_f, p.mu_f, p.E_f, p.l_r), (alpha_r, p.C_r, p.mu_r, p.E_r, p.l_f))
    ):
        inside = curved(C * p.wheelbase / (p.shape * mu * p.weight * arm) * alpha, E)
        out.append((1 - peakless[i]) * p.shape * inside / (0.5 * np.pi) + peakless[i] * alpha / WIDEST)
    return out[0], out[1]


def point_of(*, by_parameters: bool = False) -> ca.Function:
    """What happens at a point: rates over arc length, time per metre, what is limited, squared yaw acceleration.

    Its derivatives are by the states, and by the parameters on request.
    """
    felt = ca.SX.sym("felt", len(LapCar.felt()))
    nothing: dict[str, Any] = dict.fromkeys(("mass", "inertia_z", "wheelbase", "l_f", "C_f", "C_r", "power"), felt[0])
    p = LapCar(**nothing).with_values(**{name: felt[i] for i, name in enumerate(LapCar.felt())})
    z, k, size, flags = ca.SX.sym("z", _COLUMN), ca.SX.sym("k"), ca.SX.sym("size", _COLUMN), ca.SX.sym("flags", 2)
    n, chi, v_x, v_y, r, delta, F = (z[i] * size[i] for i in range(N_STATES))
    motion = rates(v_x, v_y, r, delta, F, p)
    pace = (1 - n * k) / (v_x * ca.cos(chi) - v_y * ca.sin(chi))
    over_time = ca.vertcat(v_x * ca.sin(chi) + v_y * ca.cos(chi), r, motion.v_x, motion.v_y, motion.r)
    over_length = (over_time * pace - ca.vertcat(0, k, 0, 0, 0)) / size[:5]
    limited = ca.vertcat(
        *saturation(*slip(v_x, v_y, r, delta, p), p, (flags[0], flags[1])),
        motion.forces.front.use,
        motion.forces.rear.use,
        F * v_x / p.power,
        F / p.drive_force,
        F / p.brake_force,
    )
    names = ["z", "k", "felt", "size", "flags"], ["rates", "pace", "limited", "yaw"]
    outputs = [over_length, pace, limited, motion.r * motion.r * pace]
    return ca.Function("point", [z, k, felt, size, flags], outputs, *names, {} if by_parameters else _ONLY)


@lru_cache(maxsize=8)
def program(intervals: int, closed: bool, *, sensitive: bool = False) -> Program:
    """The program of a number of intervals; with derivatives by the parameters, on request."""
    n = 2 * intervals
    Z, first = ca.MX.sym("Z", _COLUMN, n), ca.MX.sym("first", N_STATES, 0 if closed else 1)
    felt, size, flags = (ca.MX.sym(name, m) for name, m in (("felt", len(LapCar.felt())), ("size", 9), ("flags", 2)))
    k, h, weights = ca.MX.sym("k", 1, n), ca.MX.sym("h", 1, intervals), ca.MX.sym("weights", 3)
    point = point_of(by_parameters=sensitive).map(n)
    over_length, pace, limited, yaw = point(Z, k, ca.repmat(felt, 1, n), ca.repmat(size, 1, n), ca.repmat(flags, 1, n))
    A, B = Z[:, 0::2], Z[:, 1::2]
    before = ca.horzcat(B[:N_STATES, -1] if closed else first, B[:N_STATES, :-1])
    inputs = A[N_STATES:, :]
    per_second = ca.repmat(size[N_STATES:] / size[5:N_STATES], 1, intervals) * inputs
    constraints, times = [], []
    for stage, row in ((A, RADAU[0]), (B, RADAU[1])):
        change = row[0] * over_length[:, 0::2] + row[1] * over_length[:, 1::2]
        passed = h * (row[0] * pace[:, 0::2] + row[1] * pace[:, 1::2])
        constraints.append(stage[:5, :] - before[:5, :] - ca.repmat(h, 5, 1) * change)
        constraints.append(stage[5:N_STATES, :] - before[5:, :] - ca.repmat(passed, 2, 1) * per_second)
        times.append(passed)
    constraints.append(B[N_STATES:, :] - inputs)
    lap_time = ca.sum2(times[1])
    jerk = ca.sum2(h * (RADAU[1][0] * yaw[:, 0::2] + RADAU[1][1] * yaw[:, 1::2]))
    effort = ca.sum2(times[1] * (weights[1] * inputs[0, :] ** 2 + weights[2] * inputs[1, :] ** 2))
    dynamics = ca.vertcat(*constraints)
    g = ca.vec(ca.vertcat(dynamics, limited[:, 0::2], limited[:, 1::2]))
    x, p = ca.vertcat(ca.vec(Z), ca.vec(first)), ca.vertcat(felt, size, flags, weights, ca.vec(k), ca.vec(h))
    nlp = {"x": x, "p": p, "f": lap_time + weights[0] * jerk + effort, "g": g}
    return Program(nlp, ca.Function("times", [x, p], [times[1]]))


@lru_cache(maxsize=8)
def solver(intervals: int, closed: bool, iterations: int, tolerance: float) -> ca.Function:
    """Ipopt for the program of a size."""
    options = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "show_eval_warnings": False,
        "error_on_fail": False,
        "calc_lam_p": False,
        "ipopt.max_iter": iterations,
        "ipopt.tol": tolerance,
        "ipopt.mu_init": next(iter(BARRIERS)),
        "ipopt.acceptable_tol": 10 * tolerance,
        "ipopt.acceptable_constr_viol_tol": 1e-6,
    }
    return ca.nlpsol("lap", "ipopt", program(intervals, closed).nlp, options)


@lru_cache(maxsize=8)
def worth(intervals: int, closed: bool) -> ca.Function:
    """Change of the cost per unit of each parameter of the car, from variables, parameters and multipliers."""
    nlp = program(intervals, closed, sensitive=True).nlp
    multipliers = ca.MX.sym("lam_g", nlp["g"].numel())
    slope = ca.gradient(nlp["f"] + ca.dot(multipliers, nlp["g"]), nlp["p"])
    return ca.Function("worth", [nlp["x"], nlp["p"], multipliers], [slope[: len(LapCar.felt())]])


def limits() -> tuple[np.ndarray, np.ndarray]:
    """Bounds of what is limited at a point."""
    high = np.array([1.0, 1.0, GRIP, GRIP, 1.0, 1.0, np.inf])
    return np.array([-1.0, -1.0, -GRIP, -GRIP, -np.inf, -np.inf, -1.0]), high


def constraint_bounds(intervals: int) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the constraints."""
    zero = np.zeros(2 * N_STATES + N_INPUTS)
    lower, upper = (np.tile(np.concatenate([zero, side, side]), intervals) for side in limits())
    return lower, upper
