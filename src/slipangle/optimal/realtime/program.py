"""One optimal control problem as one C source: sizes, model code, quadratic program, algorithm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.codegen.elimination import elimination_code, increments_code, increments_pattern, nonzeros
from slipangle.codegen.expression import MOST_INSTRUCTIONS, emit, fewer_divisions, only, preamble, scalar_code
from slipangle.codegen.struct import accessors, clock
from slipangle.numerics.integrate import RADAU_A, RETRY
from slipangle.optimal.checks import ANY
from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime.curvature import curvature_function, curvature_sweeps
from slipangle.optimal.realtime.parts import (
    Implicit,
    dynamics_function,
    implicit,
    input_scale,
    jump_function,
    limit_rows,
    repeated_steps,
    stage_function,
)
from slipangle.optimal.realtime.products import chained, follow_on

LONG = 250_000  # characters of one straight-line function; beyond, it is compiled with less effort
FIELDS = (  # of the C struct, as seen from Python
    "x0 applied w p r corridor bounds q wr ws plain square lowest highest safe relaxing way_u way_x begun_u pi "
    "qp.lambda tolerance time_limit newton accept u x k working cost violation residual step seconds seconds_prepare "
    "seconds_feedback"
).split()
COUNTS = "max_iterations fixed fresh misses hands_over iterations qp_iterations by_stages anew".split()
_GCC = """\
#if defined __GNUC__ && !defined __clang__
#pragma GCC optimize("{effort}")
#endif"""


def source(ocp: OCP, *, lanes: int = 0, caller: bool = False, qp: str = "auto") -> str:
    """The whole C source.

    Parameters
    ----------
    ocp : OCP
        The problem; everything but states, references, weights and bounds of a corridor is compiled in.
    lanes : int
        Columns per vector; by default what the processor has.
    caller : bool
        Whether a caller in C brings the clock and knows the struct, so that nothing of the system is asked.
    qp : {"auto", "condensed", "riccati"}
        How quadratic programs are solved; see `RealTime`.
    """
    stage = stage_function(ocp)
    stage_lanes = scalar_code(stage)
    parts = implicit(ocp)
    sweeps = None
    called: list[ca.Function] = []
    code: list[str] = []
    if parts:
        kinds, pattern = ["RADAU"], _step_pattern(parts, ocp.model.n_states)
        code += _implicit_code(parts)
    else:
        steps = repeated_steps(ocp)
        dynamics = dynamics_function(ocp, steps)
        plain = scalar_code(dynamics) if dynamics.is_a("SXFunction") else None
        if steps is not None and steps.shorter(plain):
            kinds, pattern = ["EXPLICIT"], steps.end.sparsity_out(1)
            values: Any = repeated_steps(ocp, derivatives=False)
            code += steps.code("explicit_dynamics", "V", _columns) + values.code("explicit_values", "V", _columns)
            sweeps = None if curved(ocp) is None else curvature_sweeps(ocp)
        else:
            short = plain is not None and plain.n_instructions() <= MOST_INSTRUCTIONS
            kinds, pattern = ["EXPLICIT" if short else "CALLED"], dynamics.sparsity_out(1)
            if plain is not None and short:
                code += [_columns(plain, "explicit_dynamics"), _columns(only(plain, [0]), "explicit_values")]
            else:
                called += [_by_row(dynamics, "called_dynamics"), _by_row(only(dynamics, [0]), "called_values")]
    if stage_lanes is not None:
        code += [_columns(stage_lanes, "lanes_stage"), _columns(only(stage_lanes, [0, 1]), "stage_values")]
    else:
        called += [_by_row(stage, "called_stage"), _by_row(only(stage, [0, 1]), "called_stage_values")]
    if ocp.jumps:
        code.append(_columns(jump_function(ocp), "jump"))
    if sweeps is not None:
        code += sweeps.code("curvature", "explicit_dynamics", "V", _columns)
    elif curved(ocp) is not None:
        code.append(_columns(curvature_function(ocp), "curvature"))
    kinds.append("EXPLICIT" if stage_lanes is not None else "CALLED")
    staged = by_stages(ocp, stage, qp)
    head = [f"#define LANES {lanes}"] if lanes else []
    head += ["#define HALF_IDLE"] if kinds[0] != "CALLED" and _idle(ocp) else []
    # Straight-line code gains a twentieth where what is scheduled early still fits the registers; other code loses. The
    # time that takes grows with the square of the length: 40 s of 55 for 800 000 characters.
    scheduled = "no-schedule-insns" if max(map(len, code), default=0) > LONG else "sched-pressure"
    effort = "" if kinds[0] == "CALLED" else scheduled
    return "\n".join(
        [
            "/* Generated from one optimal control problem. */",
            "" if caller else clock(),
            _GCC.format(effort=effort) if effort else "",
            *head,
            _casadi_code(called) if called else "",
            preamble("V"),
            _sizes(ocp, stage, parts, pattern, kinds),
            *_stages(ocp, stage, qp, staged),
            *code,
            _scratch(called, bool(parts), curved(ocp) is not None),
            *map(_text, _files(ocp, staged)),
            "" if caller else accessors("rt", [*FIELDS, *COUNTS]),
        ]
    )


