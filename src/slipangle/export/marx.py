"""C of a `MultiARXMPC`: its quadratic program's own source, its models as constants, and the controller around it."""

from __future__ import annotations

import re

import numpy as np

from slipangle.control.fallback import RELAX
from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC
from slipangle.control.marx.blended import FASTEST
from slipangle.control.marx.mpc import FARTHEST, SLOWEST, MultiARXMPC
from slipangle.control.marx.solver import FLAGS, source
from slipangle.export.controllers import around, number, project, table
from slipangle.export.drives import Drive
from slipangle.export.project import Project, template


def marx_project(controller: MultiARXMPC | AdaptiveMultiARXMPC, name: str, drive: Drive) -> Project:
    """The files of predictive control on ARX models blended by speed; name and drive as for `project`."""
    if isinstance(controller, AdaptiveMultiARXMPC):
        mpc, own, said = controller.base, _of_learning(controller), ", which learn"
        learns, learner = template("marx_learns.c") + "\n", "    Learner learner;\n"
    else:
        mpc, own, said, learns, learner = controller, "", "", "", ""
    decision = template("marx.c").replace("@LEARNS@", learns).replace("@LEARNER@", learner)
    constants = _constants(mpc) + own
    text = "\n".join([source(mpc.problem, caller=True), constants, around(decision)])
    text = re.sub(r"\bmarx_(?=[a-z])", "car_program_", text)  # so that several projects go into one program
    facts = {"horizon": mpc.horizon, "models": len(mpc.numbers.speeds)}
    kind = f"predictive controller on ARX models blended by speed{said}"
    return project(controller, name, drive, text, kind=kind, facts=facts, flags=FLAGS)


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


def _of_learning(controller: AdaptiveMultiARXMPC) -> str:
    """What is known before the first sample, and what is learned from."""
    first, supervisor, names = controller._first, controller.supervisor, controller.base.blended.outputs
    arrays = {"THETA": first.theta, "UNSURE": np.diag(first.P), "RESPONSE": controller._start_response}
    scalars = {
        "NOISE": controller.noise,
        "FORGETTING": controller.forgetting,
        "EXCITATION": supervisor.excitation,
        "SURPRISE": supervisor.surprise,
        "LARGEST_GAIN": supervisor.gain,
        "LATERAL": supervisor.lateral,
        "LEAST_CHANGE": supervisor.least_change,
        "FASTEST": FASTEST,
    }
    lines = [*(table(n, v) for n, v in arrays.items()), *(f"#define {n} {number(v)}" for n, v in scalars.items())]
    lines += [f"#define REACH {supervisor.reach}"]
    lines += [f"#define YAW_RATE {names.index('r')}"] if "r" in names else []
    return "\n".join([*lines, ""])
