"""C of free runs with forward sensitivities, see `forward`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.elimination import elimination_code, stages_pattern
from slipangle.codegen.expression import emit, preamble
from slipangle.codegen.integrators import explicit_step
from slipangle.identify.physics.structure import structure
from slipangle.models.ode import Parametrised
from slipangle.numerics.integrate import MISSED, RADAU_A, RETRY, SHORTENED

ITERATIONS = 12  # of Newton's method, as in the integrator itself
WIDE = 8  # derivatives that are added up side by side


def width(model: Any) -> int:
    """Length of a row of the drive."""
    wrapped = model.n_states - model.ode.n_states
    return model.n_inputs + wrapped


@dataclass(frozen=True)
class Code:
    """C of a free run in two libraries, as a delay's drive is long, and the same whatever else is free.

    ``run`` has all but the drive; ``rest`` are the parameters that it takes besides the free ones. ``drive`` is a
    function of the row and of those of all parameters that have these ``places``.
    """

    run: str
    drive: str
    places: np.ndarray
    rest: np.ndarray


def code_of(model: Parametrised, free: tuple[str, ...]) -> Code:
    """C of the free run of a parametrised model, written once for all that differ in values of parameters only."""
    # A parameter that is zero and stays so becomes no symbol, as a whole effect may go with it.
    others = tuple(n for n in model.parameter_names if n not in free and model.value(n) != 0)
    known, made = (*free, *others), None
    try:
        key = structure(_with_symbols(model, known))
    except _CLOSED:
        pass  # what else there may be between its fields and its equations is not known
    else:
        made = _fitting_any(_Written((free, key), model, free, others))
    if made is None:
        known = _numbers(model, free, others)
        made = _code_of(model, len(free), known)
    body, drive, places = made
    return Code(body, drive, places, np.array([model.value(n) for n in known[len(free) :]]))


@dataclass(frozen=True)
class _Written:
    """Code to be written; it is the same where ``key`` is, which has all but the values of parameters."""

    key: tuple[Any, ...]
    model: Any = field(compare=False)
    free: tuple[str, ...] = field(compare=False)
    others: tuple[str, ...] = field(compare=False)


@lru_cache(maxsize=64)
def _fitting_any(written: _Written) -> tuple[str, str, np.ndarray] | None:
    """See `_code_of`; None where the equations need values of the other parameters."""
    model, free, others = written.model, written.free, written.others
    known = (*free, *others)
    return _code_of(model, len(free), known) if _numbers(model, free, others) == known else None


_CLOSED = RuntimeError, NotImplementedError, TypeError, ValueError  # of equations that branch on a parameter


def _numbers(model: Parametrised, free: tuple[str, ...], others: tuple[str, ...]) -> tuple[str, ...]:
    """Parameters that can become symbols: all where the equations allow that, so that the code fits any values."""
    try:
        varied: Any = _with_symbols(model, (*free, *others))
        x, w = ca.SX.sym("x", varied.ode.n_states), ca.SX.sym("w", width(model))
        u = varied.drive(w)
        varied.ode.derivative(x, u)
        varied.ode.output(x, u)
    except _CLOSED:
        return free
    return (*free, *others)


def _with_symbols(model: Any, names: tuple[str, ...]) -> Any:
    return model.with_values(**{name: ca.SX.sym(name) for name in names})


def _code_of(model: Any, n_free: int, known: tuple[str, ...]) -> tuple[str, str, np.ndarray]:
    """Run, drive and places of `Code`, of a model whose ``known`` parameters are symbols, the first ``n_free`` free."""
    ode = model.ode
    x, w, p = ca.SX.sym("x", ode.n_states), ca.SX.sym("w", width(model)), ca.SX.sym("p", len(known))
    varied = model.with_values(**{name: p[i] for i, name in enumerate(known)})
    u = varied.drive(w)
    felt = ca.SX.sym("u", u.shape[0])
    of_felt = varied.ode.derivative(x, felt), varied.ode.output(x, felt)
    drive, places = drive_of(w, ca.densify(u), p)
    moved = np.asarray(_used(ca.jacobian(u, p))[:, :n_free].any(axis=1))
    return text_of((x, felt, p), *of_felt, n_free, ode.method, moved), drive, places


def drive_of(w: ca.SX, u: Any, p: ca.SX) -> tuple[str, np.ndarray]:
    """C of the drive and of its derivatives by the parameters in it, whose places come with it."""
    places = np.flatnonzero(ca.which_depends(u, p, 1, False)) if p.shape[0] else np.empty(0, dtype=int)
    q = ca.vertcat(*(p[int(i)] for i in places)) if len(places) else ca.SX(0, 1)
    slopes = ca.densify(ca.jacobian(u, q))
    functions = {
        "slopes": ca.Function("drive_slopes", [w, q], [u, slopes], {"cse": True}),
        "alone": ca.Function("drive_alone", [w, q], [u], {"cse": True}),
    }
    given = "const double *w, const double *q, double *u"
    shells = [
        f"void driven({given}, double *uq) {{ slopes(w, q, u, uq); }}",
        f"void undriven({given}) {{ alone(w, q, u); }}",
    ]
    return "\n".join([preamble("double"), *(emit(f, name) for name, f in functions.items()), *shells, ""]), places


def text_of(symbols: tuple[ca.SX, ca.SX, ca.SX], f: Any, y: Any, n_p: int, method: Any, moved: np.ndarray) -> str:
    """C of the free run with rates ``f``, or with ``f`` as the next state where the method is "map".

    The symbols are x, u and p, of whose entries the first ``n_p`` are free; ``moved`` says which of u they move.
    """
    x, u, p = symbols
    f, y = ca.densify(f), ca.densify(y)
    padding = -n_p % WIDE if n_p else WIDE

    def by_p(value: Any) -> Any:
        return ca.horzcat(ca.jacobian(value, p)[:, :n_p], ca.SX(value.shape[0], padding))

    def with_slopes(name: str, value: Any) -> ca.Function:
        slopes = [ca.jacobian(value, x), ca.jacobian(value, u), by_p(value)]
        return ca.Function(name, [x, u, p], [value, *slopes], {"cse": True})

    functions = {
        "rates": with_slopes("ode_rates", f),
        "outputs": with_slopes("ode_outputs", y),
        "slopes": ca.Function("ode_slopes", [x, u, p], [f]),
    }
    sizes = {"NX": x.shape[0], "NU": u.shape[0], "NY": y.shape[0], "MP": n_p + padding, "WIDE": WIDE}
    parts = [preamble("double"), *(emit(function, name) for name, function in functions.items())]
    if method == "radau":
        sizes |= {"N_SHARES": len(SHORTENED), "ITERATIONS": ITERATIONS, "MISSED": MISSED, "RETRY": RETRY}
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