def _idle(ocp: OCP) -> bool:
    """Whether of vectors of eight, with all steps and the one after the last, half of one is idle."""
    return 1 <= (int(ocp.nodes[-1]) + 1) % 8 <= 4


class Staged(NamedTuple):
    """Whether a source has programs by stages, and whether because states grow, so that none is to be condensed."""

    staged: bool
    growing: bool


def by_stages(ocp: OCP, stage: ca.Function, qp: str) -> Staged:
    """Whether a source has the quadratic program by stages too, which decides between the two at every plan.

    With exact curvature it always has, unless told otherwise: only a factor by stages says whether that is positive.
    """
    if qp != "auto":
        return Staged(qp == "riccati", False)
    growing, (condense, factor) = grows(ocp), _nanoseconds(ocp, stage)
    return Staged(curved(ocp) is not None or condense > 1.3 * factor or growing, growing)  # less is not worth the code


_LARGE = 1e5  # growth over the horizon, whose square condensed programs have to hold beside the weights of inputs


def grows(ocp: OCP) -> bool:
    """Whether states grow much over the horizon where the model moves straight on: such programs are not condensed."""
    model: Any = ocp.model
    if getattr(ocp, "links", ()):  # several phases have no model of their own
        return False
    x, u = np.asarray(model.straight(20.0), dtype=float), np.zeros(model.n_inputs)
    if "v_x" in model.inputs:
        u[model.inputs.index("v_x")] = 20.0
    step = model.functions[0]  # its symbolic derivative would take longer to make than the plan
    later, by = np.asarray(step(x, u)), np.diag(1e-6 * (1 + np.abs(x)))
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number there does not tell
        A = np.column_stack([np.asarray(step(x + off, u)) - later for off in by]) / np.diag(by)
        whole = np.abs(np.linalg.matrix_power(A, int(ocp.nodes[-1])))
    return bool(np.isfinite(A).all() and not whole.max() <= _LARGE)


