"""What C sees of any controller: a header with units and ranges, a wrapper for C++, a program that replays a drive."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from slipangle.control.controller import Controller
from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC
from slipangle.control.switched import SwitchedMPC
from slipangle.data.channels import Quantity
from slipangle.export.drives import Drive, exogenous_rows
from slipangle.export.meanings import meaning, parameters
from slipangle.export.memory import size_of
from slipangle.export.names import comment, constants
from slipangle.export.project import Project, replay, template

LANES = (8, 4, 2, 1)
ALIGNED = 64  # bytes between which the memory of each part may begin


class Part(NamedTuple):
    """What a controller asks, in files of its own, ``car_NAME.h`` and ``.c``; the bytes of its struct by lanes."""

    name: str
    files: dict[str, str]
    sizes: dict[int, int]
    struct: str


def inner_solver(name: str, text: str) -> Part:
    """A solver from what stands after its header in ``car_NAME.c``; the header is a file of ``export/c``."""
    text = re.sub(r"\brt_(?=[a-z])", f"car_{name}_rt_", text)  # so that several go into one program
    sizes = {n: size_of(text, "Work", n) for n in LANES}
    prefix = f"CAR_{name.upper()}"
    head = f'#include "car_{name}.h"\n#define LANES {prefix}_LANES\n#define CALLERS_CLOCK\n{text}'
    header = template(f"{name}.h").replace("@LANES@\n", lanes(prefix, sizes, text))
    return Part(name, {f"car_{name}.h": header, f"car_{name}.c": head}, sizes, f"car_{name}")


def project(
    controller: Controller,
    name: str,
    drive: Drive,
    source: str,
    *,
    kind: str,
    facts: Mapping[str, Any],
    flags: tuple[str, ...] = (),
    parts: Sequence[Part] = (),
) -> Project:
    """The files of a controller whose C is ``source``, a template that begins after its header.

    Parameters
    ----------
    controller : Controller
        What is exported.
    name : str
        The project's name, checked.
    drive : Drive
        What the replay repeats.
    source : str
        C that defines the functions of the header and a struct ``Controller``; see `around`.
    kind : str
        What the controller is, in words.
    facts : mapping
        For the manifest.
    flags : tuple of str, optional
        Those that Python compiles the same code with.
    parts : sequence of Part, optional
        Those that it asks, with files and memory of their own.
    """
    counts = "\n".join(f"#define CAR_{k} {v}" for k, v in counts_of(controller).items())
    own = {lanes: size_of(f"{counts}\n{source}", "Controller", lanes) for lanes in LANES}
    inner = {name: text for part in parts for name, text in part.files.items()}
    sizes = {n: size + sum(part.sizes[n] for part in parts) for n, size in own.items()}
    title = f"{kind} of {controller.horizon} stages, a plan every {controller.dt:g} s"
    c = f'#include "car.h"\n#define LANES CAR_LANES\n#define CALLERS_CLOCK\n{source}'
    return Project(
        name=name,
        kind=kind,
        sentence=f"A {comment(title)}.",
        files={
            "car.h": header(controller, own, title, parts, source),
            "car.hpp": template("car.hpp"),
            "car.c": c,
            **inner,
            "car_block.h": template("controller_block.h"),
            "main.c": replay("main.c"),
        },
        sources=("car.c", *(n for n in inner if n.endswith(".c"))),
        drive=drive.text(),
        about=_about(controller, sizes),
        facts={
            **facts,
            "dt": float(controller.dt),
            "drive": {"steps": len(drive.commands)},
            **_interface(controller, sizes),
        },
        flags=flags,
    )


def around(*decision: str) -> str:
    """C of a controller: what defines its struct and how it decides, and around this what all have."""
    return template("controller.c").replace("@DECISION@", "\n".join(decision))


def _interface(controller: Controller, sizes: Mapping[int, int]) -> dict[str, Any]:
    """Names and sizes, for those who load what was compiled from this."""
    names = {n: list(getattr(controller, n)) for n in ("controls", "references", "exogenous")}
    names["decided"] = list(decided_once(controller))
    names |= {"states": list(controller.model.states), "times": [float(t) for t in controller.times]}
    most = max(sizes.values()) + 3 * ALIGNED
    return {"interface": names, "sizes": {**counts_of(controller), "BYTES": most}, "bytes": dict(sizes)}


def header(
    controller: Controller, sizes: Mapping[int, int], title: str, parts: Sequence[Part] = (), source: str = ""
) -> str:
    """The text of ``car.h`` for a ``source``; the sizes are without the parts' own."""
    places = {"@STATES@": ("X", controller.model.states), "@CONTROLS@": ("U", controller.controls)}
    places |= {"@REFERENCES@": ("P", controller.references), "@EXOGENOUS@": ("W", controller.exogenous)}
    low, high = (controller if isinstance(controller, SwitchedMPC) else base_of(controller))._judge.ranges
    ranges = dict(
        zip(
            [*controller.model.states, *controller.references, *controller.exogenous],
            zip(low, high, strict=True),
            strict=False,
        )
    )
    bounds, own = limits_of(base_of(controller)), controller.model.quantities
    rates = {n: f", {a:.6g} to {b:.6g} per second" for n, (a, b) in rates_of(base_of(controller)).items()}
    text = template("car.h").replace("@TITLE@", comment(title)).replace("@LANES@\n", lanes("CAR", sizes, source))
    text = text.replace("@COUNTS@", "\n".join(f"#define CAR_{k} {v}" for k, v in counts_of(controller).items()))
    text = text.replace("@DT@", repr(float(controller.dt))).replace("@DECIDED@\n", _decided(controller))
    text = text.replace("@INCLUDED@", "".join(f'#include "car_{part.name}.h"\n' for part in parts))
    text = text.replace("@SOLVER@", "".join(f"    {part.struct} {part.name};\n" for part in parts))
    for mark, (letter, names) in places.items():
        known = bounds if letter == "U" else ranges
        lines = [
            f"#define {c} {i} /* {_meaning(n, known.get(n), own)}{rates.get(n, '') if letter == 'U' else ''} */"
            for i, (n, c) in enumerate(constants(f"CAR_{letter}", names).items())
        ]
        text = text.replace(mark, "\n".join(lines) or "/* none */")
    return text.replace("@TIMES@", ", ".join(f"{t:g}" for t in controller.times))


