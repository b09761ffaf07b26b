"""C of the window of a moving horizon estimator: the solver of its problem, behind a header of its own."""

from __future__ import annotations

import re

from slipangle.errors import ParameterError
from slipangle.estimate.moving_horizon import MHE
from slipangle.export.controllers import LANES, lanes, table
from slipangle.export.memory import size_of
from slipangle.export.mpc import solver_tables
from slipangle.export.project import template
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.program import source


def window_files(estimator: MHE) -> tuple[dict[str, str], dict[int, int]]:
    """``car_window.h`` and ``car_window.c``, and the bytes of its memory by the numbers per vector.

    Raises ParameterError if another solver than the real-time one solves the estimator's problem.
    """
    settings = RealTime() if estimator.solver == "realtime" else estimator.solver
    if not isinstance(settings, RealTime):
        raise ParameterError(
            f'the solver is {estimator.solver!r}, which has no C; expected the real-time one: say solver="realtime"'
        )
    ocp = estimator.window.ocp
    text = "\n".join([source(ocp, caller=True, qp=settings.qp), solver_tables(ocp, settings), template("window.c")])
    text = re.sub(r"\brt_(?=[a-z])", "car_window_rt_", text)
    sizes = {n: size_of(text, "Work", n) for n in LANES}
    head = f'#include "car_window.h"\n#define LANES CAR_WINDOW_LANES\n#define CALLERS_CLOCK\n{text}'
    return {
        "car_window.h": template("window.h").replace("@LANES@\n", lanes("CAR_WINDOW", sizes)),
        "car_window.c": head,
    }, sizes


def window_tables(estimator: MHE) -> list[str]:
    """Sizes and numbers by which samples become that problem."""
    window = estimator.window
    numbers = {"HORIZON": window.horizon, "ARRIVAL": window.arrival, "WIDTH": window.width}
    numbers["N_SHAKEN"] = len(window.shaken)
    lines = [f"#define {n} {v}" for n, v in numbers.items()]
    return [*lines, table("SHAKEN", window.shaken, "int"), table("WANDER", window.wander), table("NOISE", window.noise)]