def _nanoseconds(ocp: OCP, stage: ca.Function) -> tuple[float, float]:
    """About how long condensing takes, and one factor by stages with its sweeps; see benchmarks/bench_horizon.py."""
    n, nx, nu = ocp.horizon, ocp.model.n_states, len(ocp.controls)
    rows = stage.nnz_out(2) + stage.nnz_out(4)
    states = 0.5 * n * int(ocp.nodes[-1]) * nu * (nx * nx + rows)
    cubes = (len(ocp.tracked) * nu * nu + nu**3) * n**3 / 6
    products = 8 * -(-(nx + nu) // 8) * (nx + _changing(ocp, stage)) * (nx + nu)
    return 0.053 * (states + cubes) + 23 * n * nx + 0.75 * (n * nu) ** 2, n * (110 + 0.13 * products)


def _changing(ocp: OCP, stage: ca.Function) -> int:
    """Controls whose value before counts in a stage: by S, by rates, or at the end."""
    rated = len(ocp.rated) > 0
    return len(ocp.controls) if len(ocp.S) or rated or stage.nnz_out(3) or stage.nnz_out(5) else 0


def _stages(ocp: OCP, stage: ca.Function, qp: str, found: Staged) -> list[str]:
    """What riccati.c asks for."""
    if not found.staged:
        return ["typedef struct { int64_t none; } Stages;"]
    condense, factor = (1.0, 0.0) if qp == "riccati" else _nanoseconds(ocp, stage)
    return [
        "#define RICCATI 1",
        f"#define NV {_changing(ocp, stage)}",
        f"#define GROWS {int(found.growing)}",
        f"#define JOINED {0 if ocp.nodes[-1] == ocp.horizon else ocp.horizon}",
        f"#define TO_CONDENSE {condense!r}",
        f"#define TO_FACTOR {factor!r}",
        _array("int", "L_INPUT", [bool(row) for row in nonzeros(stage.sparsity_out(5))]),
    ]


def _files(ocp: OCP, found: Staged) -> Sequence[str]:
    memory, method = "", ""
    if found.staged:
        memory, method = "riccati_work.c", "riccati.c bends.c rows.c interior.c"
        method += "" if curved(ocp) is None else " saddle.c"
    curve = "" if curved(ocp) is None else "curvature.c"
    return f"ranges.c qp.c {memory} work.c stages.c {curve} solver.c {method} fallback.c judge.c".split()


def curved(ocp: OCP) -> int | None:
    """The first error whose derivatives curvature.c writes, if there are any."""
    return getattr(ocp, "curved", None)


def _columns(function: ca.Function, name: str) -> str:
    """C of a function of scalar instructions on several columns at once."""
    return emit(fewer_divisions(function), name, "V")


def _implicit_code(parts: Implicit) -> list[str]:
    code = [_columns(parts.slopes, "core"), _columns(only(parts.slopes, [0]), "core_values")]
    coupled = _core_pattern(parts)
    by_input = np.array(ca.DM(parts.slopes.sparsity_out(2), 1).full()) != 0
    by = np.hstack([coupled, by_input]).T.tolist()
    sides = [{3 * a + j for a, counts in enumerate(side) if counts for j in range(3)} for side in by]
    code.append(increments_code(coupled, "newton"))
    code.append(elimination_code(increments_pattern(coupled), "newton", sides=sides))
    if parts.rest:
        code.append(_columns(parts.quadrature, "quadrature"))
        code.append(_columns(only(parts.quadrature, [0]), "quadrature_values"))
        code.append(_columns(parts.short_quadrature, "short_quadrature"))
    return code


def _core_pattern(parts: Implicit) -> np.ndarray:
    return np.array(ca.DM(parts.slopes.sparsity_out(1), 1).full()) != 0


def _by_row(function: ca.Function, name: str) -> ca.Function:
    """The function with dense outputs stored by row, by differentiating through CasADi's matrix code."""
    given = [ca.MX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
    results = map(ca.densify, function.call(given))
    return ca.Function(name, given, [r.T if r.shape[1] > 1 else r for r in results])


def _casadi_code(functions: Iterable[ca.Function]) -> str:
    generator = ca.CodeGenerator("called", {"with_header": False, "verbose": False})
    for f in functions:
        generator.add(f)
    return generator.dump()


def _text(name: str) -> str:
    return (files("slipangle.optimal.realtime") / name).read_text(encoding="utf-8")


def _array(kind: str, name: str, values: Sequence[Any] | np.ndarray, more: str = "") -> str:
    def write(v: Any) -> str:
        if kind == "int":
            return str(int(v))
        return "INFINITY" if v == np.inf else "-INFINITY" if v == -np.inf else float.hex(float(v))

    listed = ", ".join(write(v) for v in values) or "0"
    return f"static const {kind} {name}[]{more} = {{{listed}}};"


def _patterns(name: str, sparsity: ca.Sparsity) -> list[str]:
    rows = nonzeros(sparsity)
    first = np.concatenate([[0], np.cumsum([len(r) for r in rows])])
    more = " __attribute__((unused))"  # where products of few terms are written out
    return [
        _array("int", f"{name}_FIRST", first, more),
        _array("int", f"{name}_AT", [c for r in rows for c in r], more),
    ]


def _sizes(ocp: OCP, stage: ca.Function, parts: Implicit | None, pattern: ca.Sparsity, kinds: list[str]) -> str:
    # Long: one entry per size of the C code.
    n, nx, nu = ocp.horizon, ocp.model.n_states, len(ocp.controls)
    rows = limit_rows(ocp)
    rated = int(np.isfinite(ocp.step_bounds).any(axis=2).sum())
    core = len(parts.core) if parts else 0
    numbers = {
        "N": n,
        "NS": int(ocp.nodes[-1]),
        "NX": nx,
        "NU": nu,
        "NW": len(ocp.exogenous),
        "NP": len(ocp.references),
        "NE": len(ocp.tracked),
        "NL": len(ocp.limited),
        "NC": core,
        "NK": 3 * core,
        "NQ": len(parts.rest) if parts else 0,
        "QN": n * nu,
        "QR": rated,
        "QD": len(rows),
        "N_LIMITS": len(rows),
        "JUMPS": len(ocp.jumps),
        "SADDLE": int(curved(ocp) is not None),
        "TURNS": 0 if curved(ocp) is None else (n + 1) * (ocp.model.n_states + nu),
    }
    lines = ["#define EXPLICIT 0", "#define RADAU 1", "#define CALLED 2", f"#define ANY_INPUT {ANY!r}"]
    lines += [f"#define DYNAMICS {kinds[0]}", f"#define STAGE {kinds[1]}", "#define M1(n) ((n) > 0 ? (n) : 1)"]
    lines += [f"#define {k} {v}" for k, v in numbers.items()]
    if ocp.headings is not None:
        lines += [f"#define {name} {i}" for name, i in zip(("HEADING", "HEADING_WANTED"), ocp.headings, strict=True)]
    if ocp.corridor is not None:
        at = ocp.limited.index("e_y")
        low, high = (
            f"({'-' if v < 0 else ''}INFINITY)" if np.isinf(v) else f"({v!r})" for v in ocp.state_limits[at].tolist()
        )
        lines += [f"#define EDGES {at}", f"#define HALF_WIDTH {0.5 * ocp.corridor!r}"]
        lines += [f"#define EDGE_LOW {low}", f"#define EDGE_HIGH {high}"]
    if curved(ocp) is not None:
        lines.append(f"#define CURVED {curved(ocp)}")
    lines.append("#define GROUPS ((NS + LANES - 1) / LANES)")
    lines += [
        _array("double", "SCALE", input_scale(ocp)),
        _array("double", "INPUT_LOW", ocp.input_bounds[:, 0]),
        _array("double", "INPUT_HIGH", ocp.input_bounds[:, 1]),
        _array("double", "STEP_LOW", ocp.step_bounds[..., 0].ravel()),
        _array("double", "STEP_HIGH", ocp.step_bounds[..., 1].ravel()),
        _array("int", "LIMIT_STAGE", [i for i, _ in rows]),
        _array("int", "LIMIT_WHICH", [j for _, j in rows]),
        _array("int", "E_INPUT", [bool(row) for row in nonzeros(stage.sparsity_out(3))]),
        *_patterns("E", stage.sparsity_out(2)),
        *_patterns("L", stage.sparsity_out(4)),
    ]
    if ocp.jumps:
        lines += [_array("int", "JUMP", ocp.jumps), _array("int", "END", ocp.ends)]
        lines += [_array("int", "X_LATER", ocp.later_x), _array("int", "U_LATER", ocp.later_u)]
    if ocp.nodes[-1] > n:
        lines += [_array("int", "NODES", ocp.nodes), _array("int", "STAGES", ocp.stage_of)]
    if parts:
        lines += [
            f"#define STEP {ocp.dt!r}",
            f"#define SHORT {RETRY}",
            _array("double", "SHORT_H", (ocp.dt / RETRY * RADAU_A).ravel()),
            _array("double", "SHORT_G", np.linalg.inv(ocp.dt / RETRY * RADAU_A).ravel()),
            _array("int", "CORE", parts.core),
            _array("int", "REST", parts.rest),
            _array("double", "RADAU_H", (ocp.dt * RADAU_A).ravel()),
            _array("double", "RADAU_G", np.linalg.inv(ocp.dt * RADAU_A).ravel()),
            _array("double", "RADAU_REST", np.linalg.solve(ocp.dt * RADAU_A, np.ones(3))),
            *_patterns("Q", parts.quadrature.sparsity_out(1)),
        ]
    if ocp.jumps:
        pattern = pattern + jump_function(ocp).sparsity_out(1)
    lines += _patterns("A", pattern)
    lines += [chained(nonzeros(pattern)), follow_on(nonzeros(pattern))]
    return "\n".join(lines) + "\n"


def _step_pattern(parts: Implicit, nx: int) -> ca.Sparsity:
    """Nonzeros of the derivative of the next state by the state."""
    core, rest = list(parts.core), list(parts.rest)
    filled = np.eye(nx, dtype=bool)
    inner = _core_pattern(parts) | np.eye(len(core), dtype=bool)
    for _ in core:
        inner = (inner.astype(int) @ inner.astype(int)) > 0
    filled[np.ix_(core, core)] = inner
    by_slope = np.array(ca.DM(parts.quadrature.sparsity_out(1), 1).full()) != 0
    by_state = np.array(ca.DM(parts.quadrature.sparsity_out(2), 1).full()) != 0
    for i, a in enumerate(rest):
        used = by_slope[i].reshape(len(core), 3).any(axis=1)
        filled[a] |= by_state[i]
        filled[a, core] |= (used[:, None] & inner).any(axis=0)
    rows, columns = np.nonzero(filled)
    return ca.Sparsity.triplet(nx, nx, rows.tolist(), columns.tolist())


def _scratch(called: Sequence[ca.Function], is_implicit: bool, is_curved: bool) -> str:
    lines = ["typedef struct {"]
    lines.append("    V x[NX], u[NU], w[M1(NW)], p[M1(NP)], next[NX], A[NX * NX], B[NX * NU], e[M1(NE)], l[M1(NL)];")
    lines.append("    V E[M1(NE * NX)], D[M1(NE * NU)], LX[M1(NL * NX)], LU[M1(NL * NU)];")
    if is_curved:
        lines.append("    V pi[NX], mu[M1(NL)], nu[NE], M[(NX + NU) * (NX + NU)];")
    if is_implicit:
        lines.append("    V k[NK], z[NK], d[NK], kept[NK], way[NK], *m, *s, dx[NX], du[NU], shift[NU];")
        lines.append(
            "    V factors[(GROUPS + 1) * NK * NK], by[(GROUPS + 1) * (NC + NU) * NK]; /* m and s of all columns */"
        )
        lines.append("    I spoilt[GROUPS + 1]; /* whose they are not, as those took short steps */")
        lines.append("    V f[3 * NC], fx[3 * NC * NC], fu[3 * NC * NU];")
        lines.append("    V q[M1(NQ)], qz[M1(NQ * NK)], qx[M1(NQ * NX)], qu[M1(NQ * NU)];")
    if called:
        lines.append(f"    const double *in[{max(f.sz_arg() for f in called)}];")
        lines.append(f"    double *out[{max(f.sz_res() for f in called)}];")
        lines.append(f"    double work[{1 + max(f.sz_w() for f in called)}];")
        lines.append(f"    long long int iw[{1 + max(f.sz_iw() for f in called)}];")
    return "\n".join([*lines, "} Scratch;\n"])
