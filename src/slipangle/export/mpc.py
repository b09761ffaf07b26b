"""C of an `MPC`: the solver's own source, its weights and settings as constants, and the controller around it."""

from __future__ import annotations

import re

import numpy as np

from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.export.controllers import around, project, table
from slipangle.export.drives import Drive
from slipangle.export.project import Project
from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.backend import FLAGS
from slipangle.optimal.realtime.parts import slack_of_rows
from slipangle.optimal.realtime.program import source


def mpc_project(mpc: MPC, name: str, drive: Drive) -> Project:
    """The files of an MPC that the real-time solver solves; name and drive as for `project`.

    Raises ParameterError if another solver solves it.
    """
    settings = RealTime() if mpc.solver == "realtime" else mpc.solver
    if not isinstance(settings, RealTime):
        raise ParameterError(
            f'the solver is {mpc.solver!r}, which has no C; expected the real-time one: say solver="realtime"'
        )
    if mpc.ocp.composed:
        raise ParameterError(
            "the problem has scenarios or free parameters, whose branches C has no names for; expected one without: "
            "export the controller of one scenario, with free parameters as they were found"
        )
    text = "\n".join([source(mpc.ocp, caller=True, qp=settings.qp), _constants(mpc, settings), around("mpc.c")])
    text = re.sub(r"\brt_(?=[a-z])", "car_rt_", text)  # so that several projects go into one program
    facts = {"solver": "realtime", "horizon": mpc.horizon, "deadline": mpc.deadline}
    return project(mpc, name, drive, text, kind="model predictive controller", facts=facts, flags=FLAGS)


def _constants(mpc: MPC, settings: RealTime) -> str:
    """What the controller is made with, around what its solver is."""
    low, high = mpc._judge.ranges
    arrays = {"LOWEST": low, "HIGHEST": high, "SAFE": mpc._safe_input, "RELAXING": mpc._relaxing}
    lines = [table(n, v) for n, v in arrays.items()]
    return "\n".join([*lines, solver_tables(mpc.ocp, settings), f"#define FALLBACK {mpc.fallback}", ""])


def solver_tables(ocp: OCP, settings: RealTime) -> str:
    """Weights and limits of a problem, and settings of its solver."""
    of_errors, of_inputs, of_changes = ocp.stage_weights
    plain, square = slack_of_rows(ocp)
    arrays = {
        "OF_ERRORS": of_errors,
        "OF_INPUTS": of_inputs,
        "OF_CHANGES": of_changes,
        "PLAIN": plain,
        "SQUARE": square,
        "BOUNDS": ocp.state_limits if len(ocp.limited) else np.zeros(2),
        "END_BOUNDS": ocp.limits_at_nodes[-1] if len(ocp.limited) else np.zeros(2),
    }
    numbers = {"TOLERANCE": settings.tolerance, "NEWTON": settings.newton, "ACCEPT": settings.accept}
    whole = {"MAX_ITERATIONS": settings.max_iterations, "FIXED": settings.iterations}
    lines = [table(n, v) for n, v in arrays.items()]
    return "\n".join([*lines, *(f"#define {n} {_power(v)}" for n, v in (numbers | whole).items())])


def _power(v: float) -> str:
    """A tolerance as it is written by hand, ``1e-9``; see `precision`."""
    return repr(v).replace("e-0", "e-")
