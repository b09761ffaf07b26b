"""A sample of many explicit steps, of which one is written out and repeated.

What a controller steps is the equations of motion inside wrappers: inputs are late, the pose follows, disturbances
push. All but the equations happens once a sample, before their steps or after them, so the code does not grow with
these, and one step stays in the processor's cache of instructions while it is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import is_dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.codegen.derivatives import jacobians
from slipangle.codegen.expression import scalar_code, scalars
from slipangle.models.model import Model
from slipangle.models.ode import OdeModel
from slipangle.numerics.integrate import discretise
from slipangle.optimal.ocp import OCP

_LOOP = """\
static void explicit_dynamics(const V *restrict x, const V *restrict u, const V *restrict w, V *restrict next,
                              V *restrict A, V *restrict B)
{{
    V y[2][{n}], v[{m}], Y[2][{n} * {n}], D[2][{n} * {m}];
    begin_steps(x, u, w, y[0], v);
    memset(Y, 0, sizeof Y), memset(D, 0, sizeof D);
    for (int a = 0; a < {n}; a++)
        Y[0][a * {n} + a] = v_all(1.0);
    for (int i = 0; i < {times}; i++)
        short_step(y[i % 2], v, Y[i % 2], D[i % 2], y[(i + 1) % 2], Y[(i + 1) % 2], D[(i + 1) % 2]);
    end_steps(x, u, w, y[{last}], Y[{last}], D[{last}], next, A, B);
}}

static void explicit_values(const V *restrict x, const V *restrict u, const V *restrict w, V *restrict next)
{{
    V y[2][{n}], v[{m}];
    begin_steps(x, u, w, y[0], v);
    for (int i = 0; i < {times}; i++)
        short_values(y[i % 2], v, y[(i + 1) % 2]);
    end_values(x, u, w, y[{last}], next);
}}
"""


class Repeated(NamedTuple):
    """A step of a problem's model in three: what comes first, one of the explicit steps, and what is left.

    ``y`` are the states of the equations and ``v`` their inputs; Y and D are the derivatives of y by the states that
    the steps began with and by those inputs that x or u moves. As arguments they are dense, by row.
    """

    begin: ca.Function  # (x, u, w) -> y, v
    short: ca.Function  # (y, v, Y, D) -> those of y, Y and D a step later
    end: ca.Function  # (x, u, w, y, Y, D) -> next and its derivatives by x and u
    times: int
    apart: int  # instructions of all steps and their derivatives, each by where it begins

    @property
    def n_instructions(self) -> int:
        """Of a sample, as they are executed."""
        return self.begin.n_instructions() + self.times * self.short.n_instructions() + self.end.n_instructions()

    def whole(self) -> ca.Function:
        """``(x, u, w) -> next`` and derivatives, as calls of the three."""
        x, u, w = (ca.MX.sym(name, self.begin.size1_in(i)) for i, name in enumerate("xuw"))
        y, v = self.begin(x, u, w)
        Y, D = ca.MX.eye(y.shape[0]), ca.MX(*self.short.size_out(2))
        for _ in range(self.times):
            y, Y, D = self.short(y, v, _by_row(Y), _by_row(D))
        return ca.Function("dynamics", [x, u, w], list(self.end(x, u, w, y, _by_row(Y), _by_row(D))))

    def code(self, columns: Callable[[ca.Function, str], str]) -> list[str]:
        """C of ``explicit_dynamics`` and ``explicit_values``, by what writes a function of scalar instructions."""
        x, u, w, y, Y, D = (ca.SX.sym(name, self.end.size1_in(i)) for i, name in enumerate(("x", "u", "w", *"yYD")))
        later = self.end(x, u, w, y, Y, D)[0]
        values = ca.Function("end", [x, u, w, y], [later])
        now, v = (ca.SX.sym(name, self.short.size1_in(i)) for i, name in enumerate("yv"))
        step = ca.Function("short", [now, v], [self.short(now, v, ca.SX(Y.shape[0], 1), ca.SX(D.shape[0], 1))[0]])
        parts = {"begin_steps": self.begin, "short_step": self.short, "short_values": step}
        parts |= {"end_steps": self.end, "end_values": values}
        n, m = self.begin.size1_out(0), self.begin.size1_out(1)
        loop = _LOOP.format(n=n, m=m, times=self.times, last=self.times % 2)
        return [*(columns(function, name) for name, function in parts.items()), loop]


def repeated(ocp: OCP) -> Repeated | None:
    """The three parts; None where a sample is one step, or one of the model's own, or that of more than one model."""
    if type(ocp).dynamics is not OCP.dynamics or ocp.model.n_inputs == 0 or scalars(ocp.dynamics) is None:
        return None
    seen: list[tuple[Any, Any]] = []

    def end_of(y: Any, v: Any) -> Any:
        seen.append((ca.vertcat(y), ca.vertcat(v)))
        return y_end

    found = _around(ocp.model, end_of)
    if found is None:
        return None
    model, equations = found
    y_end = ca.SX.sym("y", equations.n_states)
    x, u, w, full, _ = ocp.symbols(ca.SX)
    later = ca.vertcat(model.step(x, full))
    if len(seen) != 1:
        return None
    y, v = seen[0]
    y_x, y_u, v_x, v_u = jacobians([y, v], [x, u])
    moved = [i for i in range(v.shape[0]) if v_x[i, :].nnz() + v_u[i, :].nnz()]
    short, alone, by_start, by_input = _short_step(equations, moved)
    Y, Y_read = _matrix("Y", by_start)
    D, D_read = _matrix("D", by_input)
    next_x, next_u, next_y = jacobians([later], [x, u, y_end])
    A = next_x + ca.mtimes(next_y, ca.mtimes(Y, y_x) + ca.mtimes(D, v_x[moved, :]))
    B = next_u + ca.mtimes(next_y, ca.mtimes(Y, y_u) + ca.mtimes(D, v_u[moved, :]))
    begin = ca.Function("begin", [x, u, w], [ca.densify(y), ca.densify(v)])
    end = ca.Function("end", [x, u, w, y_end, Y_read, D_read], [ca.densify(later), A, B])
    parts = Repeated(begin, short, end, equations.substeps, equations.substeps * alone)
    return parts if all(scalar_code(f) is not None for f in parts[:3]) else None


