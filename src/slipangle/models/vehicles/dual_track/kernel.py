"""`Kernel`: the step of a `DualTrack` in compiled C, one car with its wheels side by side, or many cars at a time."""

import ctypes
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.expression import differing_constants, emit, lanes_alike, preamble
from slipangle.codegen.integrators import explicit_step
from slipangle.codegen.network import aligned
from slipangle.errors import ParameterError
from slipangle.models.vehicles.dual_track.contact import Contact, Patch

WIDE = 8  # cars side by side
# long straight blocks: ordering them before registers are given out is half as fast again with gcc
FLAGS = ("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast", "-fschedule-insns")
_N_PATCH, _N_CONTACT = len(Patch._fields), len(Contact._fields)
_FRICTION = ("mu_fl", "mu_fr", "mu_rl", "mu_rr")
"""Names by which `Kernel.build` varies the friction under each wheel."""
_OF_CONTACT = ("relaxation_x", "relaxation_y", "radius")
"""Parameters that the contact of a wheel reads: where they vary, they come with its patch."""
_Car = Any  # a DualTrack, whose file needs this one


class _Parts(NamedTuple):
    """The equations as CasADi functions of scalars: before, at and after the tires, and between steps."""

    before: ca.Function
    wheels: tuple[ca.Function, ...]
    after: ca.Function
    finish: ca.Function


def _parts(model: _Car, varied: Sequence[str]) -> _Parts:
    x, u = ca.SX.sym("x", model.n_states), ca.SX.sym("u", model.n_inputs + len(varied))
    start = ca.SX.sym("start", model.n_states)
    chosen = {name: u[model.n_inputs + i] for i, name in enumerate(varied)}
    car = _with(model, chosen)
    patches, angles = car.patches(x, u)
    along = _of_contact(varied)
    columns = [*zip(*patches, strict=True), *([chosen[name]] * 4 for name in along)]
    column = ca.vertcat(*[ca.SX(v) for field_ in columns for v in field_])
    before = ca.Function("before", [x, u], [ca.cse(ca.densify(column)), ca.densify(ca.vertcat(*map(ca.SX, angles)))])
    wheels, p = [], model.params
    for i in range(4):
        one = ca.SX.sym("patch", _N_PATCH + len(along))
        own = _with(model, {name: one[_N_PATCH + k] for k, name in enumerate(along)})
        patch = Patch(*[one[k] for k in range(_N_PATCH)])
        if not ((p.camber_f or p.camber_roll_f) if i < 2 else (p.camber_r or p.camber_roll_r)):
            patch = patch._replace(camber=0.0)
        done = ca.vertcat(*map(ca.SX, own.contact(i, patch)))
        wheels.append(ca.Function("wheel", [one], [ca.cse(ca.densify(done))]))
    loads, tires, carried = ca.SX.sym("loads", 4), ca.SX.sym("tires", 4 * _N_CONTACT), ca.SX.sym("angles", len(angles))
    contacts = [Contact(*[tires[4 * k + i] for k in range(_N_CONTACT)]) for i in range(4)]
    rates = car.rates(x, u, start, [loads[i] for i in range(4)], contacts, [carried[i] for i in range(len(angles))])
    after = ca.Function("after", [x, u, start, loads, tires, carried], [ca.cse(ca.densify(rates))])
    finish = ca.Function("finish", [start, x, u], [ca.cse(ca.densify(car.finish(start, x, u)))])
    return _Parts(before, tuple(wheels), after, finish)


def _of_contact(varied: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in varied if name in _OF_CONTACT)


def _with(model: _Car, chosen: Mapping[str, ca.SX]) -> _Car:
    """The model with symbols for some parameters."""
    top = {n: v for n, v in chosen.items() if n not in _FRICTION}
    params = model.params.with_values(**top) if top else model.params
    friction = tuple(chosen.get(n, mu) for n, mu in zip(_FRICTION, model.road.friction, strict=True))
    made = object.__new__(type(model))
    for name in (*model.__dataclass_fields__, "inputs"):
        object.__setattr__(made, name, getattr(model, name))
    object.__setattr__(made, "params", params)
    object.__setattr__(made, "road", replace(model.road, friction=friction))
    return made