def decided_once(controller: Controller) -> tuple[str, ...]:
    """What a plan decides once for the whole horizon: free parameters, and how long it is."""
    ocp = getattr(controller, "ocp", None)
    return () if ocp is None else tuple(ocp.decided_once)


def _decided(controller: Controller) -> str:
    """Names in C of what is decided once."""
    ocp, once = getattr(controller, "ocp", None), decided_once(controller)
    if ocp is None or not once:
        return ""
    bounds: dict[str, Any] = {**ocp.free, **({} if ocp.duration is None else {"duration": ocp.duration})}
    listed = enumerate(constants("CAR_D", once).items())
    own = {**parameters(ocp.model), "duration": Quantity("s", "how long the horizon is")}
    lines = [
        f"#define {c} {i} /* {_meaning(n, (float(bounds[n][0]), float(bounds[n][1])), own)} */" for i, (n, c) in listed
    ]
    return "\n".join(["/* What is decided once for the whole horizon, with its limits. */", *lines, ""])


def lanes(prefix: str, sizes: Mapping[int, int], source: str) -> str:
    """C of ``PREFIX_LANES`` and ``PREFIX_BYTES``, of bytes of memory by the numbers per vector.

    They are those that the source would have in Python, see `slipangle.codegen.expression.preamble`.
    """
    where = " && !defined __znver3__ && !defined __znver4__" if "#define HALF_IDLE" in source else ""
    bytes_ = "\n".join(
        f"{'#if' if n == LANES[0] else '#elif'} CAR_LANES == {n}\n#define CAR_BYTES {sizes[n]}" for n in LANES
    )
    return template("lanes.h").replace("@WHERE@", where).replace("@BYTES@", bytes_).replace("CAR_", f"{prefix}_") + "\n"


