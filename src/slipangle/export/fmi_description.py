"""modelDescription.xml of an FMU, as FMI 2.0 and 3.0 want it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from xml.sax.saxutils import quoteattr

import numpy as np

from slipangle.data.channels import Quantity
from slipangle.export.meanings import known
from slipangle.export.names import different
from slipangle.export.project import Project

BASE_UNITS = {
    "m": {"m": 1},
    "m2": {"m": 2},
    "1/m": {"m": -1},
    "s": {"s": 1},
    "rad": {"rad": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "kg": {"kg": 1},
    "kg m2": {"kg": 1, "m": 2},
    "kg/m": {"kg": 1, "m": -1},
    "kg/m3": {"kg": 1, "m": -3},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N/m": {"kg": 1, "s": -2},
    "N s/m": {"kg": 1, "s": -1},
    "N/rad": {"kg": 1, "m": 1, "s": -2, "rad": -1},
    "rad/N": {"kg": -1, "m": -1, "s": 2, "rad": 1},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "N m/rad": {"kg": 1, "m": 2, "s": -2, "rad": -1},
    "N m s": {"kg": 1, "m": 2, "s": -1},
    "N m s/rad": {"kg": 1, "m": 2, "s": -1, "rad": -1},
    "Pa": {"kg": 1, "m": -1, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
}
_CAN = {
    2: ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate"),
    3: ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUState", "canSerializeFMUState"),
}
_SLOPES = {2: "providesDirectionalDerivative", 3: "providesDirectionalDerivatives"}


@dataclass(frozen=True, kw_only=True)
class Variable:
    """A real number of an FMU; ``start`` is None for what is computed, ``low`` and ``high`` the ends of its range."""

    name: str
    causality: str
    unit: str = ""
    doc: str = ""
    start: float | None = None
    low: float = -np.inf
    high: float = np.inf


@dataclass(frozen=True, kw_only=True)
class Part:
    """What an FMU has of its own.

    That is C for the functions of FMI to call, variables in the order of their value references, sources and headers
    beside, by name, and whether there are directional derivatives.
    """

    code: str
    variables: Sequence[Variable]
    files: Mapping[str, str] = field(default_factory=dict)
    derivatives: bool = False


def channel(
    name: str, causality: str, of: str, start: float | None = None, own: Mapping[str, Quantity] = MappingProxyType({})
) -> Variable:
    """A variable with unit and meaning of a channel or a state, where these are known; ``own`` as for `known`."""
    said = known(of, own)
    return Variable(
        name=name, causality=causality, unit=said.unit if said else "", doc=said.doc if said else "", start=start
    )


def unique(variables: Sequence[Variable]) -> list[Variable]:
    """The same with names that may stand in a description, all different.

    What XML has no place for is a space, a name without any letter is what the variable is, such as ``input``, and one
    that occurs before, or that the time has, gets a number.
    """
    taken, made = {"time"}, []
    for v in variables:
        name = different(name if (name := _written(v.name)).strip() else v.causality, taken)
        taken.add(name)
        made.append(replace(v, name=name))
    return made


def _written(text: str) -> str:
    """Text for an attribute: all characters but those that XML does not know, line ends and tabs."""
    return re.sub("[^ -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", " ", text)


def description(project: Project, part: Part, sources: Sequence[str], guid: str, version: int) -> str:
    """The text of modelDescription.xml.

    Parameters
    ----------
    project : Project
        What it is of.
    part : Part
        Its variables; in FMI 3.0 the time comes after them.
    sources : sequence of str
        Names of the files to be compiled.
    guid : str
        As in the source.
    version : int
        2 or 3, of FMI.
    """
    variables, derivatives = part.variables, part.derivatives
    units = sorted({v.unit for v in variables} & set(BASE_UNITS))
    listed = [f"    <Unit name={quoteattr(u)}><BaseUnit {_powers(u)}/></Unit>" for u in units]
    rows = [_variable(v, i, version) for i, v in enumerate(variables)]
    if version == 3:
        rows.append(
            f'    <Float64 name="time" valueReference="{len(variables)}" causality="independent" '
            'variability="continuous"/>'
        )
    can = " ".join(f'{what}="true"' for what in (*_CAN[version], *([_SLOPES[version]] if derivatives else [])))
    simulation = f'<CoSimulation modelIdentifier="{project.name}" {can}'
    token, number = ("guid", "2.0") if version == 2 else ("instantiationToken", "3.0")
    files = f"    <SourceFiles>{''.join(f'<File name={quoteattr(n)}/>' for n in sources)}</SourceFiles>"
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="{number}" modelName={quoteattr(project.name)} {token}="{guid}"',
        f'    description={quoteattr(project.sentence)} generationTool="slipangle" variableNamingConvention="flat">',
        *([f"  {simulation}>", files, "  </CoSimulation>"] if version == 2 else [f"  {simulation}/>"]),
        *(["  <UnitDefinitions>", *listed, "  </UnitDefinitions>"] if listed else []),
        f'  <DefaultExperiment startTime="0" stepSize="{project.facts["dt"]!r}"/>',
        "  <ModelVariables>",
        *rows,
        "  </ModelVariables>",
        "  <ModelStructure>",
        *_structure([i for i, v in enumerate(variables) if v.causality == "output"], version),
        "  </ModelStructure>",
        "</fmiModelDescription>",
    ]
    return "\n".join([*lines, ""])


def build_description(name: str, sources: Sequence[str]) -> str:
    """The text of sources/buildDescription.xml of FMI 3.0."""
    listed = "".join(f'<SourceFile name="{n}"/>' for n in sources)
    files = f'<SourceFileSet language="C99">{listed}</SourceFileSet>'
    made = f'<BuildConfiguration modelIdentifier="{name}">{files}</BuildConfiguration>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">{made}</fmiBuildDescription>\n'
    )


def _structure(outputs: Sequence[int], version: int) -> list[str]:
    if version == 3:
        kinds = ("Output", "InitialUnknown")
        return [f'    <{kind} valueReference="{i}"/>' for kind in kinds for i in outputs]
    unknown = [f'      <Unknown index="{i + 1}"/>' for i in outputs]
    parts = ("Outputs", "InitialUnknowns")
    return [line for part in parts for line in (f"    <{part}>", *unknown, f"    </{part}>")]


def _powers(unit: str) -> str:
    return " ".join(f'{k}="{v}"' for k, v in BASE_UNITS[unit].items())


def _variable(v: Variable, i: int, version: int) -> str:
    given = {
        "name": quoteattr(v.name),
        "valueReference": f'"{i}"',
        "causality": f'"{v.causality}"',
        "variability": '"tunable"' if v.causality == "parameter" else '"continuous"',
    }
    if v.causality in ("local", "parameter"):
        given["initial"] = '"exact"'
    if v.doc:
        given["description"] = quoteattr(_written(v.doc))
    real = {"unit": quoteattr(v.unit)} if v.unit in BASE_UNITS else {}
    for key, number in (("min", v.low), ("max", v.high), ("start", v.start)):
        if number is not None and np.isfinite(number):
            real[key] = f'"{float(number)!r}"'
    if version == 3:
        return f"    <Float64 {_attributes(given | real)}/>"
    return f"    <ScalarVariable {_attributes(given)}><Real {_attributes(real)}/></ScalarVariable>"


def _attributes(given: dict[str, str]) -> str:
    return " ".join(f"{key}={value}" for key, value in given.items())
