"""FMUs for co-simulation, FMI 2.0 and 3.0: models, controllers and drivers as C and a library for this machine."""

from __future__ import annotations

import json
import platform
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca

from slipangle.codegen import compiler
from slipangle.control.driver import Driver
from slipangle.control.racing.racer import Racer
from slipangle.data.channels import Quantity
from slipangle.errors import ParameterError, WriteError, shown
from slipangle.estimate.filter import moving, parametrised
from slipangle.export.controllers import table
from slipangle.export.drivers import meanings
from slipangle.export.drives import SPEED
from slipangle.export.fmi_description import Part, Variable, build_description, channel, description, unique
from slipangle.export.kinds import project_of
from slipangle.export.models import sourced
from slipangle.export.names import checked, with_prefix
from slipangle.export.project import LICENCE, Project, guarded
from slipangle.export.racers import MEANINGS
from slipangle.export.settings import is_count, place
from slipangle.files import write_atomic
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.parameters import ParameterSet

PLATFORMS = {"Linux": "linux64", "Windows": "win64", "Darwin": "darwin64"}
NOT_MEASURED = 1e300  # beyond every channel's range
LARGEST = sys.float_info.max  # start of a parameter that is infinite, for which a description has no number
NOT_NEW = "new when it changes; NaN and 1e300: not measured"
APPLIED = "as it was over the step before; NaN and 1e300: as commanded"
DRIVER_DOCS = {
    "wanted_v_x": "speed that the vehicle should have; 0: it should stop",
    "s": "arc length of the path beside the vehicle",
    "e_y": "how far the vehicle is to the left of the path, as estimated",
    "reason": "where commands come from, as in the C header; 0: a plan; -1: there was no step yet",
    "planned": "0: there is no plan, and the numbers on it say nothing",
    "status": "how the solve ended, as in the C header",
    "age": "0: a solution; k: a fallback, the k-th in a row",
    "stopping": "1: no recent plan is left, the vehicle should stop",
    "fallbacks": "plans so far that were no solution",
    "restarts": "how often the estimator had to start anew",
}
DRIVER_NUMBERS = ("reason", "planned", "status", "age", "stopping", "fallbacks", "restarts")
EDGES = {e: Quantity("m", f"distance of the {e} edge from the path") for e in ("right", "left")}
STATUS_NUMBERS = ("status", "age", "stopping", "fallbacks")
VERSIONS = (2, 3)


def export_fmu(
    thing: Any,
    path: str | Path,
    *,
    name: str = "",
    version: int = 2,
    binary: bool = True,
    force: bool = False,
) -> Path:
    """Write a model, a controller or a driver as an FMU for co-simulation, FMI 2.0 or 3.0.

    A model has its inputs and outputs, its states as local variables ``state.NAME``, whose start values can be set
    before initialisation, and its parameters, within their ranges, as tunable ones, an infinite one from the largest
    finite number on; directional derivatives are those of its outputs by all these. A model whose equations branch by
    its parameters, the dual track, has them compiled in. A controller has its state, reference, exogenous inputs and
    corridor as inputs, ``reference.Y[3]`` the fourth node's, and ``applied.NAME``, what was really applied of its last
    command; and its command, status, age, ``stopping`` and count of fallbacks as
    outputs, which belong to the inputs at the beginning of the last step. A step is a whole number of sample times;
    inputs are held over it. The state can be saved, restored and written out. Names are those of the channels, each
    different: a second one of the same name gets a number.

    Parameters
    ----------
    thing : Model, MPC, MultiARXMPC, SwitchedMPC, PathFollower, Driver or Racer
        What to export.
    path : str or Path
        The file, which ends in ``.fmu``.
    name : str, optional
        Its model identifier; by default what is exported, such as ``mpc``.
    version : int
        2 or 3, of FMI.
    binary : bool
        Compile a library for this kind of machine too; the source is always there.
    force : bool
        Replace a file that is there.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        If there is no compiler for the library.
    ParameterError
        If the thing has no C, a setting is of another kind, or the name cannot be one there.
    WriteError
        If the file is there already, does not end in ``.fmu`` or cannot be written.
    """
    target = place(path, "path")
    require_suffix(target)
    if target.exists() and not force:
        raise WriteError(f"'{target}' is there already; expected a new file: name another, or replace it with --force")
    if version not in VERSIONS or not is_count(version):
        raise ParameterError(f"the version of FMI is {shown(version)}; expected 2 or 3: say version=3")
    project = project_of(thing, checked(name) if name else "", 2)
    part = _part(thing, project)
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, part.code + str(part.variables) + ''.join(part.files.values()))}}}"
    shell = project.name if not part.files else f"{project.name}_fmu"  # beside files of their own names
    own = f"{shell}.c"
    sources = {**part.files, own: guarded(own, _source(part, guid, float(project.facts["dt"]), version))}
    compiled = [n for n in sources if n.endswith(".c")]
    with tempfile.TemporaryDirectory(prefix="slipangle-fmu-") as scratch:
        made = Path(scratch) / "made.fmu"
        with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", description(project, part, compiled, guid, version))
            for file, text in sources.items():
                archive.writestr(f"sources/{file}", text)
                (Path(scratch) / file).write_text(text, encoding="utf-8")
            if version == 3:
                archive.writestr("sources/buildDescription.xml", build_description(project.name, compiled))
            archive.writestr("documentation/licenses/license.txt", LICENCE)
            if binary:
                library = Path(scratch) / f"all{compiler.SUFFIX}"
                flags = (*project.flags, "-fvisibility=hidden")
                compiler.compile_file([Path(scratch) / n for n in compiled], library, flags=flags, portable=True)
                archive.write(library, f"binaries/{_platform(version)}/{project.name}{compiler.SUFFIX}")
        return write_atomic(target, made.read_bytes())