def counts_of(controller: Controller) -> dict[str, int]:
    """Sizes by their names in C, without the prefix."""
    return {
        "STATES": len(controller.model.states),
        "CONTROLS": len(controller.controls),
        "REFERENCES": len(controller.references),
        "EXOGENOUS": len(controller.exogenous),
        "HORIZON": controller.horizon,
        "NODES": controller.horizon + 1,
        "EXOGENOUS_ROWS": exogenous_rows(controller),
        "SWITCHES": int(isinstance(controller, SwitchedMPC)),
        "LEARNS": int(isinstance(controller, AdaptiveMultiARXMPC)),
        "DECIDED": len(decided_once(controller)),
        "CORRIDOR": int(getattr(getattr(controller, "ocp", None), "corridor", None) is not None),
    }


def base_of(controller: Controller) -> Controller:
    """The controller that judges and plans: what learns is around it."""
    if isinstance(controller, AdaptiveMultiARXMPC):
        return controller.base
    return controller.calm if isinstance(controller, SwitchedMPC) else controller


def limits_of(controller: Controller) -> dict[str, tuple[float, float]]:
    """Lowest and highest of each decided input, where it is bounded."""
    ocp, problem = getattr(controller, "ocp", None), getattr(controller, "problem", None)
    if ocp is not None:
        return {n: (float(a), float(b)) for n, (a, b) in zip(controller.controls, ocp.input_bounds, strict=True)}
    if problem is not None:
        return {controller.controls[0]: (float(problem.bounds[0]), float(problem.bounds[1]))}
    limit = float(getattr(controller, "limit", np.inf))
    return {controller.controls[0]: (-limit, limit)}


def rates_of(controller: Controller) -> dict[str, tuple[float, float]]:
    """Lowest and highest change per second of each decided input, where that is bounded."""
    owner = getattr(controller, "ocp", controller)
    rate = float(getattr(owner, "rate", np.inf))
    found = getattr(owner, "rates", {controller.controls[0]: (-rate, rate)})
    return {n: (float(low), float(high)) for n, (low, high) in found.items() if not (low == -np.inf and high == np.inf)}


def _meaning(name: str, between: tuple[float, float] | None, own: Mapping[str, Quantity]) -> str:
    said = meaning(name, own)
    return said if between is None else f"{said}, {between[0]:.6g} to {between[1]:.6g}"


def _about(controller: Controller, sizes: Mapping[int, int]) -> str:
    rows = [f"| {n} | {sizes[n]} |" for n in sorted(sizes)]
    listed = [
        ("state", controller.model.states),
        ("decided", controller.controls),
        ("reference, a row a node", controller.references),
        ("exogenous inputs, a row a node", controller.exogenous),
    ]
    names = [f"- {what}: {', '.join(comment(n) for n in names) or 'none'}" for what, names in listed]
    return "\n".join([*names, "", "| numbers per vector | bytes of memory |", "|---|---|", *rows])


def table(name: str, values: Any, kind: str = "double") -> str:
    """A constant array of numbers in C; one 0 where there are none."""
    whole = kind in ("int", "long")
    listed: Sequence[str] = [str(int(v)) if whole else _hexadecimal(float(v)) for v in np.ravel(values)] or ["0"]
    return f"static const {kind} {name}[] = {{{', '.join(listed)}}};"


def number(value: float) -> str:
    """A number in C that may stand in an expression; decimal ones there are tolerances, see `precision`."""
    return f"({_hexadecimal(float(value))})"


def _hexadecimal(v: float) -> str:
    return float.hex(v) if np.isfinite(v) else "NAN" if np.isnan(v) else "INFINITY" if v > 0 else "-INFINITY"
