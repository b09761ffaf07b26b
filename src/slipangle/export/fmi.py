"""FMUs for co-simulation, FMI 2.0 and 3.0: a model or a controller as C source and a library for this machine."""

from __future__ import annotations

import platform
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca

from slipangle.codegen import compiler
from slipangle.errors import ParameterError, WriteError
from slipangle.estimate.filter import moving, parametrised
from slipangle.export.controllers import table
from slipangle.export.drives import SPEED
from slipangle.export.fmi_description import Variable, build_description, channel, description, unique
from slipangle.export.kinds import project_of
from slipangle.export.models import sourced
from slipangle.export.names import checked, with_prefix
from slipangle.export.project import LICENCE, Project
from slipangle.files import write_atomic
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised

PLATFORMS = {"Linux": "linux64", "Windows": "win64", "Darwin": "darwin64"}
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
    """Write a model or a controller as an FMU for co-simulation, FMI 2.0 or 3.0.

    A model has its inputs and outputs, its states as local variables ``state.NAME``, whose start values can be set
    before initialisation, and its parameters, within their ranges, as tunable ones; directional derivatives are those
    of its outputs by all these. A model whose equations branch by its parameters, the dual track, has them compiled in.
    A controller has its state, reference and exogenous inputs as inputs, ``reference.Y[3]`` the fourth node's, and its
    command, status, age, ``stopping`` and count of fallbacks as outputs, which belong to the inputs at the beginning of
    the last step. A step is a whole number of sample times; inputs are held over it. The state can be saved, restored
    and written out.

    Parameters
    ----------
    thing : Model, MPC, MultiARXMPC or PathFollower
        What to export.
    path : str or Path
        The file, such as ``"car.fmu"``.
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
        If the thing has no C, or the name cannot be one there.
    WriteError
        If the file is there already or cannot be written.
    """
    target = Path(path)
    if target.exists() and not force:
        raise WriteError(f"'{target}' is there already; expected a new file: name another, or replace it with --force")
    if version not in VERSIONS:
        raise ParameterError(f"the version of FMI is {version!r}; expected 2 or 3: say version=3")
    project = project_of(thing, checked(name) if name else "", 2)
    if "interface" in project.facts:
        code, variables = _of_controller(project)
    elif isinstance(thing, Model):
        code, variables = _of_model(thing)
    else:
        raise ParameterError(f"a {type(thing).__name__} has no FMU; expected a model or a controller: export it as C")
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, code + str(variables))}}}"
    source = _source(code, variables, guid, float(project.facts["dt"]), version)
    with tempfile.TemporaryDirectory(prefix="slipangle-fmu-") as scratch:
        made = Path(scratch) / "made.fmu"
        with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
            derivatives = "interface" not in project.facts
            archive.writestr("modelDescription.xml", description(project, variables, guid, version, derivatives))
            archive.writestr(f"sources/{project.name}.c", source)
            if version == 3:
                archive.writestr("sources/buildDescription.xml", build_description(project.name))
            archive.writestr("documentation/licenses/license.txt", LICENCE)
            if binary:
                file, library = Path(scratch) / "all.c", Path(scratch) / f"all{compiler.SUFFIX}"
                file.write_text(source, encoding="utf-8")
                compiler.compile_file(file, library, flags=("-fvisibility=hidden",), portable=True)
                archive.write(library, f"binaries/{_platform(version)}/{project.name}{compiler.SUFFIX}")
        return write_atomic(target, made.read_bytes())


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


def _of_model(model: Any) -> tuple[str, list[Variable]]:
    """C of step, output and its derivative, by all that can be set; and the variables, states first."""
    names, functions = _parametric(model)
    n, start = model.n_states, model.straight(SPEED)
    listed = [channel(f"state.{s}", "local", s, start=float(v)) for s, v in zip(model.states, start, strict=True)]
    listed += [channel(s, "input", s, start=SPEED if s == "v_x" else 0.0) for s in model.inputs]
    for s in names:
        said, value = parametrised(model).si(s), float(parametrised(model).value(s))
        low, high = min(float(said.lower), value), max(float(said.upper), value)
        listed.append(
            Variable(name=s, causality="parameter", unit=said.unit, doc=said.doc, start=value, low=low, high=high)
        )
    listed += [channel(s, "output", s) for s in model.outputs]
    step, output, slope = functions
    declared = [
        ("static void stepOf", step, ["v[REALS]"], "next[STATES]"),
        ("static void outputOf", output, ["v[REALS]"], "y[REALS - OUTPUTS]"),
        ("static void slopeOf", slope, ["v[REALS]", "along[REALS]"], "y[REALS - OUTPUTS]"),
    ]
    ranges = [v for v in listed if v.causality == "parameter"]
    lines = [f"#define STATES {n}", f"#define PARAMETERS {len(ranges)}", sourced(declared)]
    lines += [table("LEAST", [v.low for v in ranges]), table("MOST", [v.high for v in ranges])] if ranges else []
    return "\n".join([*lines, _template("model.c")]), unique(listed)


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


def _of_controller(project: Project) -> tuple[str, list[Variable]]:
    """C of a controller with its header, and the variables: the numbers of its input struct, then what it decided."""
    names, n = project.facts["interface"], project.facts["sizes"]
    listed = [channel(f"state.{s}", "input", s, start=0.0) for s in names["states"]]
    for what, columns, rows in (
        ("reference", names["references"], n["NODES"]),
        ("exogenous", names["exogenous"], n["EXOGENOUS_ROWS"]),
        ("corridor", ("right", "left") if n["CORRIDOR"] else (), n["NODES"]),
    ):
        listed += [channel(f"{what}.{c}[{i}]", "input", c, start=0.0) for i in range(rows) for c in columns]
    listed += [channel(c, "output", c) for c in names["controls"]]
    listed += [channel(c, "output", "") for c in STATUS_NUMBERS]
    given = project.everything
    code = given[f"{project.name}.c"].replace(f'#include "{project.name}.h"\n', given[f"{project.name}.h"])
    part = with_prefix(_template("controller.c"), project.name)
    return "\n".join([code, "#define PARAMETERS 0", part]), unique(listed)


def _source(code: str, variables: Sequence[Variable], guid: str, dt: float, version: int) -> str:
    """The whole C source."""
    outputs = next(i for i, v in enumerate(variables) if v.causality == "output")
    numbers = {"REALS": len(variables), "OUTPUTS": outputs, "DT": repr(dt), "GUID": f'"{guid}"'}
    numbers["HAS_TIME"] = int(version == 3)
    parts = [
        "#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n#include <string.h>",
        *(f"#define {k} {v}" for k, v in numbers.items()),
        code,
        table("STARTS", [0.0 if v.start is None else v.start for v in variables]),
        _template("instance.c"),
        _template(f"fmi{version}.c"),
    ]
    return "\n".join(parts)


def _template(name: str) -> str:
    return (files("slipangle.export") / "fmu" / name).read_text(encoding="utf-8")