def _around(model: Model, step: Callable[[Any, Any], Any]) -> tuple[Model, OdeModel] | None:
    """The model with another step of the equations inside, and these; None where a sample is one step, or their own."""
    if isinstance(model, OdeModel):
        if model.own_step or model.method == "radau" or model.substeps == 1:
            return None
        other = object.__new__(type(model))
        vars(other).update(vars(model), _step=step)
        return other, model
    inside = getattr(model, "model", None) if is_dataclass(model) else None
    found = _around(inside, step) if isinstance(inside, Model) else None
    return None if found is None else (replace(model, model=found[0]), found[1])  # type: ignore[type-var]


def _short_step(model: OdeModel, moved: list[int]) -> tuple[ca.Function, int, np.ndarray, np.ndarray]:
    """One of the steps, its derivatives on top of those before; how long it is alone; where these can be nonzero."""
    sizes = {"n_states": model.n_states, "n_inputs": model.n_inputs}
    step = discretise(model.derivative, model.dt / model.substeps, method=model.method, substeps=1, **sizes)
    y, v = ca.SX.sym("y", model.n_states), ca.SX.sym("v", model.n_inputs)
    later = ca.vertcat(step(y, v))
    by_y, by_v = jacobians([later], [y, v[moved]])
    one, more = (np.array(ca.DM(m.sparsity(), 1).full()) != 0 for m in (by_y, by_v))
    by_start, by_input = np.eye(model.n_states, dtype=bool), more
    for _ in range(min(model.n_states, model.substeps)):
        by_start, by_input = by_start | one @ by_start, more | one @ by_input
    Y, Y_read = _matrix("Y", by_start)
    D, D_read = _matrix("D", by_input)
    # All that is read is written, zeros too: both lie where the derivatives of two steps before were.
    Y_later, D_later = ca.mtimes(by_y, Y), by_v + ca.mtimes(by_y, D)
    results = [ca.densify(later), ca.project(Y_later, Y.sparsity()), ca.project(D_later, D.sparsity())]
    alone = ca.Function("alone", [y, v], [later, by_y, by_v]).n_instructions()
    return ca.Function("short", [y, v, Y_read, D_read], results), alone, by_start, by_input


def _matrix(name: str, pattern: np.ndarray) -> tuple[Any, Any]:
    """A matrix of that pattern, and the vector, dense and by row, that it is read from."""
    read = ca.SX.sym(name, pattern.size)
    matrix = ca.SX(*pattern.shape)
    for i, j in np.argwhere(pattern).tolist():
        matrix[i, j] = read[i * pattern.shape[1] + j]
    return matrix, read


def _by_row(matrix: ca.MX) -> ca.MX:
    return ca.vec(ca.densify(matrix).T)