def require_suffix(path: Path) -> None:
    """Raise WriteError unless the file has the suffix by which importers tell an FMU."""
    if path.suffix.lower() != ".fmu":
        raise WriteError(
            f"'{path}' does not end in .fmu; expected that, by which importers tell an FMU: say '{path}.fmu'"
        )


def _part(thing: Any, project: Project) -> Part:
    """What an FMU has of its own by its kind."""
    if isinstance(thing, Driver | Racer):
        return _of_driver(thing, project)
    if "interface" in project.facts:
        return _of_controller(project, {**thing.model.quantities, **EDGES})
    if isinstance(thing, Model):
        return _of_model(thing)
    raise ParameterError(
        f"a {type(thing).__name__} has no FMU; expected a model, a controller or a driver: export it as C"
    )


def _platform(version: int) -> str:
    """Folder of binaries for this machine."""
    system, machine = platform.system(), platform.machine().lower()
    if version == 2:
        return PLATFORMS.get(system, system.lower() + "64")
    return f"{ {'amd64': 'x86_64', 'arm64': 'aarch64'}.get(machine, machine) }-{system.lower()}"


class _AsTheyAre:
    """Parameters as a filter takes them, without a scale."""

    @staticmethod
    def values(q: Any) -> list[Any]:
        return [q[i] for i in range(q.numel())]


def _of_model(model: Any) -> Part:
    """C of step, output and its derivative, by all that can be set; and the variables, states first."""
    names, functions = _parametric(model)
    n, start = model.n_states, model.straight(SPEED)
    own = model.quantities
    listed = [channel(f"state.{s}", "local", s, float(v), own) for s, v in zip(model.states, start, strict=True)]
    listed += [channel(s, "input", s, SPEED if s == "v_x" else 0.0, own) for s in model.inputs]
    for s in names:
        said = parametrised(model).si(s)
        value = min(max(float(parametrised(model).value(s)), -LARGEST), LARGEST)
        low, high = min(float(said.lower), value), max(float(said.upper), value)
        listed.append(
            Variable(name=s, causality="parameter", unit=said.unit, doc=said.doc, start=value, low=low, high=high)
        )
    listed += [channel(s, "output", s, own=own) for s in model.outputs]
    step, output, slope = functions
    doubts, above = _doubts(model, names)
    declared = [
        ("static void stepOf", step, ["v[REALS]"], "next[STATES]"),
        ("static void outputOf", output, ["v[REALS]"], "y[REALS - OUTPUTS]"),
        ("static void slopeOf", slope, ["v[REALS]", "along[REALS]"], "y[REALS - OUTPUTS]"),
        *([("static void doubtOf", above, ["v[REALS]"], "above[DOUBTS]")] if doubts else []),
    ]
    ranges = [v for v in listed if v.causality == "parameter"]
    sizes = {"STATES": n, "PARAMETERS": len(ranges), "DOUBTS": len(doubts)}
    lines = [*(f"#define {k} {v}" for k, v in sizes.items()), sourced(declared)]
    lines += [table("LEAST", [v.low for v in ranges]), table("MOST", [v.high for v in ranges])] if ranges else []
    lines += [f"static const char *const SAID[] = {{{', '.join(map(json.dumps, doubts))}}};"] if doubts else []
    return Part(code="\n".join([*lines, _template("model.c")]), variables=unique(listed), derivatives=True)


def _doubts(model: Any, names: tuple[str, ...]) -> tuple[list[str], ca.Function | None]:
    """What may be wrong with parameters that do not go together, and what is then not above zero."""
    v = ca.SX.sym("v", model.n_states + model.n_inputs + len(names))
    first = v.numel() - len(names)
    values = {name: v[first + i] for i, name in enumerate(names)}
    params = parametrised(model).with_values(**values).ode.params if names else None
    found = params.doubts if isinstance(params, ParameterSet) else {}
    return list(found), ca.Function("doubt", [v], [ca.densify(ca.vertcat(*found.values()))]) if found else None


def _parametric(model: Any) -> tuple[tuple[str, ...], tuple[ca.Function, ...]]:
    """Names of parameters that can be symbols, and ``step``, ``output`` and its derivative along a direction.

    They are functions of states, inputs and parameters in one vector, the last of two such vectors.
    """
    own = model.off_ground
    names = tuple(own.parameter_names) if isinstance(own, Parametrised) else ()
    try:
        return names, _functions(model, names)
    except RuntimeError:  # CasADi's, of an equation that asks whether a parameter is more than another
        return (), _functions(model, ())


