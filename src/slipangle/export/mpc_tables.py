"""Numbers of an optimal control problem and of its solver's settings as constants in C; see ``c/begin_solver.c``."""

from __future__ import annotations

import numpy as np

from slipangle.errors import ParameterError
from slipangle.export.controllers import table
from slipangle.optimal.ocp import OCP
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.parts import slack_of_rows


def real_time(solver: object) -> RealTime:
    """Settings of the real-time solver; raises ParameterError if another one solves."""
    settings = RealTime() if solver == "realtime" else solver
    if not isinstance(settings, RealTime):
        raise ParameterError(
            f'the solver is {solver!r}, which has no C; expected the real-time one: say solver="realtime"'
        )
    return settings


def solver_tables(ocp: OCP, settings: RealTime, bounds: np.ndarray | None = None) -> str:
    """Weights and limits of a problem, and settings of its solver.

    ``bounds`` are those of all nodes where they are not the same, shape (horizon + 1, n_limited, 2).
    """
    of_errors, of_inputs, of_changes = ocp.stage_weights
    plain, square = slack_of_rows(ocp)
    arrays = {
        "OF_ERRORS": of_errors,
        "OF_INPUTS": of_inputs,
        "OF_CHANGES": of_changes,
        "PLAIN": plain,
        "SQUARE": square,
    }
    if bounds is None:
        arrays["BOUNDS"] = ocp.state_limits if len(ocp.limited) else np.zeros(2)
        arrays["END_BOUNDS"] = ocp.limits_at_nodes[-1] if len(ocp.limited) else np.zeros(2)
    else:
        arrays["BOUNDS"] = bounds if bounds.size else np.zeros(1)
    numbers = {"TOLERANCE": settings.tolerance, "NEWTON": settings.newton, "ACCEPT": settings.accept}
    whole = {"MAX_ITERATIONS": settings.max_iterations, "FIXED": settings.iterations}
    lines = [table(n, v) for n, v in arrays.items()] + (["#define BOUNDS_OF_NODES"] if bounds is not None else [])
    return "\n".join([*lines, *(f"#define {n} {_power(v)}" for n, v in (numbers | whole).items())])


def _power(v: float) -> str:
    """A tolerance as it is written by hand, ``1e-9``; see `precision`."""
    return repr(v).replace("e-0", "e-")
