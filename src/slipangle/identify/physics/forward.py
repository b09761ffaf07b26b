"""Free runs with forward sensitivities of a parametrised ODE: compiled C where there is a compiler, else CasADi."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import emit, preamble
from slipangle.codegen.integrators import explicit_step
from slipangle.errors import ParameterError
from slipangle.models.fast import evaluate, roll_out
from slipangle.models.ode import Parametrised
from slipangle.numerics.integrate import MISSED, RADAU_A, RETRY, SHORTENED, discretise

_ITERATIONS = 12  # of Newton's method, as in the integrator itself


@dataclass(frozen=True)
class ForwardRun:
    """A free run with its derivatives, see `forward`; and whether it is compiled, that is fast."""

    call: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    compiled: bool

    def __call__(self, x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Outputs and their derivatives."""
        return self.call(x0, S0, rows, p)


def forward(model: Any, free: tuple[str, ...]) -> ForwardRun:
    """The free run of a parametrised model and its derivatives.

    Gives ``run(x0, S0, rows, p)``: from the state ``x0``, shape (n_states,), and its derivatives ``S0``, shape
    (n_states, m), the first ``len(free)`` columns with respect to the free parameters, the others to anything, or none
    at all (m = 0) where only outputs are wanted, in half the time; the drive's ``rows``, shape (n, n_w); values ``p``
    of the free parameters. It returns shape (n, n_outputs, 1 + m): outputs, then their derivatives.
    """
    try:
        hash(model)
    except TypeError:  # holds arrays, so it cannot be looked up
        return _forward(model, free)
    return _known_forward(model, free)


@lru_cache(maxsize=8)
def _known_forward(model: Any, free: tuple[str, ...]) -> ForwardRun:
    return _forward(model, free)


def _forward(model: Any, free: tuple[str, ...]) -> ForwardRun:
    if model.ode.own_step:
        return _stepped(model, free)
    try:
        source, rest = _source(model, free)
    except (RuntimeError, NotImplementedError, TypeError, ParameterError):  # built on what has no scalar code
        source, rest = "", np.empty(0)
    loaded = library(source, name="free_run") if source else None
    return _interpreted(model, free) if loaded is None else _compiled(model, loaded, rest)


# ---- compiled ------------------------------------------------------------------------------------------------------


