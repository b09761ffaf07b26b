"""The quadratic program of MARX-MPC, compiled; without a compiler that of `interpreted`."""

from __future__ import annotations

import ctypes
from importlib.resources import files
from typing import Any

import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import preamble
from slipangle.codegen.struct import Struct, accessors, clock
from slipangle.control.marx.interpreted import Interpreted
from slipangle.control.marx.problem import Answer, MarxProgram, Numbers, Offset, Solver
from slipangle.numerics.per_thread import OfThreads, of_thread
from slipangle.optimal.arrays import DOUBLE
from slipangle.optimal.checks import ANY
from slipangle.optimal.solution import Status

FIELDS = (
    "x path v applied speeds A B c offset q end r s bounds steps lowest highest u states weights "
    "cost residual seconds iterations"
).split()
FLAGS = ("-fno-math-errno", "-fno-trapping-math")
OUTCOMES = (Status.SOLVED, Status.NOT_FINITE, Status.FAILED, Status.INFEASIBLE)


def source(problem: MarxProgram, *, caller: bool = False) -> str:
    """The problem as one C source; ``caller`` says that one in C brings the clock and knows the struct."""
    names = list(problem.outputs)
    sizes = {
        "NH": problem.horizon,
        "QN": len(problem.knots),
        "QR": len(problem.knots) if problem.rated else 0,
        "QD": 0,
        "NJ": problem.n_models,
        "NA": problem.na,
        "NB": problem.reach,
        "NY": len(names),
        "NT": len(problem.q),
        "NS": problem.n_states,
        "POSE": int(problem.posed),
        "VY": names.index("v_y") if problem.posed else 0,
        "RR": names.index("r") if problem.posed else 0,
        "SMOOTH": int(problem.smooth),
        "STEP": repr(float(problem.dt)),
        "ANY_INPUT": repr(ANY),
    }
    shared = [files("slipangle.optimal.realtime") / name for name in ("ranges.c", "qp.c")]
    text = [preamble("V"), *(file.read_text(encoding="utf-8") for file in shared)]
    own = (files("slipangle.control.marx") / "marx.c").read_text(encoding="utf-8")
    head = ["" if caller else clock(), *(f"#define {k} {v}" for k, v in sizes.items())]
    return "\n".join([*head, *text, _shares(problem), own, "" if caller else accessors("marx", FIELDS)])


def _shares(problem: MarxProgram) -> str:
    """The decided inputs' part in each step's input as C arrays; rows are padded to whole vectors."""
    shares, changes = problem.shares, problem.changes
    first = (shares != 0).argmax(axis=0)
    lines = [
        f"static const int {n}[] = {{{', '.join(map(str, v))}}};"
        for n, v in (("KNOT", problem.knots), ("FIRST", first))
    ]
    for name, rows in (("SHARE", shares), ("SQUARES", shares.T @ shares), ("CHANGES", changes.T @ changes)):
        entries = ", ".join(f"[{i} * QL + {k}] = {float(v).hex()}" for (i, k), v in np.ndenumerate(rows) if v != 0)
        lines.append(f"static const double {name}[{len(rows)} * QL] = {{{entries}}};")
    return "\n".join(lines)


def build(problem: MarxProgram, numbers: Numbers) -> Solver:
    """Compile the problem, or take it from the cache, or fall back on NumPy."""
    loaded = library(source(problem), name="marx", flags=FLAGS)
    return Compiled(problem, numbers, loaded) if loaded is not None else Interpreted(problem, numbers)


