"""C of the window of a moving horizon estimator: the solver of its problem, behind a header of its own."""

from __future__ import annotations

from slipangle.estimate.moving_horizon import MHE
from slipangle.export.controllers import Part, inner_solver, table
from slipangle.export.mpc_tables import real_time, solver_tables
from slipangle.export.project import template
from slipangle.optimal.realtime.program import source


def window_solver(estimator: MHE) -> Part:
    """``car_window.h`` and ``car_window.c``.

    Raises ParameterError if another solver than the real-time one solves the estimator's problem.
    """
    settings, ocp = real_time(estimator.solver), estimator.window.ocp
    text = [source(ocp, caller=True, qp=settings.qp), solver_tables(ocp, settings)]
    return inner_solver("window", "\n".join([*text, template("begin_solver.c"), template("window.c")]))


def window_tables(estimator: MHE) -> list[str]:
    """Sizes and numbers by which samples become that problem."""
    window = estimator.window
    numbers = {"HORIZON": window.horizon, "ARRIVAL": window.arrival, "WIDTH": window.width}
    numbers["N_SHAKEN"] = len(window.shaken)
    lines = [f"#define {n} {v}" for n, v in numbers.items()]
    return [*lines, table("SHAKEN", window.shaken, "int"), table("WANDER", window.wander), table("NOISE", window.noise)]
