"""From a state derivative to a discrete-time step: Euler, Runge-Kutta 4, Radau IIA.

A derivative is ``f(x, u) -> dx/dt`` written with `slipangle.ops`; a step is ``F(x, u) -> x`` one sample
time later with ``u`` held constant, and works on whatever ``f`` works on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError, nearest
from slipangle.ops import is_symbolic

Derivative = Callable[[Any, Any], Any]
Step = Callable[[Any, Any], Any]
Method = Literal["euler", "rk4", "radau"]


def euler(f: Derivative, dt: float, substeps: int = 1) -> Step:
    """Explicit Euler (first order), the thesis' "Taylor" scheme.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 5-2.
    """
    h = dt / substeps

    def step(x: Any, u: Any) -> Any:
        for _ in range(substeps):
            x = x + h * f(x, u)
        return x

    return step


def rk4(f: Derivative, dt: float, substeps: int = 1) -> Step:
    """Classical Runge-Kutta of fourth order with ``substeps`` equal steps per sample."""
    h = dt / substeps

    def step(x: Any, u: Any) -> Any:
        for _ in range(substeps):
            k1 = f(x, u)
            k2 = f(x + 0.5 * h * k1, u)
            k3 = f(x + 0.5 * h * k2, u)
            k4 = f(x + h * k3, u)
            x = x + (h / 6) * (k1 + 2 * k2 + 2 * k3 + k4)
        return x

    return step


_ROOT6 = np.sqrt(6.0)
# Radau IIA, 3 stages, order 5: Hairer & Wanner, Solving Ordinary Differential Equations II, table IV.5.6.
RADAU_A = np.array(
    [
        [(88 - 7 * _ROOT6) / 360, (296 - 169 * _ROOT6) / 1800, (-2 + 3 * _ROOT6) / 225],
        [(296 + 169 * _ROOT6) / 1800, (88 + 7 * _ROOT6) / 360, (-2 - 3 * _ROOT6) / 225],
        [(16 - _ROOT6) / 36, (16 + _ROOT6) / 36, 1 / 9],
    ]
)


SHORTENED = (1.0, 0.5, 0.2, 0.05, 0.01)  # lengths of a Newton step that are tried
MISSED = 1e-5  # a residual of the stages above this, relative to 1 + |x|, is no solution; one more step follows
RETRY = 16  # shorter steps that then replace one


def radau_iia(f: Derivative, dt: float, n_states: int, n_inputs: int, substeps: int = 1, iterations: int = 12) -> Step:
    """Three-stage Radau IIA (order 5, L-stable): for stiff wheel dynamics.

    The stage equations are solved by ``iterations`` damped Newton steps with the exact Jacobian; where that fails, as
    it may for wheels far past the peak of their tires, 16 shorter steps replace the one. Numbers and symbols go
    through the same CasADi function, so both give the same result.

    ``dt`` is the sample time [s], ``substeps`` are implicit steps per sample, ``iterations`` Newton steps in each.
    """
    h = dt / substeps
    stages, finish, missed = _radau_parts(f, h, n_states, n_inputs, iterations)
    short_stages, short_finish, _ = _radau_parts(f, h / RETRY, n_states, n_inputs, iterations)
    x0, u0 = ca.MX.sym("x", n_states), ca.MX.sym("u", n_inputs)
    again = x0
    for _ in range(RETRY):
        again = short_finish(short_stages(again, u0), again, u0)
    unused = ca.MX.sym("k", n_states, 3)
    retry = ca.Function("retry", [unused, x0, u0], [again], {"is_diff_in": [False, True, True]})
    finish = ca.Function.if_else("finish", finish, retry)
    now = x0
    for _ in range(substeps):
        k = stages(now, u0)
        converged = missed(k, now, u0) <= MISSED**2
        now = finish(converged, k, now, u0)
    advance = ca.Function("radau_iia", [x0, u0], [now])

    def step(x: Any, u: Any) -> Any:
        if is_symbolic(x, u):
            return advance(x, u)
        x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
        if x.ndim == 1:
            return advance(x, u).full()[:, 0]
        return advance.map(x.shape[1])(x, np.broadcast_to(u, (u.shape[0], x.shape[1]))).full()

    return step


def _radau_parts(
    f: Derivative, h: float, n_states: int, n_inputs: int, iterations: int
) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Stage slopes ``(x, u) -> k``, end of the step ``(k, x, u) -> x``, squared residual ``(k, x, u) -> r``.

    The residual is relative to 1 + |x|. Only the end of the step, one more Newton step, is differentiated: at the
    solution that is the implicit function theorem.
    """
    x = ca.SX.sym("x", n_states)
    u = ca.SX.sym("u", n_inputs)
    stages = ca.SX.sym("k", n_states, 3)
    places = [_no_trace(x + h * ca.mtimes(stages, ca.DM(row))) for row in RADAU_A]
    residual = ca.vertcat(*[stages[:, i] - f(place, u) for i, place in enumerate(places)])
    newton = ca.Function("newton", [stages, x, u], [residual, ca.jacobian(residual, ca.vec(stages))])
    size = ca.Function("size", [stages, x, u], [ca.sumsqr(residual)])
    scaled = h * residual / ca.repmat(1 + ca.fabs(x), 3, 1)
    x0, u0 = ca.MX.sym("x", n_states), ca.MX.sym("u", n_inputs)

    def improve(k: ca.MX, now: ca.MX) -> ca.MX:
        r, jacobian = newton(k, now, u0)
        return k - ca.reshape(ca.solve(jacobian, r), n_states, 3)

    def descend(k: ca.MX, now: ca.MX) -> ca.MX:
        """A Newton step shortened to where the residual is least: saturated tires send full steps astray."""
        move = improve(k, now) - k
        best, least = k + SHORTENED[0] * move, size(k + SHORTENED[0] * move, now, u0)
        for share in SHORTENED[1:]:
            tried = size(k + share * move, now, u0)
            better = tried < least
            best, least = ca.if_else(better, k + share * move, best), ca.if_else(better, tried, least)
        return best

    k = ca.MX.zeros(n_states, 3)  # not the slope now, which throws stiff wheels past the peak of the tire
    for _ in range(iterations - 1):
        k = descend(k, x0)
    constant = {"is_diff_in": [False, False]}
    found, last = ca.Function("stages", [x0, u0], [k], constant), ca.MX.sym("k", n_states, 3)
    later = x0 + h * ca.mtimes(improve(last, x0), ca.DM(RADAU_A[2]))
    missed = ca.Function("missed", [stages, x, u], [ca.sumsqr(scaled)], {"is_diff_in": [False, False, False]})
    return found, ca.Function("finish", [last, x0, u0], [later], {"is_diff_in": [False, True, True]}), missed


