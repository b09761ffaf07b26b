"""C of a `SwitchedMPC`: its two controllers in files of their own, and the criterion between them."""

from __future__ import annotations

from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.switched import SwitchedMPC
from slipangle.errors import ParameterError
from slipangle.export.controllers import Part, around, base_of, limits_of, number, project
from slipangle.export.drives import NO_DRIVE, Drive
from slipangle.export.joined import has_parts
from slipangle.export.marx import marx_project
from slipangle.export.mpc import mpc_project
from slipangle.export.names import with_prefix
from slipangle.export.project import Project, template
from slipangle.models.vehicles.parameters import GRAVITY


def switched_project(controller: SwitchedMPC, name: str, drive: Drive) -> Project:
    """The files of two controllers and what says which one plans; name and drive as for `project`.

    Raises ParameterError if one of them has no C, or has one that the other cannot hand over to.
    """
    parts, flags = [], []
    for name_of, planner in (("calm", controller.calm), ("limit", controller.limit)):
        made = _planner(planner, f"car_{name_of}")
        flags += [flag for flag in made.flags if flag not in flags]
        parts.append(_part(name_of, planner, made))
    first = ("0", "CAR_CALM_STATES")
    asked = [
        template("switched_part.c").replace("PART", n.upper()).replace("part", n).replace("FIRST", at)
        for n, at in zip(("calm", "limit"), first, strict=True)
    ]
    states = controller.model.states
    low, high = limits_of(base_of(controller))[controller.controls[0]]
    numbers = {
        "GRIP": controller.friction * GRAVITY,
        "ENTER": controller.enter,
        "LEAVE": controller.leave,
        "PERIOD": controller.dt,
        "LOWEST": low,
        "HIGHEST": high,
    }
    lines = ["#include <math.h>", "#include <string.h>", *(f"#define {n} {number(v)}" for n, v in numbers.items())]
    lines += [f"#define DWELL {controller.dwell}"]
    lines += [f"#define YAW_RATE {states.index('r')}"] if "r" in states else []
    decision = "\n".join([*_declared(), template("switched.c").replace("@PARTS@", "\n".join(asked))])
    text = "\n".join([*lines, around(decision)])
    facts = {"horizon": controller.horizon}
    kind = "predictive controller that switches between two"
    return project(controller, name, drive, text, kind=kind, facts=facts, flags=tuple(flags), parts=parts)


def _planner(controller: MPC | MultiARXMPC, name: str) -> Project:
    """The project of one of the two."""
    if type(controller).plan not in (MPC.plan, MultiARXMPC.plan):
        raise ParameterError(f"a {type(controller).__name__} has no C as a part; expected an MPC or a MultiARXMPC")
    ocp = getattr(controller, "ocp", None)
    if ocp is not None and (has_parts(controller) or ocp.corridor is not None):
        raise ParameterError(
            "a part of the switched controller has scenarios, free parameters, Huber costs, an exact Hessian or a "
            "corridor, which it cannot be handed in C; expected one without: export that controller alone"
        )
    if isinstance(controller, MPC):
        return mpc_project(controller, name, NO_DRIVE)
    return marx_project(controller, name, NO_DRIVE)


def _declared() -> list[str]:
    """What one part leaves to the other, which no header has."""
    return [with_prefix(template("handed.h"), f"car_{part}") for part in ("calm", "limit")]


def _part(name: str, controller: MPC | MultiARXMPC, made: Project) -> Part:
    """A controller's header and source, with what takes over from the other one."""
    files = {f"car_{name}.{suffix}": made.everything[f"car_{name}.{suffix}"] for suffix in "hc"}
    added = template("mpc_takes_over.c" if isinstance(controller, MPC) else "marx_takes_over.c")
    files[f"car_{name}.c"] += "\n" + with_prefix(template("handed.h") + added, f"car_{name}")
    return Part(name, files, made.facts["bytes"], f"car_{name}_controller")
