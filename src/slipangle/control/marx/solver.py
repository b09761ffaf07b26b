"""The quadratic program of MARX-MPC: compiled, or with NumPy and DAQP where there is no compiler."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from slipangle.codegen.compiler import library
from slipangle.numerics.per_thread import PerThread
from slipangle.optimal.arrays import DOUBLE
from slipangle.optimal.checks import ANY
from slipangle.optimal.solution import Status, within

FIELDS = (
    "x path v applied speeds A B c offset q end r s bounds steps lowest highest u states weights "
    "cost residual seconds iterations"
).split()
FLAGS = ("-fno-math-errno", "-fno-trapping-math")
OUTCOMES = (Status.SOLVED, Status.NOT_FINITE, Status.FAILED, Status.INFEASIBLE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """Sizes, weights and limits; see `MultiARXMPC`. ``steps`` limits the change per step."""

    horizon: int
    knots: tuple[int, ...]
    dt: float
    na: int
    reach: int
    outputs: tuple[str, ...]
    n_models: int
    smooth: bool
    rated: bool
    q: np.ndarray
    end: np.ndarray
    r: float
    s: float
    bounds: np.ndarray
    steps: np.ndarray

    @cached_property
    def shares(self) -> np.ndarray:
        """Of each decided input in each step's, shape (horizon, knots): straight between knots, level after them."""
        steps = np.arange(self.horizon)
        return np.column_stack([np.interp(steps, self.knots, one) for one in np.eye(len(self.knots))])

    @cached_property
    def changes(self) -> np.ndarray:
        """Of the shares from step to step, those of the first step from zero, shape (horizon, knots)."""
        return np.diff(self.shares, axis=0, prepend=0.0)

    @property
    def posed(self) -> bool:
        """Whether the models' outputs are v_y and r."""
        return "r" in self.outputs

    @property
    def n_states(self) -> int:
        """Length of the state: lagged outputs, past inputs and, if posed, X, Y, psi."""
        return self.na * len(self.outputs) + self.reach - 1 + 3 * self.posed


@dataclass(frozen=True, kw_only=True, eq=False)
class Numbers:
    """Speeds and coefficients of the models, as in ``MultiARXModel.coefficients``."""

    speeds: np.ndarray
    A: np.ndarray
    B: np.ndarray
    c: np.ndarray


class Answer(NamedTuple):
    """What a solve found; ``x`` has shape (horizon + 1, n_states), ``u`` (horizon, 1)."""

    status: Status
    u: np.ndarray
    x: np.ndarray
    weights: np.ndarray
    cost: float
    iterations: int
    residual: float


@runtime_checkable
class Continues(Protocol):
    """A solver that judges by itself what the usual call is given."""

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """Ranges of the state's entries, of X, Y, psi and of the speed, beyond which a value is doubtful."""
        ...

    def again(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None
    ) -> dict[str, Any] | None:
        """What a plan says of an answer; None if anything is unusual, or there is no answer."""
        ...


class Solver(Protocol):
    """A solver for one `Problem`."""

    def solve(
        self,
        x: np.ndarray,
        path: np.ndarray,
        v_x: np.ndarray,
        applied: float,
        numbers: Numbers | None = None,
        offset: np.ndarray | float = 0.0,
    ) -> Answer:
        """Solve from a state; ``numbers`` replace the models' coefficients, ``offset`` is added to every output."""
        ...


def source(problem: Problem) -> str:
    """The problem as one C source."""
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
    shared = [("codegen", "lanes.h"), ("optimal.realtime", "ranges.c"), ("optimal.realtime", "qp.c")]
    text = [(files(f"slipangle.{room}") / name).read_text(encoding="utf-8") for room, name in shared]
    own = (files("slipangle.control.marx") / "marx.c").read_text(encoding="utf-8")
    cases = "\n".join(f"    case {i}: return s->{name};" for i, name in enumerate(FIELDS))
    reach = f"void *marx_at(Work *s, int i)\n{{\n    switch (i) {{\n{cases}\n    }}\n    return NULL;\n}}\n"
    head = "#define _POSIX_C_SOURCE 200809L\n#include <stdlib.h>\n#include <time.h>\n"
    head += "\n".join(f"#define {k} {v}" for k, v in sizes.items())
    return "\n".join([head, *text, _shares(problem), own, reach])