class WorkArea(Solver):
    """One thread's memory of the compiled solver."""

    def __init__(self, problem: MarxProgram, numbers: Numbers, found: ctypes.CDLL) -> None:
        self._call, self._call_again = found.marx_plan, found.marx_again
        n, ny, tracked = problem.horizon, len(problem.outputs), len(problem.q)
        shapes: dict[str, tuple[int, ...]] = {
            "x": (problem.n_states,),
            "path": (n + 1, 3),
            "v": (n, 1),
            "speeds": (problem.n_models,),
            "A": (problem.n_models, problem.na, ny, ny),
            "B": (problem.n_models, problem.reach, ny),
            "c": (problem.n_models, ny),
            "offset": (ny,),
            "q": (tracked,),
            "end": (tracked,),
            "bounds": (2,),
            "steps": (2,),
            "lowest": (problem.n_states + 4,),
            "highest": (problem.n_states + 4,),
            "u": (n, 1),
            "states": (n + 1, problem.n_states),
            "weights": (problem.n_models,),
        }
        self._struct = Struct(found, "marx", FIELDS, shapes, ["iterations"])
        self._pointer, view = self._struct.pointer, self._struct.fields
        for name in ("q", "end", "bounds", "steps"):
            view[name][:] = getattr(problem, name)
        view["r"][0], view["s"][0] = problem.r, problem.s
        self._view, self._numbers = view, numbers
        self._x, self._path, self._v, self._applied = (view[k] for k in ("x", "path", "v", "applied"))
        self._offset = view["offset"]
        self._u, self._states, self._weights = (view[k] for k in ("u", "states", "weights"))
        self._cost, self._residual, self._iterations = (view[k] for k in ("cost", "residual", "iterations"))
        self._sizes = self._x.shape, self._path.shape, self._v.shape
        self._loaded: Numbers | None = None
        self._load(numbers)

    @property
    def seconds(self) -> float:
        """Time of the last solve inside the compiled code. [s]"""
        return float(self._view["seconds"][0])

    def _load(self, numbers: Numbers) -> None:
        for name in ("speeds", "A", "B", "c"):
            self._view[name][:] = getattr(numbers, name)
        self._loaded = numbers

    def solve(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None, offset: Offset
    ) -> Answer:
        """See `Solver`."""
        wanted = self._numbers if numbers is None else numbers
        if self._loaded is not wanted:
            self._load(wanted)
        self._x[:] = x
        self._path[:] = path
        self._v[:] = v_x
        self._applied[0] = applied
        self._offset[:] = offset
        status = OUTCOMES[self._call(self._pointer)]
        return Answer(
            status,
            self._u.copy(),
            self._states.copy(),
            self._weights.copy(),
            self._cost.item(),
            self._iterations.item(),
            self._residual.item(),
        )

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """See `Solver`."""
        self._view["lowest"][:], self._view["highest"][:] = lowest, highest

    def again(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None
    ) -> dict[str, Any] | None:
        """See `Solver`."""
        if not (type(x) is type(path) is type(v_x) is np.ndarray and (x.shape, path.shape, v_x.shape) == self._sizes):
            return None
        if not (x.dtype is DOUBLE and path.dtype is DOUBLE and v_x.dtype is DOUBLE):
            return None
        wanted = self._numbers if numbers is None else numbers
        if self._loaded is not wanted:
            self._load(wanted)
        self._x[...], self._path[...], self._v[...], self._applied[0] = x, path, v_x, applied
        self._offset.fill(0.0)
        if self._call_again(self._pointer):
            return None
        return {
            "u": self._u.copy(),
            "x": self._states.copy(),
            "status": Status.SOLVED,
            "cost": self._cost.item(),
            "iterations": self._iterations.item(),
            "residual": self._residual.item(),
            "weights": self._weights.copy(),
        }


class Compiled(OfThreads, Solver):
    """Solver on a loaded library, a work area for each thread."""

    solve, again = of_thread("solve"), of_thread("again")

    def __init__(self, problem: MarxProgram, numbers: Numbers, found: ctypes.CDLL) -> None:
        super().__init__(lambda: WorkArea(problem, numbers, found))

    @property
    def seconds(self) -> float:
        """Time of this thread's last solve inside the compiled code. [s]"""
        return self._areas.mine.seconds

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """See `Solver`; of all threads."""
        self._tell("expect", lowest, highest)
