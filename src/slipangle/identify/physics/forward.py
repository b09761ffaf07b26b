"""Free runs with forward sensitivities of a parametrised ODE: compiled C where there is a compiler, else CasADi."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, lru_cache
from multiprocessing import parent_process
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.errors import ParameterError
from slipangle.identify.physics.forward_code import WIDE, Code, code_of, drive_of, text_of, width
from slipangle.models.fast import evaluate, roll_out
from slipangle.numerics.integrate import discretise

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
    ordered = tuple(sorted(free, key=model.parameter_names.index))  # one library for every order
    try:
        code = code_of(model, ordered)
    except (RuntimeError, NotImplementedError, TypeError, ParameterError):  # built on what has no scalar code
        code = None
    run = _compiled(code, model.n_outputs, model.ode.dt / model.ode.substeps, model.ode.substeps) if code else None
    if run is None:
        return _interpreted(model, free)
    return run if ordered == free else _reordered(run, [free.index(name) for name in ordered])


def _compiled(code: Code, ny: int, h: float = 1.0, substeps: int = 1) -> ForwardRun | None:
    drive = library(code.drive, name="drive")
    loaded = library(code.run, name="free_run") if drive else None
    if drive is None or loaded is None:
        return None
    places = code.places
    calls = [ctypes.cast(function, ctypes.c_void_p).value for function in (drive.driven, drive.undriven)]

    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        n = S0.shape[1]
        m = n + -n % WIDE
        x = np.concatenate([x0, np.pad(S0, [(0, 0), (0, m - n)]).ravel()], dtype=float)  # x, then S row after row
        rows, values = np.ascontiguousarray(rows, dtype=float), np.concatenate([p, code.rest])
        columns, q = (
            np.where(places < len(p), places, -1).astype(ctypes.c_long),
            values[places],
        )  # which derivatives are wanted of those by q
        out, scratch = np.empty((len(rows), ny, 1 + n)), np.empty(loaded.spare(m, len(places)))
        at = [a.ctypes.data for a in (x, rows, values)]
        of_drive = [*calls, q.ctypes.data, columns.ctypes.data, len(places), rows.shape[1]]
        loaded.free_run(*at, *of_drive, len(rows), m, n, h, substeps, out.ctypes.data, scratch.ctypes.data)
        return out

    return ForwardRun(run, compiled=True)


def _reordered(ran: ForwardRun, places: list[int]) -> ForwardRun:
    """The same run where ``places`` are those of its free parameters in the order in which they are now given."""

    def run(x0: np.ndarray, S0: np.ndarray, rows: np.ndarray, p: np.ndarray) -> np.ndarray:
        n = S0.shape[1]
        columns = np.concatenate([places, np.arange(len(places), n)]) if n else np.empty(0, dtype=int)
        made = ran(x0, S0[:, columns], rows, p[places])
        out = np.empty_like(made)
        out[:, :, np.concatenate([[0], 1 + columns])] = made
        return out

    return ForwardRun(run, ran.compiled)


def of_map(symbols: tuple[ca.SX, ca.SX, ca.SX], later: Any, y: Any) -> ForwardRun:
    """The free run of ``x(k+1) = later``, with outputs ``y``, of the symbols x, w and p, all of them free."""
    (_, w, p), later, y = symbols, ca.densify(later), ca.densify(y)
    body = text_of(symbols, later, y, p.shape[0], "map", np.zeros(w.shape[0], dtype=bool))
    run = _compiled(Code(body, *drive_of(w, w, p), np.empty(0)), y.shape[0])
    return _on_machine(symbols, _chained(symbols, later), y) if run is None else run


# ---- without a compiler --------------------------------------------------------------------------------------------


def _interpreted(model: Any, free: tuple[str, ...]) -> ForwardRun:
    ode, nw, n_p = model.ode, width(model), len(free)
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
    ode, nw, n_p = model.ode, width(model), len(free)
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
