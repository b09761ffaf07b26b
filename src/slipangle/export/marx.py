"""C of a `MultiARXMPC`: its quadratic program's own source, its models as constants, and the controller around it."""

from __future__ import annotations

import re

import numpy as np

from slipangle.control.fallback import RELAX
from slipangle.control.marx.mpc import FARTHEST, SLOWEST, MultiARXMPC
from slipangle.control.marx.solver import FLAGS, source
from slipangle.export.controllers import around, number, project, table
from slipangle.export.drives import Drive
from slipangle.export.project import Project, template


def marx_project(mpc: MultiARXMPC, name: str, drive: Drive) -> Project:
    """The files of predictive control on ARX models blended by speed; name and drive as for `project`."""
    text = "\n".join([source(mpc.problem, caller=True), _constants(mpc), around(template("marx.c"))])
    text = re.sub(r"\bmarx_(?=[a-z])", "car_program_", text)  # so that several projects go into one program
    facts = {"horizon": mpc.horizon, "models": len(mpc.numbers.speeds)}
    kind = "predictive controller on ARX models blended by speed"
    return project(mpc, name, drive, text, kind=kind, facts=facts, flags=FLAGS)


def _constants(mpc: MultiARXMPC) -> str:
    problem, numbers = mpc.problem, mpc.numbers
    low, high = mpc._judge.ranges
    arrays = {
        "SPEEDS": numbers.speeds,
        "OF_OUTPUTS": numbers.A,
        "OF_INPUTS": numbers.B,
        "CONSTANTS": numbers.c,
        "OF_ERRORS": problem.q,
        "OF_END": problem.end,
        "BOUNDS": problem.bounds,
        "STEPS": problem.steps,
        "LOWEST": low,
        "HIGHEST": high,
        "RELAXING": np.exp(-mpc.dt / RELAX) ** np.arange(1, mpc.horizon + 1),
    }
    scalars = {"OF_INPUT": problem.r, "OF_CHANGE": problem.s, "SAFE": mpc.safe.get(mpc.controls[0], 0.0)}
    scalars |= {"INTEGRAL": mpc.integral, "FARTHEST": FARTHEST, "SLOWEST": SLOWEST}
    lines = [table(n, v) for n, v in arrays.items()]
    lines += [f"#define {n} {number(v)}" for n, v in scalars.items()]
    return "\n".join([*lines, f"#define FALLBACK {mpc.fallback}", ""])
