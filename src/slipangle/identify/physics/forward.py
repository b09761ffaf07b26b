"""Free runs with forward sensitivities of a parametrised ODE: compiled C where there is a compiler, else CasADi."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from multiprocessing import parent_process
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.elimination import elimination_code, stages_pattern
from slipangle.codegen.expression import emit, preamble
from slipangle.codegen.integrators import explicit_step
from slipangle.errors import ParameterError
from slipangle.models.fast import evaluate, roll_out
from slipangle.models.ode import Parametrised
from slipangle.numerics.integrate import MISSED, RADAU_A, RETRY, SHORTENED, discretise

_ITERATIONS = 12  # of Newton's method, as in the integrator itself
_WIDE = 8  # derivatives that are added up side by side
_LONG = 1000  # rows of all runs together, from which threads are worth starting


@dataclass(frozen=True)
class ForwardRun:
    """A free run with its derivatives, see `forward`; and whether it is compiled, that is fast."""

    call: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    compiled: bool

    def __call__(self, x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Outputs and their derivatives."""
        return self.call(x0, S0, rows, p)

    def many(self, given: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        """One run after another, or, where they are compiled and long, at the same time on the cores of the machine."""
        alone = parent_process() is None  # else other processes have the other cores
        threads = min(len(given), os.cpu_count() or 1) if alone else 1
        if not self.compiled or threads == 1 or sum(len(rows) for _, _, rows, _ in given) < _LONG:
            return [self(*arguments) for arguments in given]
        with ThreadPoolExecutor(threads) as pool:  # the compiled code runs without the interpreter's lock
            return list(pool.map(lambda arguments: self(*arguments), given))


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
    if loaded is None:
        return _interpreted(model, free)
    return _compiled(loaded, rest, model.n_outputs, model.ode.dt / model.ode.substeps, model.ode.substeps)


# ---- compiled ------------------------------------------------------------------------------------------------------


def _numbers(model: Parametrised, names: tuple[str, ...], free: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters that can become symbols: all where the equations allow that, so that the code fits any values.

    One that is zero and stays so is none, as a whole effect may go with it.
    """
    others = tuple(n for n in names if n not in free and model.value(n) != 0)
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
    felt = ca.SX.sym("u", u.shape[0])
    of_felt = varied.ode.derivative(x, felt), varied.ode.output(x, felt)
    text = _text((w, u), (x, felt, p), *of_felt, n_p, ode.method)
    return text, np.array([model.value(n) for n in known[n_p:]])


def _text(drive: tuple[ca.SX, Any], symbols: tuple[ca.SX, ca.SX, ca.SX], f: Any, y: Any, n_p: int, method: Any) -> str:
    """C of the free run with rates ``f``, or with ``f`` as the next state where the method is "map".

    The symbols are x, u and p, of whose entries the first ``n_p`` are free; ``drive`` are those of a row w, and u of it
    and of p: it may take many operations, as a delay does, which the steps within a sample need not repeat.
    """
    (w, given), (x, u, p) = drive, symbols
    given, f, y = ca.densify(given), ca.densify(f), ca.densify(y)
    padding = -n_p % _WIDE if n_p else _WIDE

    def by_p(value: Any) -> Any:
        return ca.horzcat(ca.jacobian(value, p)[:, :n_p], ca.SX(value.shape[0], padding))

    def with_slopes(name: str, value: Any) -> ca.Function:
        slopes = [ca.jacobian(value, x), ca.jacobian(value, u), by_p(value)]
        return ca.Function(name, [x, u, p], [value, *slopes], {"cse": True})

    functions = {
        "driven": ca.Function("ode_driven", [w, p], [given, by_p(given)], {"cse": True}),
        "undriven": ca.Function("ode_undriven", [w, p], [given], {"cse": True}),
        "rates": with_slopes("ode_rates", f),
        "outputs": with_slopes("ode_outputs", y),
        "slopes": ca.Function("ode_slopes", [x, u, p], [f]),
    }
    moved = _used(by_p(given)).any(axis=1)
    sizes = {"NX": x.shape[0], "NU": u.shape[0], "NW": w.shape[0], "NY": y.shape[0], "MP": n_p + padding, "WIDE": _WIDE}
    parts = [preamble("double"), *(emit(function, name) for name, function in functions.items())]
    if method == "radau":
        sizes |= {"N_SHARES": len(SHORTENED), "ITERATIONS": _ITERATIONS, "MISSED": MISSED, "RETRY": RETRY}
        jacobian = ca.DM(ca.jacobian(f, x).sparsity(), 1.0)
        parts += [elimination_code(stages_pattern(np.array(jacobian.full()) != 0), "newton", "double")]
        rows = ", ".join("{" + ", ".join(float.hex(float(a)) for a in row) + "}" for row in RADAU_A)
        parts += ["#define IMPLICIT", f"static const double RADAU[3][3] = {{{rows}}};"]
        parts += [f"static const double SHARES[{len(SHORTENED)}] = {{{', '.join(map(str, SHORTENED))}}};"]
        step = "implicit_step(x, x + NX, u, p, h, m, 1);"
    elif method == "map":
        step = "all_rates(x, u, p, y, m); memcpy(x, y, n * sizeof(double));"
    else:
        step = explicit_step(method, "all_rates({x}, u, p, {k}, m)", n="n", h="h", out="x").strip()
    template = (files("slipangle.identify.physics") / "forward.c").read_text(encoding="utf-8")
    parts += [f"#define {name} {value}" for name, value in sizes.items()]
    parts += ["typedef double wide __attribute__((vector_size(WIDE * sizeof(double)), aligned(sizeof(double))));"]
    parts += ["static const wide none = {0};"]
    for name, value in (("rates", f), ("outputs", y)):
        of_x, of_u = _used(ca.jacobian(value, x)), _used(ca.jacobian(value, u)) & moved
        parts += [_along(f"along_{name}", of_x, of_u, _used(by_p(value)))]
    return "\n".join([*parts, template.replace("/* STEP */", step)])


def _used(slopes: Any) -> np.ndarray:
    """Which entries can be other than zero."""
    return np.array(ca.DM(slopes.sparsity(), 1.0).full()) != 0


def _along(name: str, of_x: np.ndarray, of_u: np.ndarray, of_p: np.ndarray) -> str:
    """C of the sum of products that is a derivative by all columns; which entries count is known here."""
    given = ", ".join(f"const double *restrict {n}" for n in ("fx", "fu", "fp", "S", "du"))
    lines = [f"static void {name}({given}, double *restrict out, long m)", "{"]
    lines += ["    for (long j = 0; j < m; j += WIDE) {"]
    tables = (("fx", "S", of_x), ("fu", "du", of_u))
    lines += [
        f"        const wide {rows}{k} = *(const wide *)({rows} + {k} * m + j);"
        for _, rows, used in tables
        for k in np.flatnonzero(used.any(axis=0))
    ]
    for i in range(len(of_x)):
        products = [
            f" + {f}[{i * used.shape[1] + k}] * {rows}{k}" for f, rows, used in tables for k in np.flatnonzero(used[i])
        ]
        first = f"(j < MP ? *(const wide *)(fp + {i} * MP + j) : none)" if of_p[i].any() else "none"
        lines.append(f"        *(wide *)(out + {i} * m + j) = {first}{''.join(products)};")
    return "\n".join([*lines, "    }", "    (void)fx, (void)fu, (void)fp, (void)S, (void)du;", "}"])


def _compiled(loaded: ctypes.CDLL, rest: np.ndarray, ny: int, h: float = 1.0, substeps: int = 1) -> ForwardRun:
    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        n = S0.shape[1]
        m = n + -n % _WIDE
        x = np.concatenate([x0, np.pad(S0, [(0, 0), (0, m - n)]).ravel()], dtype=float)  # x, then S row after row
        rows, values = np.ascontiguousarray(rows, dtype=float), np.concatenate([p, rest])
        out, scratch = np.empty((len(rows), ny, 1 + n)), np.empty(loaded.spare(m))
        at = [a.ctypes.data for a in (x, rows, values)]
        loaded.free_run(*at, len(rows), m, n, h, substeps, out.ctypes.data, scratch.ctypes.data)
        return out

    return ForwardRun(run, compiled=True)


def of_map(symbols: tuple[ca.SX, ca.SX, ca.SX], later: Any, y: Any) -> ForwardRun:
    """The free run of ``x(k+1) = later``, with outputs ``y``, of the symbols x, w and p, all of them free."""
    later, y = ca.densify(later), ca.densify(y)
    text = _text((symbols[1], symbols[1]), symbols, later, y, symbols[2].shape[0], "map")
    loaded = library(text, name="free_run")
    if loaded is None:
        return _on_machine(symbols, _chained(symbols, later), y)
    return _compiled(loaded, np.empty(0), y.shape[0])


# ---- without a compiler --------------------------------------------------------------------------------------------


def _interpreted(model: Any, free: tuple[str, ...]) -> ForwardRun:
    ode, nw, n_p = model.ode, _width(model), len(free)
    kind: Any = ca.MX if ode.method == "radau" else ca.SX

    def at(p: Any) -> Any:
        return model.with_values(**{name: p[i] for i, name in enumerate(free)})

    def rate(state: Any, drive: Any) -> Any:
        varied = at(drive[nw:])
        return varied.ode.derivative(state, varied.drive(drive[:nw]))

    def step_of(f: Any, n_states: int) -> Any:
        n = {"n_states": n_states, "n_inputs": nw + n_p}
        return discretise(f, ode.dt, method=ode.method, substeps=ode.substeps, **n)

    x, w, p = kind.sym("x", ode.n_states), kind.sym("w", nw), kind.sym("p", n_p)
    drive, varied = ca.vertcat(w, p), at(p)
    output = varied.ode.output(x, varied.drive(w))
    if ode.method == "radau":
        return _on_machine((x, w, p), _chained((x, w, p), step_of(rate, ode.n_states)(x, drive)), output)
    now = rate(x, drive)
    rates = ca.Function("rates", [x, drive], [now, *_slopes(now, x, p)], {"cse": True})

    def later(s: Any) -> Any:
        """An explicit step of states and derivatives together is that step and its derivatives, in fewer operations."""
        m = s.shape[1]

        def both(state: Any, driven: Any) -> Any:
            f, of_x, of_p = rates.call([state[: ode.n_states], driven], True, False)
            if m == 0:
                return f
            moves = ca.mtimes(of_x, ca.reshape(state[ode.n_states :], ode.n_states, m))
            return ca.vertcat(f, ca.vec(moves + ca.horzcat(of_p, ca.SX(ode.n_states, m - n_p))))

        return step_of(both, ode.n_states * (1 + m))(ca.vertcat(x, ca.vec(s)), drive)

    return _on_machine((x, w, p), later, output)


def _slopes(value: Any, x: Any, p: Any) -> tuple[Any, Any]:
    return ca.jacobian(value, x), ca.jacobian(value, p)


def _chained(symbols: tuple[Any, Any, Any], value: Any) -> Callable[[Any], Any]:
    """``[value; vec(derivatives)]`` for columns s of derivatives of the state, of which the first are by all of p."""
    x, _, p = symbols
    of_x, of_p = _slopes(value, x, p)

    def along(s: Any) -> Any:
        m = s.shape[1]
        if m == 0:
            return value
        slope = ca.mtimes(of_x, s) + ca.horzcat(of_p, type(x)(value.shape[0], m - p.shape[0]))
        return ca.vertcat(value, ca.vec(slope))

    return along


def _on_machine(symbols: tuple[Any, Any, Any], later: Callable[[Any], Any], y: Any) -> ForwardRun:
    """A run on CasADi's virtual machine by step and output of ``[x; vec(S)]``, made for the columns of S.

    ``later`` gives the step for columns s, see `_chained`.
    """
    x, w, p = symbols
    drive, n_p, ny, seen = ca.vertcat(w, p), p.shape[0], y.shape[0], _chained(symbols, y)

    @cache
    def functions(m: int) -> list[ca.Function]:
        s = type(x).sym("s", x.shape[0], m)
        state = ca.vertcat(x, ca.vec(s))
        return [ca.Function("f", [state, drive], [ca.densify(of(s))]) for of in (later, seen)]

    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        advance, output = functions(S0.shape[1])
        driven = np.hstack([rows, np.broadcast_to(p, (len(rows), n_p))])
        states = roll_out(advance, np.concatenate([x0, S0.T.ravel()]), driven[:-1])
        return evaluate(output, states, driven).reshape(len(rows), -1, ny).transpose(0, 2, 1)

    return ForwardRun(run, compiled=False)


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
