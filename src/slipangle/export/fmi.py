"""FMI 2.0 for co-simulation: a model or a controller as an FMU, its C source and a binary for this kind of machine."""

from __future__ import annotations

import platform
import re
import tempfile
import uuid
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from slipangle.codegen import compiler
from slipangle.data.channels import STANDARD
from slipangle.errors import ParameterError, WriteError
from slipangle.export.controllers import table
from slipangle.export.drives import SPEED
from slipangle.export.kinds import project_of
from slipangle.export.names import checked, with_prefix
from slipangle.export.project import Project
from slipangle.files import write_atomic
from slipangle.models.model import Model

PLATFORMS = {"Linux": "linux64", "Windows": "win64", "Darwin": "darwin64"}
BASE_UNITS = {
    "m": {"m": 1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "Pa": {"kg": 1, "m": -1, "s": -2},
}
STATUS_NUMBERS = ("status", "age", "stopping", "fallbacks")


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A real number of an FMU; ``start`` is None for what is computed."""

    name: str
    causality: str
    channel: str
    start: float | None = None


def export_fmu(thing: Any, path: str | Path, *, name: str = "", binary: bool = True, force: bool = False) -> Path:
    """Write a model or a controller as an FMU for co-simulation, FMI 2.0.

    A model has its inputs and outputs, and its states as local variables ``state.NAME``, whose start values can be set
    before initialisation. A controller has its state, reference and exogenous inputs as inputs, ``reference.Y[3]`` the
    fourth node's, and its command, status, age, ``stopping`` and count of fallbacks as outputs, which belong to the
    inputs at the beginning of the last step. A step is a whole number of sample times; inputs are held over it. Its
    state can be saved, restored and written out.

    Parameters
    ----------
    thing : Model, MPC, MultiARXMPC or PathFollower
        What to export.
    path : str or Path
        The file, such as ``"car.fmu"``.
    name : str, optional
        Its model identifier; by default what is exported, such as ``mpc``.
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
    project = project_of(thing, checked(name) if name else "", 2)
    is_controller = "interface" in project.facts
    if not is_controller and not isinstance(thing, Model):
        raise ParameterError(f"a {type(thing).__name__} has no FMU; expected a model or a controller: export it as C")
    variables = _of_controller(project) if is_controller else _of_model(thing)
    source, description = _source(project, variables, is_controller)
    with tempfile.TemporaryDirectory(prefix="slipangle-fmu-") as scratch:
        made = Path(scratch) / "made.fmu"
        with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", description)
            archive.writestr(f"sources/{project.name}.c", source)
            archive.writestr("documentation/licenses/license.txt", project.everything["LICENSE"])
            if binary:
                code, library = Path(scratch) / "all.c", Path(scratch) / f"all{compiler.SUFFIX}"
                code.write_text(source, encoding="utf-8")
                compiler.compile_file(code, library, flags=("-fvisibility=hidden",), portable=True)
                place = PLATFORMS.get(platform.system(), platform.system().lower() + "64")
                archive.write(library, f"binaries/{place}/{project.name}{compiler.SUFFIX}")
        return write_atomic(target, made.read_bytes())


def _of_model(model: Any) -> list[Variable]:
    start = model.straight(SPEED)
    listed = [
        Variable(name=f"state.{n}", causality="local", channel=n, start=float(v))
        for n, v in zip(model.states, start, strict=True)
    ]
    listed += [Variable(name=n, causality="input", channel=n, start=SPEED if n == "v_x" else 0.0) for n in model.inputs]
    return _unique([*listed, *(Variable(name=n, causality="output", channel=n) for n in model.outputs)])


def _of_controller(project: Project) -> list[Variable]:
    names, n = project.facts["interface"], project.facts["sizes"]
    listed = [Variable(name=f"state.{s}", causality="input", channel=s, start=0.0) for s in names["states"]]
    for what, columns, rows in (
        ("reference", names["references"], n["NODES"]),
        ("exogenous", names["exogenous"], n["EXOGENOUS_ROWS"]),
        ("corridor", ("right", "left") if n["CORRIDOR"] else (), n["NODES"]),
    ):
        listed += [
            Variable(name=f"{what}.{c}[{i}]", causality="input", channel=c, start=0.0)
            for i in range(rows)
            for c in columns
        ]
    listed += [Variable(name=c, causality="output", channel=c) for c in names["controls"]]
    return _unique([*listed, *(Variable(name=c, causality="output", channel="") for c in STATUS_NUMBERS)])


def _unique(variables: Sequence[Variable]) -> list[Variable]:
    """The same with a number after names that occur before."""
    seen: dict[str, int] = {}
    made = []
    for v in variables:
        count = seen[v.name] = seen.get(v.name, 0) + 1
        made.append(v if count == 1 else Variable(**{**vars(v), "name": f"{v.name} {count}"}))
    return made


def _source(project: Project, variables: Sequence[Variable], is_controller: bool) -> tuple[str, str]:
    """The whole C source, and modelDescription.xml."""
    given = project.everything
    code = given[f"{project.name}.c"].replace(f'#include "{project.name}.h"\n', given[f"{project.name}.h"])
    outputs = next(i for i, v in enumerate(variables) if v.causality == "output")
    guid = f"{{{uuid.uuid5(uuid.NAMESPACE_OID, code + str(variables))}}}"
    starts = [0.0 if v.start is None else v.start for v in variables]
    numbers = {"REALS": len(variables), "OUTPUTS": outputs, "DT": f"{project.facts['dt']!r}", "GUID": f'"{guid}"'}
    parts = [
        code,
        "#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n#include <string.h>",
        *(f"#define {k} {v}" for k, v in numbers.items()),
        table("STARTS", starts),
        with_prefix(_template("controller.c" if is_controller else "model.c"), project.name),
        _template("fmi2.c"),
    ]
    return "\n".join(parts), _description(project, variables, guid)


def _template(name: str) -> str:
    return (files("slipangle.export") / "fmu" / name).read_text(encoding="utf-8")


def _description(project: Project, variables: Sequence[Variable], guid: str) -> str:
    units = sorted({_unit(v) for v in variables} & set(BASE_UNITS))
    listed = [f"    <Unit name={quoteattr(u)}><BaseUnit {_powers(u)}/></Unit>" for u in units]
    rows = [_variable(v, i) for i, v in enumerate(variables)]
    outputs = [f'      <Unknown index="{i + 1}"/>' for i, v in enumerate(variables) if v.causality == "output"]
    can = " ".join(
        f'{what}="true"'
        for what in ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate")
    )
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(project.name)} guid="{guid}"',
        f'    description={quoteattr(project.sentence)} generationTool="slipangle" variableNamingConvention="flat">',
        f'  <CoSimulation modelIdentifier="{project.name}" {can}>',
        f'    <SourceFiles><File name="{project.name}.c"/></SourceFiles>',
        "  </CoSimulation>",
        *(["  <UnitDefinitions>", *listed, "  </UnitDefinitions>"] if listed else []),
        f'  <DefaultExperiment startTime="0" stepSize="{project.facts["dt"]!r}"/>',
        "  <ModelVariables>",
        *rows,
        "  </ModelVariables>",
        "  <ModelStructure>",
        "    <Outputs>",
        *outputs,
        "    </Outputs>",
        "    <InitialUnknowns>",
        *outputs,
        "    </InitialUnknowns>",
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join([*lines, ""])


def _unit(v: Variable) -> str:
    known = STANDARD.get(v.channel)
    return known.unit if known else "m" if v.channel in ("right", "left") else ""


def _powers(unit: str) -> str:
    return " ".join(f'{k}="{v}"' for k, v in BASE_UNITS[unit].items())


def _variable(v: Variable, i: int) -> str:
    unit, known = _unit(v), STANDARD.get(v.channel)
    said = f" unit={quoteattr(unit)}" if unit in BASE_UNITS else ""
    start = "" if v.start is None or not np.isfinite(v.start) else f' start="{v.start!r}"'
    initial = ' initial="exact"' if v.causality == "local" else ""
    meaning = f" description={quoteattr(known.doc)}" if known else ""
    name = quoteattr(re.sub(r"[^\x20-\x7e]", " ", v.name))
    return (
        f'    <ScalarVariable name={name} valueReference="{i}" causality="{v.causality}" variability="continuous"'
        f"{initial}{meaning}><Real{said}{start}/></ScalarVariable>"
    )