def _no_trace(x: ca.SX) -> ca.SX:
    """The same numbers, but zero where they are below 1e-46: squares of 1e-160 vanish, and with them pivots."""
    return (x + 1e-30) + (-1e-30)


def radau_equations(f: Derivative, dt: float, n_states: int, n_inputs: int) -> ca.Function:
    """``(x, z, u) -> residual`` of one step of `radau_iia`, for solvers that find the stages themselves.

    The three stages are the columns of ``z``, the last one the state at the end of the step; the residual, of the same
    shape and in units of the state, is ``inv(A) (z - x) - dt f(z)``.
    """
    x, z, u = ca.SX.sym("x", n_states), ca.SX.sym("z", n_states, 3), ca.SX.sym("u", n_inputs)
    inverse = np.linalg.inv(RADAU_A)
    columns = [ca.mtimes(z - ca.repmat(x, 1, 3), ca.DM(inverse[i])) - dt * f(z[:, i], u) for i in range(3)]
    return ca.Function("radau_equations", [x, z, u], [ca.horzcat(*columns)], ["x", "z", "u"], ["residual"])


def discretise(
    f: Derivative, dt: float, *, n_states: int, n_inputs: int, method: Method = "rk4", substeps: int = 1
) -> Step:
    """The step of the named method.

    Raises ParameterError if the method is unknown or ``substeps`` is not positive.
    """
    if substeps < 1:
        raise ParameterError(f"substeps is {substeps}; expected a whole number of at least 1")
    if method == "euler":
        return euler(f, dt, substeps)
    if method == "rk4":
        return rk4(f, dt, substeps)
    if method == "radau":
        return radau_iia(f, dt, n_states, n_inputs, substeps)
    raise ParameterError(
        f"the integrator is {method!r}; {nearest(str(method), ['euler', 'rk4', 'radau'])}: use one of these"
    )
