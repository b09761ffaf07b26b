"""What one optimal control problem asks of its solvers: CasADi functions with derivatives, rows of limits, units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from graphlib import TopologicalSorter
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.derivatives import jacobians
from slipangle.codegen.expression import MOST_INSTRUCTIONS, scalars
from slipangle.models.ode import OdeModel
from slipangle.models.repeated import Repeated, repeated
from slipangle.numerics.integrate import RADAU_A, RETRY
from slipangle.ops import is_symbolic
from slipangle.optimal.ocp import OCP


@dataclass(frozen=True, kw_only=True)
class Implicit:
    """A state derivative whose states fall into a core that feeds back on itself and quadratures behind it."""

    core: tuple[int, ...]
    rest: tuple[int, ...]
    derivative: ca.Function
    slopes: ca.Function
    quadrature: ca.Function
    short_quadrature: ca.Function


def input_scale(ocp: OCP) -> np.ndarray:
    """Unit of each control inside the quadratic program: half its range, or 1."""
    low, high = ocp.input_bounds.T
    with np.errstate(invalid="ignore"):
        half = 0.5 * (high - low)
    return np.where(np.isfinite(half) & (half > 0), half, 1.0)


def implicit(ocp: OCP) -> Implicit | None:
    """The parts of a model integrated by one step of Radau IIA, or None for other models."""
    model = ocp.model
    if not isinstance(model, OdeModel) or model.own_step or model.method != "radau" or model.substeps != 1:
        return None
    x, u, w, full, _ = ocp.symbols(ca.SX)
    rate = model.derivative(x, full)
    if not is_symbolic(rate):
        return None
    derivative = ca.Function("derivative", [x, u, w], [ca.densify(rate)])
    pattern = np.array(ca.DM(ca.jacobian(rate, x).sparsity(), 1).full()) != 0
    core = _core(pattern)
    if not core:
        return None
    behind = [a for a in range(len(pattern)) if a not in core]  # which no cycle goes through
    rest = tuple(TopologicalSorter({a: [b for b in behind if pattern[a, b]] for a in behind}).static_order())
    f = rate[list(core)]
    slopes = ca.Function("core", [x, u, w], [ca.densify(f), *jacobians([f], [x[list(core)], u])])
    quadrature, short = (
        _quadrature(name, derivative, core, rest, h) for name, h in (("whole", model.dt), ("short", model.dt / RETRY))
    )
    return Implicit(
        core=core, rest=rest, derivative=derivative, slopes=slopes, quadrature=quadrature, short_quadrature=short
    )


def _quadrature(
    name: str, derivative: ca.Function, core: tuple[int, ...], rest: Sequence[int], h: float
) -> ca.Function:
    """``(z, x, u, w) -> rest`` after a step of length ``h`` on which the core moves by z to its stages; derivatives."""
    x, u, w = (ca.SX.sym(n, derivative.size1_in(i)) for i, n in enumerate("xuw"))
    z = ca.SX.sym("z", 3, len(core))  # one column per core state
    places = [ca.SX(x) for _ in range(3)]
    for c, a in enumerate(core):
        for j in range(3):
            places[j][a] = x[a] + z[j, c]
    q = rest_after(derivative, rest, h, x, u, w, places)
    flat = ca.vec(z)
    return ca.Function(name, [flat, x, u, w], [q, *jacobians([q], [flat, x, u])])


def rest_after(
    derivative: ca.Function, rest: Sequence[int], h: float, x: Any, u: Any, w: Any, places: list[Any]
) -> Any:
    """States behind the core after a step of length ``h``; ``places`` are the three stages, filled in for them too."""
    later = ca.SX(x)
    for a in rest:
        slope = ca.vertcat(*[derivative(places[j], u, w)[a] for j in range(3)])
        for j in range(3):
            places[j][a] = x[a] + h * ca.mtimes(ca.DM(RADAU_A[j]).T, slope)
        later[a] = x[a] + h * ca.mtimes(ca.DM(RADAU_A[2]).T, slope)
    return later[list(rest)]


def _core(pattern: np.ndarray) -> tuple[int, ...]:
    """States that lie on a cycle of influence or influence one, those with the fewest neighbours first."""
    n = len(pattern)
    reach = pattern.T.copy()  # reach[b, a]: b influences a
    for m in range(n):
        reach |= np.outer(reach[:, m], reach[m])
    cyclic = np.diag(reach)
    core = [b for b in range(n) if cyclic[b] or (reach[b] & cyclic).any()]
    inner = pattern[np.ix_(core, core)]
    degree = inner.sum(axis=0) + inner.sum(axis=1)
    return tuple(core[i] for i in np.argsort(degree, kind="stable"))


def stage_function(ocp: OCP) -> ca.Function:
    """``(x, u, w, p) -> error, limited`` and their derivatives by x and u."""
    base = scalars(ocp.stage)
    x, u, w, _, p = ocp.symbols(ca.SX if base is not None else ca.MX)
    error, limited = (base or ocp.stage)(x, u, w, p)
    return ca.Function("stage", [x, u, w, p], [error, limited, *jacobians([error, limited], [x, u])])


def repeated_steps(ocp: OCP, *, derivatives: bool = True) -> Repeated | None:
    """The problem's steps ``(x, u, w) -> next`` and its derivatives by x and u, one to be taken again and again.

    None where there is nothing to repeat, see `slipangle.models.repeated.repeated`, or there are several models.
    """
    if type(ocp).dynamics is not OCP.dynamics or scalars(ocp.dynamics) is None:
        return None
    x, u, w, full, _ = ocp.symbols(ca.SX)
    own: Any = getattr(ocp.model, "repeated", None) or partial(repeated, ocp.model)
    return own(x, full, given=[x, u, w], by=[x, u] if derivatives else [])


def dynamics_function(ocp: OCP, steps: Repeated | None) -> ca.Function:
    """``(x, u, w) -> next`` and its derivatives by x and u; scalar code, unless that were too long or there is none.

    The steps are those of `repeated_steps`, which are called one after the other where the code would be too long.
    """
    if steps is not None and steps.apart > MOST_INSTRUCTIONS:
        return steps.whole("dynamics")
    base = scalars(ocp.dynamics)
    x, u, w, _, _ = ocp.symbols(ca.SX if base is not None else ca.MX)
    later = (base or ocp.dynamics)(x, u, w)
    return ca.Function("dynamics", [x, u, w], [later, *jacobians([later], [x, u])])


def jump_function(ocp: OCP) -> ca.Function:
    """``(x, u, w) -> next`` of stages that take no time, and its derivatives by x and u."""
    x, u, w, _, _ = ocp.symbols(ca.SX)
    jump: Any = ocp.jump
    later = jump(x, u, w)
    return ca.Function("jump", [x, u, w], [later, *jacobians([later], [x, u])])


def limit_rows(ocp: OCP) -> list[tuple[int, int]]:
    """Stage and index of each limited quantity in the quadratic program."""
    return [(int(i), int(j)) for i, j in np.argwhere(ocp.limited_at)]


def slack_of_rows(ocp: OCP) -> tuple[np.ndarray, np.ndarray]:
    """Plain weight (infinite: hard) and squared weight of each of `limit_rows`, for half the cost."""
    plain, square = np.full(len(ocp.limited), np.inf), np.zeros(len(ocp.limited))
    squares, plains = ocp.slack_weights
    for name, s, p in zip(ocp.soft, squares, plains, strict=True):
        plain[ocp.limited.index(name)], square[ocp.limited.index(name)] = 0.5 * p, s
    stage, which = np.array(limit_rows(ocp), dtype=int).reshape(-1, 2).T
    often = ocp.excess_counts[stage]
    return often * plain[which], often * square[which]
