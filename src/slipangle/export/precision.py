"""Single precision: the same C with float for double, its tolerances those of float, for processors without double."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from slipangle.codegen.expression import preamble
from slipangle.errors import ParameterError, shown
from slipangle.export.memory import size_of
from slipangle.export.project import Project

PRECISIONS = ("double", "single")
_VECTORS = ("vectors", "vector_math_single")
_WIDTHS = (8, 4, 2, 1)
_SHARE = 23 / 52  # of digits that are left: a tolerance of eps^p stays one
_FUNCTIONS = frozenset(
    "exp log pow sqrt sin cos tan asin acos atan atan2 sinh cosh tanh asinh acosh atanh log1p expm1 erf floor ceil "
    "fmod remainder fabs copysign fmin fmax hypot rint round".split()
)
_LANES = """\
#ifndef CAR_LANES
#if defined __AVX__
#define CAR_LANES 8
#elif defined __SSE2__ || defined __aarch64__ || defined __ARM_NEON || defined __wasm_simd128__
#define CAR_LANES 4
#else
#define CAR_LANES 1
#endif
#endif
"""
_TOKEN = re.compile(
    r"""(?P<kept>/\*.*?\*/|//[^\n]*|\#include[^\n]*
        |^[^\n]*(?:typedef\ double\ |\#define\ \w+\ \(\()car\w*_(?:seconds|signal)[^\n]*
        |^[^\n]*read_time\(car\w*_seconds[^\n]*)
    |(?P<text>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')
    |(?P<number>\b0x[0-9a-fA-F]*\.?[0-9a-fA-F]*[pP][+-]?\d+
        |(?:\b\d+\.\d*|(?<!\w)\.\d+)(?:[eE][+-]?\d+)?|\b\d+[eE][+-]?\d+)
    |(?P<word>[A-Za-z_]\w*)""",
    re.VERBOSE | re.DOTALL | re.MULTILINE,
)


def as_precision(project: Project, precision: str) -> Project:
    """The project in the wanted precision, ``"double"``, as all are written at first, or ``"single"``.

    Hand-written decimal powers of ten from 1e-4 down are tolerances: they keep their share of the digits, as 1e-8
    becomes 2.9e-4. Numbers of the problem, which are hexadecimal or have other digits, are rounded. Times of a
    clock stay double: ``car_seconds``.

    Raises
    ------
    ParameterError
        If the precision is another word, or the project holds code of CasADi's own, whose solvers need double.
    """
    if precision not in PRECISIONS:
        raise ParameterError(f"the precision is {shown(precision)}; expected 'double' or 'single'")
    if precision == "double":
        return project
    if any("casadi_real" in text for text in project.files.values()):
        raise ParameterError(
            f"the {project.kind} has steps in CasADi's own code, which has no single precision; expected one of plain "
            'operations: take precision="double"'
        )
    return _sized(replace(project, files={name: single(text) for name, text in project.files.items()}))


_APART = 0.005  # m between neighbouring numbers of single precision, from which a place is too far from the origin
_FAR = 2.0**16  # m, from where on they are that far apart


def require_near(thing: Any, precision: str) -> None:
    """Raise unless the path of what follows one lies where numbers of this precision tell places apart.

    Raises
    ------
    ParameterError
        With how far it is from the origin, and what to do.
    """
    path = getattr(thing, "path", None)
    if precision != "single" or path is None:
        return
    far = max(float(np.abs(path.X).max()), float(np.abs(path.Y).max()))
    apart = float(np.spacing(np.float32(far)))
    if apart > _APART:
        raise ParameterError(
            f"the path is up to {far:.3g} m from the origin, where numbers of single precision are {apart:.2g} m "
            f"apart; expected at most {_APART:g} m: subtract its start from the path and from what is measured, or "
            'take precision="double"'
        )


def as_near(thing: Any, precision: str) -> Any:
    """The controller, in single precision one that takes positions for a fault where numbers do not tell them apart.

    What has no plausible ranges of its own, such as a driver, whose path `require_near` looks at, stays as it is.
    """
    ranges = getattr(thing, "plausible", None)
    if precision != "single" or ranges is None:
        return thing
    names = [n for n in ("X", "Y") if n in thing.model.states]
    ends = {n: dict(ranges.items()).get(n, (-_FAR, _FAR)) for n in names}
    near = {n: (max(float(low), -_FAR), min(float(high), _FAR)) for n, (low, high) in ends.items()}
    return replace(thing, plausible={**dict(ranges.items()), **near}) if near else thing


def single(text: str) -> str:
    """C text with float for double."""
    text = text.replace(preamble("V"), "@VECTORS@").replace("8 * CAR", "4 * CAR")
    widths = re.compile(r"#ifndef CAR(\w*)_LANES\n.*?#endif\n#endif\n", re.DOTALL)
    text = widths.sub(lambda m: _LANES.replace("CAR", f"CAR{m[1]}"), text)
    return _TOKEN.sub(_token, text).replace("@VECTORS@", _vectors())


@cache
def _vectors() -> str:
    vectors, functions = ((files("slipangle.codegen") / f"{n}.h").read_text(encoding="utf-8") for n in _VECTORS)
    vectors = vectors.replace("int64_t", "int32_t").replace("INT64_", "INT32_")
    return _TOKEN.sub(_token, f"{vectors}\n{functions}")


def _token(found: re.Match[str]) -> str:
    kind, said = found.lastgroup, found[0]
    if kind == "number":
        return _number(said)
    if kind == "text":
        return said.replace("%lf", "%f").replace("%.17g", "%.9g")
    if kind == "word":
        return "float" if said == "double" else f"{said}f" if said in _FUNCTIONS else said
    return said


def _number(said: str) -> str:
    value = float.fromhex(said) if said.startswith("0x") else float(said)
    power = re.fullmatch(r"[1-9]e-([1-9]\d*)", said)
    if power and int(power[1]) >= 4:
        value = float(f"{max(value**_SHARE, 1e-30):.1e}")
    if abs(value) > 1e30:  # squares stay finite
        return "1e18f"
    kept = np.float32(value)
    written = np.format_float_scientific(kept) if kept else "0.0"
    return f"{written.replace('.e', 'e')}f"


def _sized(project: Project) -> Project:
    """The project with the sizes of its structs as they are now."""
    made = dict(project.files)
    of: dict[int, int] = dict.fromkeys(_WIDTHS, 0)  # bytes of all structs by numbers per vector
    for name, text in project.files.items():
        held = re.search(r"sizeof\((\w+)\) <= (CAR\w*)_BYTES", text)
        if held is None:
            continue
        struct, prefix, header = held[1], held[2], name.replace(".c", ".h")
        whole = "\n".join(
            [*(t for n, t in made.items() if n.endswith(".h")), text.partition("#define CALLERS_CLOCK")[2] or text]
        )
        sizes = {lanes: -(-size_of(whole, struct, lanes, number=4) // 8) * 8 for lanes in _WIDTHS}
        widths = re.compile(rf"({prefix}_LANES == (\d)\n#define {prefix}_BYTES) \d+")
        made[header], found = widths.subn(lambda m, s=sizes: f"{m[1]} {s[int(m[2])]}", made[header])
        if not found:
            made[header] = re.sub(rf"(#define {prefix}_BYTES) \d+", rf"\1 {sizes[1]}", made[header])
        of = {lanes: of[lanes] + sizes[lanes if found else 1] for lanes in of}
    facts = {**project.facts, "precision": "single"}
    if "bytes" in facts:
        facts["bytes"] = of
    if "sizes" in facts:
        facts["sizes"] = {**facts["sizes"], "BYTES": max(of.values())}
    about = re.sub(r"^\| (\d) \| \d+ \|$", lambda m: f"| {m[1]} | {of[int(m[1])]} |", project.about, flags=re.MULTILINE)
    about = re.sub(r"memory: \d+ bytes", f"memory: {max(of.values())} bytes", about)
    about = re.sub(r"constants of (\d+) bytes", lambda m: f"constants of {int(m[1]) // 2} bytes", about)
    sentence = f"{project.sentence} In single precision: `float` for every number but times of day."
    return replace(project, files=made, facts=facts, about=about, sentence=sentence)