_STEP = """\
static void rates_{t}(const {T} *x, const {T} *u, const {T} *start, {T} *rate)
{{
    {T} patch[{P}], angles[{A}], tires[{C}];
    before_{t}(x, u, patch, angles);
{wheels}
    after_{t}(x, u, start, patch + {load}, tires, angles, rate);
}}

static void step_{t}({T} *x, const {T} *u)
{{
    {T} start[{n}], y[{n}], k[{n}], sum[{n}];
    for (int i = 0; i < {n}; i++) start[i] = x[i];
{method}
    finish_{t}(start, y, u, x);
}}
"""
_DRIVE = """\
/* One car: inputs u[rows][m], states out[rows][n] after each row, which is held for `hold` samples. */
void drive(double *x, const double *u, double *out, long rows, long hold)
{{
    double now[{n}];
    for (int i = 0; i < {n}; i++) now[i] = x[i];
    for (long k = 0; k < rows; k++) {{
        for (long j = 0; j < hold * {substeps}; j++) step_d(now, u + k * {m});
        for (int i = 0; i < {n}; i++) out[k * {n} + i] = now[i];
    }}
    for (int i = 0; i < {n}; i++) x[i] = now[i];
}}

/* Blocks of {W} cars: states x[block][n][{W}], inputs u[rows][block][m][{W}], out[rows][block][n][{W}] or none. */
void drive_many({T} *x, const {T} *u, {T} *out, long blocks, long first, long last, long rows, long hold)
{{
    for (long b = first; b < last; b++) {{
        {T} now[{n}];
        for (int i = 0; i < {n}; i++) now[i] = x[b * {n} + i];
        for (long k = 0; k < rows; k++) {{
            for (long j = 0; j < hold * {substeps}; j++) step_w(now, u + (k * blocks + b) * {m});
            if (out) for (int i = 0; i < {n}; i++) out[(k * blocks + b) * {n} + i] = now[i];
        }}
        for (int i = 0; i < {n}; i++) x[b * {n} + i] = now[i];
    }}
}}
"""


def source(model: _Car, varied: Sequence[str] = ()) -> str:
    """C of the model's step; ``varied`` parameters come after the inputs."""
    parts = _parts(model, varied)
    groups = lanes_alike(parts.wheels)
    text = [preamble("double", "v4", f"v{WIDE}")]
    for t, T, lane_type in (("d", "double", "v4"), ("w", f"v{WIDE}", f"v{WIDE}")):
        text += [emit(getattr(parts, name), f"{name}_{t}", T) for name in ("before", "after", "finish")]
        for g, members in enumerate(groups):
            lanes = [parts.wheels[i] for i in members]
            text.append(emit(lanes[0], f"wheel{g}_{t}", lane_type, lanes=lanes))
        n_patch = _N_PATCH + len(_of_contact(varied))
        wheels = (_four_wheels if t == "d" else _wheel_by_wheel)(parts, groups, n_patch)
        rates = f"rates_{t}({{x}}, u, start, {{k}})"
        method = explicit_step(model.method, rates, n=model.n_states, h=model.dt / model.substeps, out="y")
        angles = parts.before.numel_out(1)
        sizes = {"A": angles, "P": 4 * n_patch, "C": 4 * _N_CONTACT, "load": 4 * Patch._fields.index("load")}
        text.append(_STEP.format(t=t, T=T, n=model.n_states, wheels=wheels, method=method, **sizes))
    m = model.n_inputs + len(varied)
    text.append(_DRIVE.format(n=model.n_states, m=m, substeps=model.substeps, W=WIDE, T=f"v{WIDE}"))
    return "\n".join(text)


def _four_wheels(parts: _Parts, groups: Sequence[Sequence[int]], n_patch: int) -> str:
    """The wheels of one car as the lanes of a vector."""
    lines = [f"    v4 p[{n_patch}], f[{_N_CONTACT}];"]
    lines.append(f"    for (int i = 0; i < {n_patch}; i++) __builtin_memcpy(&p[i], patch + 4 * i, 32);")
    for g, members in enumerate(groups):
        table = differing_constants([parts.wheels[i] for i in members])
        full = np.zeros((len(table), 4))
        full[:] = table[:, :1] if len(table) else 0.0
        full[:, list(members)] = table
        lines += [_constants(f"lane{g}", "v4", full), f"    wheel{g}_d(p, f, lane{g});"]
        for i in range(_N_CONTACT):
            lines += [f"    tires[{4 * i + w}] = f[{i}][{w}];" for w in members]
    return "\n".join(lines)


def _wheel_by_wheel(parts: _Parts, groups: Sequence[Sequence[int]], n_patch: int) -> str:
    """One wheel of many cars after the other."""
    T = f"v{WIDE}"
    lines = [f"    {T} p[{n_patch}], f[{_N_CONTACT}];"]
    for g, members in enumerate(groups):
        table = differing_constants([parts.wheels[i] for i in members])
        for column, w in enumerate(members):
            spread = np.repeat(table[:, column : column + 1], WIDE, axis=1)
            lines.append(_constants(f"lane{w}", T, spread))
            lines.append(f"    for (int i = 0; i < {n_patch}; i++) p[i] = patch[4 * i + {w}];")
            lines.append(f"    wheel{g}_w(p, f, lane{w});")
            lines.append(f"    for (int i = 0; i < {_N_CONTACT}; i++) tires[4 * i + {w}] = f[i];")
    return "\n".join(lines)


