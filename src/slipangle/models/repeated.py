"""A sample of many explicit steps, of which one is written out and repeated.

What a controller or a filter steps is the equations of motion inside wrappers: inputs are late, the pose follows,
disturbances push. All but the equations happens once a sample, before their steps or after them, so the code does not
grow with these, and one step stays in the processor's cache of instructions while it is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import is_dataclass, replace
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from slipangle.codegen.derivatives import jacobians
from slipangle.codegen.expression import scalar_code
from slipangle.models.model import Model
from slipangle.models.ode import OdeModel
from slipangle.numerics.integrate import discretise
from slipangle.ops import is_symbolic

MOST_MORE = 1.05  # instructions of steps that are repeated over those of all written out, which linear ones make few
S = TypeVar("S", "Repeated", ca.Function, "Repeated | ca.Function")
_LOOP = """\
static void {name}({arguments})
{{
    {kind} s[2][{n}], v[{m}];
    {name}_begin({given}, s[0], v);
    for (int i = 0; i < {times}; i++)
        {name}_step(s[i % 2], v, s[(i + 1) % 2]);
    {name}_end({given}, s[{last}], {results});
}}
"""


class Repeated(NamedTuple):
    """A step of a model, and its derivatives, in three: what comes first, one explicit step, and what is left.

    The column s holds the states of the equations and, in a fixed order, their derivatives by the states that the steps
    began with and by those of v that anything moves; v are the inputs of the equations and the parameters.
    """

    begin: ca.Function  # (given) -> s, v
    short: ca.Function  # (s, v) -> s a step later
    end: ca.Function  # (given, s) -> results
    times: int
    apart: int  # instructions of all steps and their derivatives, each by where it begins

    @property
    def n_instructions(self) -> int:
        """Of a sample, as they are executed."""
        return self.begin.n_instructions() + self.times * self.short.n_instructions() + self.end.n_instructions()

    def shorter(self, written_out: ca.Function | None) -> bool:
        """Whether it is worth to repeat rather than to write out; None is what has no scalar instructions."""
        return written_out is None or self.n_instructions <= MOST_MORE * written_out.n_instructions()

    def whole(self, name: str) -> ca.Function:
        """``(given) -> results``, as calls of the three."""
        given = [ca.MX.sym(self.begin.name_in(i), self.begin.sparsity_in(i)) for i in range(self.begin.n_in())]
        s, v = self.begin(*given)
        for _ in range(self.times):
            s = self.short(s, v)
        return ca.Function(name, given, self.end.call([*given, s]))

    def code(self, name: str, kind: str, written: Callable[[ca.Function, str], str]) -> list[str]:
        """C of ``NAME(given, results)``, of numbers of that kind, by what writes a function of scalar instructions."""
        given = [f"i{k}" for k in range(self.begin.n_in())]
        results = [f"o{k}" for k in range(self.end.n_out())]
        arguments = [*(f"const {kind} *restrict {a}" for a in given), *(f"{kind} *restrict {r}" for r in results)]
        loop = _LOOP.format(
            name=name,
            kind=kind,
            arguments=", ".join(arguments),
            given=", ".join(given),
            results=", ".join(results),
            n=self.begin.size1_out(0),
            m=max(self.begin.size1_out(1), 1),
            times=self.times,
            last=self.times % 2,
        )
        parts = {"begin": self.begin, "step": self.short, "end": self.end}
        return [*(written(function, f"{name}_{part}") for part, function in parts.items()), loop]


def repeated(
    model: Model, x: Any, u: Any, *, given: Sequence[Any], by: Sequence[Any] = (), parameters: Any = None
) -> Repeated | None:
    """The three parts; None where a sample is one step, or one of the model's own, or has no scalar instructions.

    Parameters
    ----------
    model : Model
        Its parameters may be expressions of ``parameters``.
    x, u : casadi.SX
        State and inputs, expressions of ``given``.
    given, by : sequence of casadi.SX
        Columns of symbols: the arguments, and those by which the results after the first, the state later, are its
        derivatives.
    parameters : casadi.SX, optional
        Those of ``given`` that move the equations themselves.
    """
    found = chain(model, x, u, by=by, parameters=parameters)
    if found is None:
        return None
    last, (Y, D) = ca.vertcat(found.later), found.carried.matrices
    around_by = jacobians([last], [*by, found.end]) if by else []
    derivatives = [
        direct + ca.mtimes(around_by[-1], ca.mtimes(Y, y_b) + ca.mtimes(D, v_b[found.moved, :]))
        for direct, y_b, v_b in zip(around_by, found.start_by, found.inputs_by, strict=False)
    ]
    begin = ca.Function("begin", [*given], [found.column, ca.densify(found.inputs)])
    end = ca.Function("end", [*given, found.symbols], [ca.densify(last), *derivatives], {"cse": True})
    short, times = found.short, found.equations.substeps
    parts = Repeated(begin, short, end, times, times * found.alone)
    return parts if all(scalar_code(f) is not None for f in parts[:3]) else None


class Chain(NamedTuple):
    """Equations whose steps are repeated, and what stands before and behind them, as expressions of what is given."""

    equations: OdeModel
    start: Any  # y, that the steps begin with
    inputs: Any  # v, of the equations, and parameters
    start_by: list[Any]  # derivatives of both
    inputs_by: list[Any]
    moved: list[int]  # entries of v that these move
    short: ca.Function
    alone: int  # instructions of a step and its derivatives by where it begins
    carried: Carried
    end: Any  # symbols, y behind the last step
    later: Any  # what comes of these and of what is given

    @property
    def column(self) -> Any:
        """s, as the steps begin with it."""
        n = self.equations.n_states
        return self.carried.column(self.start, ca.SX.eye(n), ca.SX(n, len(self.moved)))

    @property
    def symbols(self) -> Any:
        """s, behind the last step."""
        return ca.vertcat(self.end, *self.carried.symbols)


def chain(model: Model, x: Any, u: Any, *, by: Sequence[Any] = (), parameters: Any = None) -> Chain | None:
    """What `repeated` makes its parts of, with the same arguments; None where a sample has no steps to be repeated."""
    if not model.n_inputs:
        return None
    seen: list[tuple[Any, Any]] = []

    def end_of(y: Any, v: Any) -> Any:
        seen.append((ca.vertcat(y), ca.vertcat(v)))
        return end

    found = _around(model, end_of)
    if found is None:
        return None
    around, equations = found
    end = ca.SX.sym("y", equations.n_states)
    later = around.step(x, u)
    if len(seen) != 1:
        return None
    y, v = seen[0][0], ca.vertcat(seen[0][1], ca.SX(0, 1) if parameters is None else parameters)
    first = jacobians([y, v], by) if by else []
    y_by, v_by = first[: len(by)], first[len(by) :]
    moved = [i for i in range(v.shape[0]) if any(m[i, :].nnz() for m in v_by)]
    one = _short_step(equations, moved, parameters, derivatives=bool(by))
    return None if one is None else Chain(equations, y, v, y_by, v_by, moved, *one, end, later)


def followed(step: S, given: Sequence[Any], at: Sequence[Any], then: Callable[..., list[Any]]) -> S:
    """What comes of the results of a step, as one more of its kind.

    Parameters
    ----------
    step : Repeated or Function
        Of some arguments.
    given, at : sequence of casadi.SX or casadi.MX
        Symbols that are the arguments now, and the expressions of them that are those of the step.
    then : callable
        From the results of the step to those wanted.
    """
    parts = isinstance(step, Repeated)
    between = [ca.SX.sym("s", step.short.size1_in(0))] if parts else []
    end: Any = step.end if parts else step
    made = then(*end.call([*at, *between]))
    whole = ca.Function("followed", [*given, *between], made, {"cse": True})
    if not parts:
        return whole  # type: ignore[return-value]
    return step._replace(begin=ca.Function("begin", [*given], step.begin(*at)), end=whole)


def as_one(step: Repeated | ca.Function) -> ca.Function:
    """A function to be called."""
    return step.whole("repeated") if isinstance(step, Repeated) else step


def one_step(model: OdeModel) -> Callable[[Any, Any], Any]:
    """``(y, v) -> y`` one of the steps of a sample later."""
    sizes = {"n_states": model.n_states, "n_inputs": model.n_inputs}
    return discretise(model.derivative, model.dt / model.substeps, method=model.method, substeps=1, **sizes)


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


class Carried(NamedTuple):
    """Which derivatives of the states y, by those at the start and by what moves, can be nonzero."""

    by_start: np.ndarray
    by_input: np.ndarray
    symbols: tuple[Any, Any]  # columns of them

    @property
    def matrices(self) -> tuple[Any, Any]:
        """Of the symbols."""
        made = []
        for pattern, column in zip(self[:2], self.symbols, strict=True):
            matrix = ca.SX(*pattern.shape)
            for k, (i, j) in enumerate(np.argwhere(pattern).tolist()):
                matrix[i, j] = column[k]
            made.append(matrix)
        return made[0], made[1]

    def column(self, y: Any, by_start: Any, by_input: Any) -> Any:
        """All in one, zeros too: it is written where those of two steps before were."""
        pairs = (by_start, self.by_start), (by_input, self.by_input)
        nonzero = [matrix[i, j] for matrix, pattern in pairs for i, j in np.argwhere(pattern).tolist()]
        return ca.densify(ca.vertcat(y, *nonzero))


def _short_step(
    model: OdeModel, moved: list[int], parameters: Any, *, derivatives: bool
) -> tuple[ca.Function, int, Carried] | None:
    """One of the steps on top of those before, and how long it is alone; None without symbols."""
    n = model.n_states
    step = one_step(model)
    y, inputs = ca.SX.sym("y", n), ca.SX.sym("v", model.n_inputs)
    v = ca.vertcat(inputs, *([] if parameters is None else [parameters]))
    later = step(y, inputs)
    if not is_symbolic(later):
        return None
    later = ca.vertcat(later)
    by_y, by_v = jacobians([later], [y, v[moved]]) if derivatives else (ca.SX(n, n), ca.SX(n, 0))
    one, more = (np.array(ca.DM(m.sparsity(), 1).full()).reshape(m.shape) != 0 for m in (by_y, by_v))
    by_start, by_input = np.eye(n, dtype=bool) & derivatives, more
    for _ in range(min(n, model.substeps) if derivatives else 0):
        by_start, by_input = by_start | one @ by_start, more | one @ by_input
    symbols = ca.SX.sym("Y", int(by_start.sum())), ca.SX.sym("D", int(by_input.sum()))
    carried = Carried(by_start, by_input, symbols)
    Y, D = carried.matrices
    column = carried.column(later, ca.mtimes(by_y, Y), by_v + ca.mtimes(by_y, D))
    alone = ca.Function("alone", [y, v], [later, by_y, by_v]).n_instructions()
    return ca.Function("short", [ca.vertcat(y, *symbols), v], [column], {"cse": True}), alone, carried