def _functions(model: Any, names: tuple[str, ...]) -> tuple[ca.Function, ...]:
    kind, step, output = moving(model, names, _AsTheyAre())  # type: ignore[arg-type]
    n, m = model.n_states, model.n_states + model.n_inputs
    v, along = (kind.sym(name, m + len(names)) for name in ("v", "along"))
    next_, y = step(v[:n], v[m:], v[n:m]), output(v[:n], v[m:], v[n:m])
    slope = ca.jtimes(y, v, along)
    results = {"step": ([v], next_), "output": ([v], y), "slope": ([v, along], slope)}
    return tuple(ca.Function(name, given, [ca.densify(made)]) for name, (given, made) in results.items())


def _of_controller(project: Project, own: Mapping[str, Quantity]) -> Part:
    """A shell around the files of a controller, and the variables: its input struct's numbers, then what it decided."""
    names, n = project.facts["interface"], project.facts["sizes"]
    listed = [channel(f"state.{s}", "input", s, 0.0, own) for s in names["states"]]
    for what, columns, rows in (
        ("reference", names["references"], n["NODES"]),
        ("exogenous", names["exogenous"], n["EXOGENOUS_ROWS"]),
        ("corridor", ("right", "left") if n["CORRIDOR"] else (), n["NODES"]),
    ):
        listed += [channel(f"{what}.{c}[{i}]", "input", c, 0.0, own) for i in range(rows) for c in columns]
    applied = [channel(f"applied.{c}", "input", c, NOT_MEASURED, own) for c in names["controls"]]
    listed += [replace(v, doc=f"{v.doc}; {APPLIED}".removeprefix("; ")) for v in applied]
    listed += [channel(c, "output", c, own=own) for c in names["controls"]]
    listed += [replace(channel(c, "output", ""), doc=DRIVER_DOCS[c]) for c in STATUS_NUMBERS]
    listed = [replace(v, doc=f"{v.doc}; -1: nothing was planned yet") if v.name == "status" else v for v in listed]
    return _shell("controller.c", project, listed)


def _of_driver(driver: Driver | Racer, project: Project) -> Part:
    """A shell around the files of a driver, and the variables: what is measured, then what it wants and believes."""
    names, own = project.facts["interface"], MEANINGS if isinstance(driver, Racer) else meanings(driver)
    told = (channel(f"measured.{n}", "input", n, NOT_MEASURED, own) for n in names["channels"])
    listed = [replace(v, doc=f"{v.doc}; {NOT_NEW}".removeprefix("; ")) for v in told]
    listed += [channel(n, "output", n, own=own) for n in names["controls"]]
    listed += [channel(n, "output", of) for n, of in (("wanted_v_x", "v_x"), ("s", "X"), ("e_y", "Y"))]
    for what, of in (("state", ""), ("state_std", "standard deviation: ")):
        made = [channel(f"{what}.{n}", "output", n, own=own) for n in names["states"]]
        listed += [replace(v, doc=f"{of}{v.doc}") for v in made]
    listed = [replace(v, doc=DRIVER_DOCS.get(v.name, v.doc)) for v in listed]
    listed += [replace(channel(n, "output", ""), doc=DRIVER_DOCS[n]) for n in DRIVER_NUMBERS]
    return _shell("driver.c", project, listed)


def _shell(name: str, project: Project, variables: list[Variable]) -> Part:
    """A file of ``export/fmu`` around those of a project, each of which stays one of its own."""
    kept = _compiled(project)
    without = "#define PARAMETERS 0\n#define DOUBTS 0"
    code = f'#include "{project.name}.h"\n{without}\n{with_prefix(_template(name), project.name)}'
    return Part(
        code=code,
        variables=unique(variables),
        files={n: text for n, text in project.everything.items() if n in kept},
    )


def _compiled(project: Project) -> set[str]:
    """Sources of a project and their headers, by name."""
    sources = {with_prefix(n, project.name) for n in project.sources}
    return sources | {n.removesuffix(".c") + ".h" for n in sources}


def _source(part: Part, guid: str, dt: float, version: int) -> str:
    """The C source with the functions of FMI."""
    variables = part.variables
    outputs = next(i for i, v in enumerate(variables) if v.causality == "output")
    numbers = {"REALS": len(variables), "OUTPUTS": outputs, "DT": repr(dt), "GUID": f'"{guid}"'}
    numbers["HAS_TIME"] = int(version == 3)
    parts = [
        "#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n#include <string.h>",
        *(f"#define {k} {v}" for k, v in numbers.items()),
        part.code,
        table("STARTS", [0.0 if v.start is None else v.start for v in variables]),
        _template("instance.c"),
        _template(f"fmi{version}.c"),
    ]
    return "\n".join(parts)


def _template(name: str) -> str:
    return (files("slipangle.export") / "fmu" / name).read_text(encoding="utf-8")