def _constants(name: str, kind: str, table: np.ndarray) -> str:
    if len(table) == 0:
        return f"    const {kind} *{name} = 0;"
    rows = ", ".join("{" + ", ".join(float.hex(float(v)) for v in row) + "}" for row in table)
    return f"    static const {kind} {name}[{len(table)}] = {{{rows}}};"


@dataclass(frozen=True, eq=False)
class Kernel:
    """Compiled steps of one model; `build` makes it."""

    library: ctypes.CDLL = field(repr=False)
    n_states: int
    n_inputs: int  # with the varied parameters
    varied: tuple[str, ...] = ()  # parameters that come after the inputs, one value per car and row

    @classmethod
    def build(cls, model: _Car, *, varied: Sequence[str] = ()) -> Self | None:
        """Compile a `DualTrack`, once per content; None without a compiler.

        ``varied`` are parameters that differ between cars or over time, such as ``"mass"``; ``"mu_fl"``, ``"mu_fr"``,
        ``"mu_rl"``, ``"mu_rr"`` are the friction under each wheel. Raises ParameterError if a varied parameter is not
        known.
        """
        for name in varied:
            if name not in _FRICTION:
                model.params.si(name)
        loaded = library(source(model, varied), name="dual_track", flags=FLAGS)
        if loaded is None:
            return None
        return cls(loaded, model.n_states, model.n_inputs + len(varied), tuple(varied))

    def run(self, x: np.ndarray, u: np.ndarray, *, hold: int = 1) -> np.ndarray:
        """States of one car, shape (n + 1, n_states), the first being ``x``.

        Each row of ``u``, shape (n, n_inputs), inputs and then the varied parameters, is held for ``hold`` samples.
        """
        u = np.ascontiguousarray(u, dtype=float)
        if u.ndim != 2 or u.shape[1] != self.n_inputs or np.shape(x) != (self.n_states,) or hold < 1:
            raise ParameterError(
                f"x has shape {np.shape(x)}, u {u.shape}, hold is {hold}; expected ({self.n_states},), "
                f"(n, {self.n_inputs}) and at least 1"
            )
        out = np.empty((len(u) + 1, self.n_states))
        out[0] = x
        now = np.array(x, dtype=float)
        self.library.drive(now.ctypes.data, u.ctypes.data, out[1:].ctypes.data, len(u), hold)
        return out

    def run_many(
        self, x: np.ndarray, u: np.ndarray, *, hold: int = 1, threads: int = 1, last_only: bool = False
    ) -> np.ndarray:
        """States of many cars, shape (n + 1, n_cars, n_states), or the last, shape (n_cars, n_states).

        ``x`` has the shape (n_cars, n_states), ``u`` (n, n_cars, n_inputs), and is held as in `run`; ``threads``
        share the cars.
        """
        x, u = np.asarray(x, dtype=float), np.asarray(u, dtype=float)
        cars, rows = len(x), len(u)
        if x.shape != (cars, self.n_states) or u.shape != (rows, cars, self.n_inputs) or min(hold, threads) < 1:
            raise ParameterError(
                f"x has shape {x.shape}, u {u.shape}, hold is {hold}, threads {threads}; expected "
                f"(n_cars, {self.n_states}), (n, n_cars, {self.n_inputs}) and at least 1 of each"
            )
        blocks = -(-cars // WIDE)
        spare = [(0, blocks * WIDE - cars)]
        now = aligned(np.pad(x, [*spare, (0, 0)], "edge").reshape(blocks, WIDE, -1).transpose(0, 2, 1))
        padded = np.pad(u, [(0, 0), *spare, (0, 0)], "edge")
        given = aligned(padded.reshape(rows, blocks, WIDE, -1).transpose(0, 1, 3, 2))
        out = None if last_only else aligned(np.zeros((rows, blocks, self.n_states, WIDE)))
        target = None if out is None else out.ctypes.data

        def part(first: int, last: int) -> None:
            self.library.drive_many(now.ctypes.data, given.ctypes.data, target, blocks, first, last, rows, hold)

        if threads == 1:
            part(0, blocks)
        else:
            edges = [round(i * blocks / threads) for i in range(threads + 1)]
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(part, edges[:-1], edges[1:]))
        if out is None:
            return now.transpose(0, 2, 1).reshape(blocks * WIDE, -1)[:cars].copy()
        states = out.transpose(0, 1, 3, 2).reshape(rows, blocks * WIDE, -1)[:, :cars]
        return np.concatenate([x[None], states])