def _numbers(model: Parametrised, names: tuple[str, ...], free: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters that can become symbols: all where the equations allow that, so that the code fits any values."""
    others = tuple(n for n in names if n not in free)
    try:
        varied = model.with_values(**{n: ca.SX.sym(n) for n in (*free, *others)})
        x, w = ca.SX.sym("x", varied.ode.n_states), ca.SX.sym("w", _width(model))
        varied.ode.derivative(x, varied.drive(w))
        varied.ode.output(x, varied.drive(w))
    except (RuntimeError, NotImplementedError, TypeError, ValueError):
        return free
    return (*free, *others)


def _width(model: Any) -> int:
    """Length of a row of the drive."""
    wrapped = model.n_states - model.ode.n_states
    return model.n_inputs + wrapped


def _source(model: Any, free: tuple[str, ...]) -> tuple[str, np.ndarray]:
    """C of the free run, and the values of the parameters that it takes besides the free ones."""
    known = _numbers(model, model.parameter_names, free)
    ode, n_p = model.ode, len(free)
    x, w, p = ca.SX.sym("x", ode.n_states), ca.SX.sym("w", _width(model)), ca.SX.sym("p", len(known))
    varied = model.with_values(**{name: p[i] for i, name in enumerate(known)})
    u = varied.drive(w)
    f, y = ca.densify(varied.ode.derivative(x, u)), ca.densify(varied.ode.output(x, u))

    def with_slopes(name: str, value: Any) -> ca.Function:
        slopes = [ca.densify(ca.jacobian(value, x).T), ca.densify(ca.jacobian(value, p)[:, :n_p].T)]
        return ca.Function(name, [x, w, p], [value, *slopes], {"cse": True})

    functions = {
        "rates": with_slopes("ode_rates", f),
        "outputs": with_slopes("ode_outputs", y),
        "slopes": ca.Function("ode_slopes", [x, w, p], [f]),
    }
    sizes = {"NX": ode.n_states, "NW": w.shape[0], "NP": n_p, "NY": ode.n_outputs}
    parts = [preamble("double"), *(emit(function, name) for name, function in functions.items())]
    if ode.method == "radau":
        sizes |= {
            "N_SHARES": len(SHORTENED),
            "ITERATIONS": _ITERATIONS,
            "MISSED": MISSED,
            "RETRY": RETRY,
            "IMPLICIT": 1,
        }
        rows = ", ".join("{" + ", ".join(float.hex(float(a)) for a in row) + "}" for row in RADAU_A)
        parts += [f"static const double RADAU[3][3] = {{{rows}}};"]
        parts += [f"static const double SHARES[{len(SHORTENED)}] = {{{', '.join(map(str, SHORTENED))}}};"]
        step = "implicit_step(x, x + NX, w, p, h, m, 1);"
    else:
        step = explicit_step(ode.method, "all_rates({x}, w, p, {k}, m)", n="n", h="h", out="x").strip()
    text = (files("slipangle.identify.physics") / "forward.c").read_text(encoding="utf-8")
    parts += [f"#define {name} {value}" for name, value in sizes.items()]
    return "\n".join([*parts, text.replace("/* STEP */", step)]), np.array([model.value(n) for n in known[n_p:]])


def _compiled(model: Any, found: ctypes.CDLL, rest: np.ndarray) -> ForwardRun:
    ode, ny = model.ode, model.n_outputs
    h = ode.dt / ode.substeps

    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        x, m = np.ascontiguousarray(np.vstack([x0, S0.T]), dtype=float), S0.shape[1]  # x, then S column after column
        rows, values = np.ascontiguousarray(rows, dtype=float), np.concatenate([p, rest])
        out, scratch = np.empty((len(rows), 1 + m, ny)), np.empty(3 * x.size)
        at = [a.ctypes.data for a in (x, rows, values)]
        found.free_run(*at, len(rows), m, h, ode.substeps, out.ctypes.data, scratch.ctypes.data)
        return out.transpose(0, 2, 1)

    return ForwardRun(run, compiled=True)


# ---- without a compiler --------------------------------------------------------------------------------------------


def _interpreted(model: Any, free: tuple[str, ...]) -> ForwardRun:
    ode, n_p = model.ode, len(free)
    nx, ny, nw = ode.n_states, ode.n_outputs, _width(model)
    kind: Any = ca.MX if ode.method == "radau" else ca.SX

    def at(p: Any) -> Any:
        return model.with_values(**{name: p[i] for i, name in enumerate(free)})

    def rate(state: Any, drive: Any) -> Any:
        varied = at(drive[nw:])
        return varied.ode.derivative(state, varied.drive(drive[:nw]))

    n = {"n_states": nx, "n_inputs": nw + n_p}
    step = discretise(rate, ode.dt, method=ode.method, substeps=ode.substeps, **n)

    def functions(m: int) -> tuple[ca.Function, ca.Function]:
        x, w, p, s = kind.sym("x", nx), kind.sym("w", nw), kind.sym("p", n_p), kind.sym("s", nx, m)
        drive = ca.vertcat(w, p)
        varied = at(p)
        later, y = step(x, drive), varied.ode.output(x, varied.drive(w))
        if m == 0:
            return ca.Function("step", [x, drive], [later]), ca.Function("output", [x, drive], [ca.densify(y)])

        def slopes(value: Any) -> Any:
            of_p = ca.horzcat(ca.jacobian(value, p), kind.zeros(value.shape[0], m - n_p))
            return ca.mtimes(ca.jacobian(value, x), s) + of_p

        state = ca.vertcat(x, ca.vec(s))
        parts = [ca.densify(ca.vertcat(v, ca.vec(slopes(v)))) for v in (later, y)]
        return ca.Function("step", [state, drive], parts[:1]), ca.Function("output", [state, drive], parts[1:])

    return _on_machine(functions, n_p, ny)


def _stepped(model: Any, free: tuple[str, ...]) -> ForwardRun:
    """The same of any model, by central differences of its own steps: these may stick, shift and stop."""
    outputs = _outputs(model, free)

    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        columns = [outputs(x0, rows, p)]
        for j in range(S0.shape[1]):
            along_p = np.zeros(len(p))
            if j < len(p):
                along_p[j] = 1.0
            size = max(abs(p[j]), 1e-2) if j < len(p) else 1.0 + abs(float(x0 @ S0[:, j]))
            h = 1e-5 * size
            up, down = (outputs(x0 + d * S0[:, j], rows, p + d * along_p) for d in (h, -h))
            columns.append((up - down) / (2 * h))
        return np.stack(columns, axis=2)

    return ForwardRun(run, compiled=False)


def _outputs(model: Any, free: tuple[str, ...]) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """``(x0, rows, p)`` to the outputs at every row, by the model's compiled steps where it has some."""
    ode, nw, n_p = model.ode, _width(model), len(free)
    kinds: tuple[Any, ...] = (ca.SX, ca.MX)
    for kind in kinds:
        x, w, p = kind.sym("x", ode.n_states), kind.sym("w", nw), kind.sym("p", n_p)
        drive = ca.vertcat(w, p)
        try:
            varied = model.with_values(**{name: p[i] for i, name in enumerate(free)})
            u = varied.drive(w)
            step, seen, driven = (
                ca.Function("f", [x, drive], [ca.densify(v)])
                for v in (varied.ode.step(x, u), varied.ode.output(x, u), ca.vertcat(u, p))
            )
        except (RuntimeError, NotImplementedError, TypeError):  # of CasADi, or equations that branch on a parameter
            continue
        break
    else:
        return lambda x0, rows, p: _numeric(model.with_values(**dict(zip(free, map(float, p), strict=True))), x0, rows)
    compiled = ode.steps_with(free) if set(free) <= set(ode.parameter_names) else None

    def outputs(x0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        table = np.hstack([rows, np.broadcast_to(p, (len(rows), n_p))])
        if compiled is None:
            states = roll_out(step, x0, table[:-1])
        else:
            states = compiled.run(x0, evaluate(driven, np.zeros((len(rows) - 1, len(x0))), table[:-1]))
        return evaluate(seen, states, table)

    return outputs


def _numeric(varied: Any, x0: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Outputs at every row of a model without symbols for its parameters."""
    u = np.array([np.asarray(varied.drive(row), dtype=float) for row in rows])
    return np.vstack([np.asarray(varied.ode.output(x0, u[0]), dtype=float).ravel(), varied.ode.free_run(x0, u)])


def _on_machine(functions: Callable[[int], tuple[ca.Function, ca.Function]], n_p: int, ny: int) -> ForwardRun:
    """A run on CasADi's virtual machine by step and output of ``[x; vec(S)]``, made for the columns of S."""
    built: dict[int, tuple[ca.Function, ca.Function]] = {}

    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        m = S0.shape[1]
        if m not in built:
            built[m] = functions(m)
        advance, output = built[m]
        drive = np.hstack([rows, np.broadcast_to(p, (len(rows), n_p))])
        states = roll_out(advance, np.concatenate([x0, S0.T.ravel()]), drive[:-1])
        full = evaluate(output, states, drive)
        return full.reshape(len(rows), 1 + m, ny).transpose(0, 2, 1)

    return ForwardRun(run, compiled=False)