def _shares(problem: Problem) -> str:
    """The decided inputs' part in each step's input as C arrays; rows are padded to whole vectors."""
    shares, changes = problem.shares, problem.changes
    first = (shares != 0).argmax(axis=0)
    lines = [
        f"static const int {n}[] = {{{', '.join(map(str, v))}}};"
        for n, v in (("KNOT", problem.knots), ("FIRST", first))
    ]
    for name, rows in (("SHARE", shares), ("SQUARES", shares.T @ shares), ("CHANGES", changes.T @ changes)):
        entries = ", ".join(f"[{i} * QL + {k}] = {float(v)!r}" for (i, k), v in np.ndenumerate(rows) if v != 0)
        lines.append(f"static const double {name}[{len(rows)} * QL] = {{{entries}}};")
    return "\n".join(lines)


def build(problem: Problem, numbers: Numbers) -> Solver:
    """Compile the problem, or take it from the cache, or fall back on NumPy."""
    found = library(source(problem), name="marx", flags=FLAGS)
    return Compiled(problem, numbers, found) if found is not None else Interpreted(problem, numbers)


class WorkArea:
    """One thread's memory of the compiled solver."""

    def __init__(self, problem: Problem, numbers: Numbers, found: ctypes.CDLL) -> None:
        self._library = found
        found.marx_new.restype = ctypes.c_void_p
        found.marx_at.restype, found.marx_at.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.c_int]
        found.marx_free.restype, found.marx_free.argtypes = None, [ctypes.c_void_p]
        for call in (found.marx_plan, found.marx_again):
            call.restype, call.argtypes = ctypes.c_int, [ctypes.c_void_p]
        self._work = found.marx_new()
        if not self._work:
            raise MemoryError("no memory for the solver")
        self._pointer = ctypes.c_void_p(self._work)
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
        view: dict[str, np.ndarray] = {}
        for i, name in enumerate(FIELDS):
            shape = shapes.get(name, (1,))
            kind: Any = ctypes.c_int64 if name == "iterations" else ctypes.c_double
            block: Any = (kind * max(int(np.prod(shape)), 1)).from_address(found.marx_at(self._pointer, i))
            dtype = np.int64 if name == "iterations" else float
            view[name] = np.frombuffer(block, dtype=dtype)[: int(np.prod(shape))].reshape(shape)
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

    def __del__(self) -> None:
        work, self._work = getattr(self, "_work", None), None
        if work:
            self._library.marx_free(ctypes.c_void_p(work))

    @property
    def seconds(self) -> float:
        """Time of the last solve inside the compiled code. [s]"""
        return float(self._view["seconds"][0])

    def _load(self, numbers: Numbers) -> None:
        for name in ("speeds", "A", "B", "c"):
            self._view[name][:] = getattr(numbers, name)
        self._loaded = numbers

    def solve(
        self,
        x: np.ndarray,
        path: np.ndarray,
        v_x: np.ndarray,
        applied: float,
        numbers: Numbers | None = None,
        offset: np.ndarray | float = 0.0,
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
        """See `Continues`."""
        self._view["lowest"][:], self._view["highest"][:] = lowest, highest

    def again(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None
    ) -> dict[str, Any] | None:
        """See `Continues`."""
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


class Compiled:
    """Solver on a loaded library, a work area for each thread."""

    def __init__(self, problem: Problem, numbers: Numbers, found: ctypes.CDLL) -> None:
        self._ranges: tuple[np.ndarray, np.ndarray] | None = None

        def area() -> WorkArea:
            made = WorkArea(problem, numbers, found)
            if self._ranges is not None:
                made.expect(*self._ranges)
            return made

        self._areas = PerThread(area)
        _ = self._areas.mine

    @property
    def seconds(self) -> float:
        """Time of this thread's last solve inside the compiled code. [s]"""
        return self._areas.mine.seconds

    def solve(
        self,
        x: np.ndarray,
        path: np.ndarray,
        v_x: np.ndarray,
        applied: float,
        numbers: Numbers | None = None,
        offset: np.ndarray | float = 0.0,
    ) -> Answer:
        """See `Solver`."""
        return self._areas.mine.solve(x, path, v_x, applied, numbers, offset)

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """See `Continues`; for all threads' areas that are made from now on, and this one's."""
        self._ranges = lowest, highest
        self._areas.mine.expect(lowest, highest)

    def again(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None
    ) -> dict[str, Any] | None:
        """See `Continues`."""
        return self._areas.mine.again(x, path, v_x, applied, numbers)


class Interpreted:
    """The same with NumPy, the quadratic program by DAQP."""

    def __init__(self, problem: Problem, numbers: Numbers) -> None:
        self._problem, self._numbers = problem, numbers

    def solve(
        self,
        x: np.ndarray,
        path: np.ndarray,
        v_x: np.ndarray,
        applied: float,
        numbers: Numbers | None = None,
        offset: np.ndarray | float = 0.0,
    ) -> Answer:
        """See `Solver`."""
        import daqp

        p, n = self._problem, len(self._problem.knots)
        given = numbers or self._numbers
        x, v = np.asarray(x, dtype=float), np.asarray(v_x, dtype=float).ravel()
        if not all(np.isfinite(a).all() for a in (x, path, v)):
            return self._nothing(Status.NOT_FINITE)
        w = self._weights(np.append(v, v[-1]), given.speeds)
        free, hit = self._blend(x, w, given, offset)
        hit = hit @ p.shares
        pose, turned = self._on_ground(free, hit, v, applied) if p.posed else (None, None)
        rows, errors = self._track(x, path, free, hit, pose, turned)
        H = p.r * p.shares.T @ p.shares + p.s * p.changes.T @ p.changes
        g = np.zeros(n)
        g[0] = -p.s * applied
        fixed = p.s * applied**2
        for t in range(len(p.q)):
            weight = np.full(p.horizon + 1, p.q[t])
            weight[-1] = p.end[t]
            H += rows[t].T @ (weight[:, None] * rows[t])
            g += rows[t].T @ (weight * errors[t])
            fixed += float(weight @ errors[t] ** 2)
        change = np.eye(n) - np.eye(n, k=-1) if p.rated else np.zeros((0, n))
        base = np.zeros(len(change))
        base[:1] = applied
        most = 1e30  # what DAQP takes for infinite
        lasts = np.diff(p.knots, prepend=-1)[: len(change)]
        upper = np.clip(np.concatenate([np.full(n, p.bounds[1]), base + lasts * p.steps[1]]), -most, most)
        lower = np.clip(np.concatenate([np.full(n, p.bounds[0]), base + lasts * p.steps[0]]), -most, most)
        sense = np.zeros(n + len(change), dtype=np.int32)
        scale = 1.0 / max(float(np.trace(H)) / n, 1e-300)
        u, _, flag, info = daqp.solve(H * scale, g * scale, np.ascontiguousarray(change), upper, lower, sense)
        if flag < 1 or not np.isfinite(u).all():
            return self._nothing(Status.INFEASIBLE if flag == -1 else Status.FAILED)
        u = np.clip(u, *p.bounds)
        return Answer(
            Status.SOLVED,
            within((p.shares @ u)[:, None], np.array([applied]), p.bounds[None], p.steps[None]),
            self._states(x, u, free, hit, pose, turned),
            w[0],
            float(u @ H @ u + 2 * g @ u + fixed),
            int(info.get("iterations", 0)),
            float("nan"),
        )

    def _nothing(self, status: Status) -> Answer:
        p = self._problem
        empty = np.zeros((p.horizon + 1, p.n_states))
        return Answer(status, np.zeros((p.horizon, 1)), empty, np.zeros(p.n_models), float("nan"), 0, float("nan"))

    def _weights(self, v: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """One row per step."""
        from slipangle.models.wrappers.multi_arx import speed_weights

        return np.column_stack(speed_weights(v, speeds.tolist(), "smooth" if self._problem.smooth else "triangular"))

    def _blend(
        self, x: np.ndarray, w: np.ndarray, given: Numbers, offset: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Blended outputs without input, (n + 1, ny), and by unit inputs, (n + 1, ny, n)."""
        p = self._problem
        n, ny, na = p.horizon, len(p.outputs), p.na
        free, hit = np.zeros((n + 1, ny)), np.zeros((n + 1, ny, n))
        free[0] = x[:ny]
        past_y, past_u = x[: na * ny].reshape(na, ny), x[na * ny : na * ny + p.reach - 1]
        for j in np.flatnonzero(w[1:].any(axis=0)):
            A, B, c = given.A[j], given.B[j], given.c[j] + offset
            runs = []
            for y0, u0, constant in (
                (past_y, np.concatenate([[0.0], past_u]), c),
                (np.zeros_like(past_y), np.eye(1, p.reach)[0], 0 * c),
            ):
                y, u = [row for row in y0[::-1]], u0
                for _ in range(n):
                    y.append(constant - sum(A[i] @ y[-1 - i] for i in range(na)) + u @ B)
                    u = np.concatenate([[0.0], u[:-1]])
                runs.append(np.array(y[na:]))
            free[1:] += w[1:, j, None] * runs[0]
            for k in range(n):
                hit[k + 1 :, :, k] += w[k + 1 :, j, None] * runs[1][: n - k]
        return free, hit

    def _on_ground(self, free: np.ndarray, hit: np.ndarray, v: np.ndarray, held: float) -> tuple[Any, Any]:
        """X, Y, psi in the vehicle's frame without input, (n + 1, 3), and by unit inputs, (n + 1, 3, n).

        Linear about the motion with the input held.
        """
        p, h = self._problem, self._problem.dt
        i, j = p.outputs.index("v_y"), p.outputs.index("r")
        pose, by = np.zeros((p.horizon + 1, 3)), np.zeros((p.horizon + 1, 3, hit.shape[2]))
        now = free + hit.sum(axis=2) * held
        for k in range(p.horizon):
            mean = pose[k, 2] + h * (2 * now[k, j] + now[k + 1, j]) / 6
            turned = by[k, 2] + h * (2 * hit[k, j] + hit[k + 1, j]) / 6
            v_y, slide = 0.5 * (now[k, i] + now[k + 1, i]), 0.5 * h * (hit[k, i] + hit[k + 1, i])
            c, s = np.cos(mean), np.sin(mean)
            move = h * np.array([v[k] * c - v_y * s, v[k] * s + v_y * c, 0.5 * (now[k, j] + now[k + 1, j])])
            pose[k + 1] = pose[k] + move
            by[k + 1, 0] = by[k, 0] - move[1] * turned - s * slide
            by[k + 1, 1] = by[k, 1] + move[0] * turned + c * slide
            by[k + 1, 2] = by[k, 2] + 0.5 * h * (hit[k, j] + hit[k + 1, j])
        return pose - by.sum(axis=2) * held, by

    def _track(self, x: Any, path: Any, free: Any, hit: Any, pose: Any, turned: Any) -> tuple[list, list]:
        """Rows and free errors of each tracked quantity."""
        if pose is None:
            return [hit[:, 0]], [free[:, 0] - path[:, 1]]
        here = x[-3:]
        c, s = np.cos(here[2]), np.sin(here[2])
        d = path[:, :2] - here[:2]
        along, across, angle = c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], path[:, 2] - here[2]
        c, s = np.cos(angle), np.sin(angle)
        e_y = c * (pose[:, 1] - across) - s * (pose[:, 0] - along)
        e_psi = pose[:, 2] - angle - 2 * np.pi * np.round(-angle[0] / (2 * np.pi))
        return [c[:, None] * turned[:, 1] - s[:, None] * turned[:, 0], turned[:, 2]], [e_y, e_psi]

    def _states(self, x: Any, u: Any, free: Any, hit: Any, pose: Any, turned: Any) -> np.ndarray:
        """The predicted states: lags filled with what was measured, predicted and decided."""
        p = self._problem
        n, ny, split = p.horizon, len(p.outputs), p.na * len(p.outputs)
        y = np.vstack([x[:split].reshape(p.na, ny)[:0:-1], free + hit @ u])
        inputs = np.concatenate([x[split : split + p.reach - 1][::-1], p.shares @ u])
        rows = []
        for i in range(n + 1):
            lags = y[i : i + p.na][::-1].ravel()
            rows.append(np.concatenate([lags, inputs[i : i + p.reach - 1][::-1], x[len(x) - 3 :] if p.posed else []]))
        out = np.array(rows)
        if p.posed:
            moved, c, s = pose + turned @ u, np.cos(x[-1]), np.sin(x[-1])
            out[:, -3:] += np.column_stack(
                [c * moved[:, 0] - s * moved[:, 1], s * moved[:, 0] + c * moved[:, 1], moved[:, 2]]
            )
        return out
