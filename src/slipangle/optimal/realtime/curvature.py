"""Second derivatives of a Lagrangian, node by node: what an exact Hessian adds to squares of errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca

from slipangle.codegen.compiler import compiler
from slipangle.codegen.derivatives import jacobians
from slipangle.codegen.expression import scalars
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.repeated import Chain, chain, one_step
from slipangle.optimal.joined import Joined
from slipangle.optimal.linked import Linked
from slipangle.optimal.ocp import OCP

_SWEEPS = """\
static void {name}(const {kind} *restrict x, const {kind} *restrict u, const {kind} *restrict w,
    const {kind} *restrict p, const {kind} *restrict pi, const {kind} *restrict mu, const {kind} *restrict nu,
    {kind} *restrict M)
{{
    {kind} s[{times} + 1][{n}], v[{m}], r[2][{k}];
    {steps}_begin(x, u, w, s[0], v);
    for (int i = 0; i < {times}; i++)
        {steps}_step(s[i], v, s[i + 1]);
    {name}_turn(x, u, w, pi, s[{times}], r[{times} % 2]);
    for (int i = {times} - 1; i >= 0; i--)
        {name}_back(s[i], v, r[(i + 1) % 2], r[i % 2]);
    {name}_end(x, u, w, p, pi, mu, nu, s[{times}], r[0], M);
}}
"""


class Sweeps(NamedTuple):
    """The curvature of steps that are repeated: forth through them, and back from each to the one before.

    The column s is that of `slipangle.models.repeated.Repeated`, of which each step has its own. Another one, r, goes
    back from step to step: the derivatives of the Lagrangian by y and by those of v that anything moves, and the lower
    half of its second ones by where the steps began and by these v, as far as the steps behind have added to them.
    """

    begin: ca.Function  # (x, u, w) -> s, v
    short: ca.Function  # (s, v) -> s a step later
    turn: ca.Function  # (x, u, w, pi, s) -> r
    back: ca.Function  # (s, v, r) -> r a step earlier
    end: ca.Function  # (x, u, w, p, pi, mu, nu, s, r) -> M
    times: int

    def whole(self) -> ca.Function:
        """As `curvature_function`, as calls."""
        given = [ca.MX.sym(self.end.name_in(i), self.end.size1_in(i)) for i in range(7)]
        x, u, w, _, pi, *_ = given
        s, v = self.begin(x, u, w)
        columns: list[Any] = [s]
        for _ in range(self.times):
            columns.append(self.short(columns[-1], v))
        r = self.turn(x, u, w, pi, columns[-1])
        for column in columns[-2::-1]:
            r = self.back(column, v, r)
        return ca.Function("curvature", given, [self.end(*given, columns[-1], r)])

    def code(self, name: str, steps: str, kind: str, written: Callable[[ca.Function, str], str]) -> list[str]:
        """C of ``NAME(x, u, w, p, pi, mu, nu, M)`` behind that of the ``steps``; see `Repeated.code`."""
        sizes = {"n": self.begin.size1_out(0), "m": max(self.begin.size1_out(1), 1), "k": self.turn.size1_out(0)}
        parts = {"turn": self.turn, "back": self.back, "end": self.end}
        loop = _SWEEPS.format(name=name, steps=steps, kind=kind, times=self.times, **sizes)
        return [*(written(function, f"{name}_{part}") for part, function in parts.items()), loop]


def curvature_function(ocp: OCP) -> ca.Function:
    """``(x, u, w, p, pi, mu, nu) -> M``: Hessian by x and u of ``pi next + mu limited + nu error``, in half the cost.

    Raises
    ------
    ParameterError
        If dynamics or stage have no scalar code.
    """
    dynamics = scalars(ocp.dynamics)
    given, _, at_node = _at_node(ocp)
    if dynamics is None or at_node is None:
        raise ParameterError(
            "the exact Hessian needs equations of elementary functions, which this model has not; expected such a "
            "model, or RealTime() with Gauss-Newton steps"
        )
    x, u, w, _, pi, *_ = given
    hessian = _hessian(at_node + ca.dot(pi, dynamics(x, u, w)), ca.vertcat(x, u))
    return ca.Function("curvature", given, [ca.densify(hessian)])


def curvature_sweeps(ocp: OCP) -> Sweeps | None:
    """The same of steps that are repeated, see `slipangle.models.repeated`; None where there are none."""
    given, inputs, at_node = _at_node(ocp)
    x, u, w, _, pi, *_ = given
    z = ca.vertcat(x, u)
    steps = None if hasattr(ocp.model, "repeated") else chain(ocp.model, x, inputs, by=[z])
    if steps is None or at_node is None:
        return None
    carried, many, n = ca.horzcat(*steps.carried.matrices), len(steps.moved), steps.equations.n_states
    lower = [(i, j) for i in range(n + many) for j in range(i + 1)]
    by_y, by_v, g = ca.SX.sym("by_y", n), ca.SX.sym("by_v", many), ca.SX.sym("g", len(lower))
    G = ca.SX(n + many, n + many)
    for value, (i, j) in zip(ca.vertsplit(g), lower, strict=True):
        G[i, j] = G[j, i] = value

    def column(first: Any, second: Any) -> Any:
        return ca.densify(ca.vertcat(first, *(second[i, j] for i, j in lower)))

    r = ca.vertcat(by_y, by_v, g)
    begin = ca.Function("begin", [x, u, w], [steps.column, ca.densify(steps.inputs)])
    behind = ca.dot(pi, ca.vertcat(steps.later))
    at_end = ca.mtimes(carried.T, ca.mtimes(_hessian(behind, steps.end), carried))
    first = ca.vertcat(ca.gradient(behind, steps.end), ca.SX(many, 1))
    turn = ca.Function("turn", [x, u, w, pi, steps.symbols], [column(first, at_end)], {"cse": True})
    s, v, first, second = _one_back(steps, by_y)
    first = ca.vertcat(first[:n], by_v + first[n:])
    back = ca.Function("back", [s, v, r], [column(first, G + second)], {"cse": True})
    (y_by,), (v_by,) = steps.start_by, steps.inputs_by
    began = ca.vertcat(y_by, v_by[steps.moved, :])
    mixed = ca.mtimes(jacobians([ca.gradient(behind, z)], [steps.end])[0], ca.mtimes(carried, began))
    before = ca.dot(by_y, steps.start) + ca.dot(by_v, steps.inputs[steps.moved])
    hessian = _hessian(at_node + behind + before, z) + mixed + mixed.T + ca.mtimes(began.T, ca.mtimes(G, began))
    end = ca.Function("end", [*given, steps.symbols, r], [ca.densify(_mirrored(hessian))], {"cse": True})
    return Sweeps(begin, steps.short, turn, back, end, steps.equations.substeps)


def _one_back(steps: Chain, weights: Any) -> tuple[Any, Any, Any, Any]:
    """Symbols s and v of a step; first derivatives of its weighed result by y and v, and second ones as r has them."""
    n, many = steps.equations.n_states, len(steps.moved)
    y, v = ca.SX.sym("y", n), ca.SX.sym("v", steps.inputs.shape[0])
    weighed, by = ca.dot(weights, ca.vertcat(one_step(steps.equations)(y, v))), ca.vertcat(y, v[steps.moved])
    from_start = ca.vertcat(ca.horzcat(*steps.carried.matrices), ca.horzcat(ca.SX(many, n), ca.SX.eye(many)))
    second = ca.mtimes(from_start.T, ca.mtimes(_hessian(weighed, by), from_start))
    return ca.vertcat(y, *steps.carried.symbols), v, ca.gradient(weighed, by), second


def _at_node(ocp: OCP) -> tuple[list[Any], Any, Any]:
    """Arguments of `curvature_function`, the model's inputs, and what of the Lagrangian is no dynamics.

    The last is None where it has no scalar code.
    """
    stage = scalars(ocp.stage)
    x, u, w, inputs, p = ocp.symbols(ca.SX)
    pi, mu, nu = (ca.SX.sym(n, k) for n, k in (("pi", x.shape[0]), ("mu", len(ocp.limited)), ("nu", len(ocp.tracked))))
    given = [x, u, w, p, pi, mu, nu]
    if stage is None:
        return given, inputs, None
    error, limited = stage(x, u, w, p)
    return given, inputs, ca.dot(nu, error) + (ca.dot(mu, limited) if ocp.limited else 0)


def _hessian(value: Any, by: Any) -> Any:
    """Second derivatives, by elimination, which takes half the products; the same on both sides of the diagonal."""
    return _mirrored(jacobians([ca.gradient(value, by)], [by])[0])


def _mirrored(matrix: Any) -> Any:
    return ca.tril(matrix) + ca.tril(matrix, False).T


def require_curvature(ocp: OCP) -> None:
    """Raise unless a problem has an exact Hessian here.

    Raises
    ------
    ParameterError
        With what stands in its way.
    """
    what = in_the_way(ocp)
    if what:
        raise ParameterError(f"{what}, which the exact Hessian does not go with; expected Gauss-Newton: RealTime()")


def in_the_way(ocp: OCP) -> str:
    """What stands in the way of an exact Hessian; nothing where the problem has one here."""
    return unfit(ocp) if compiler() else "there is no C compiler"


def unfit(ocp: OCP) -> str:
    """What in a problem itself stands in the way of an exact Hessian."""
    base = ocp.base if isinstance(ocp, Joined) else ocp
    phases = isinstance(base, Linked)
    model: Any = None if phases else base.model
    wrong = {
        "the problem has several phases": phases,
        "its stages are several steps long": base.steps is not None,
        "the model steps by an implicit integrator": isinstance(model, OdeModel) and model.method == "radau",
    }
    return next((what for what, found in wrong.items() if found), "")
