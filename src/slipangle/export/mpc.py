"""C of an `MPC`: the solver's own source, its weights and settings as constants, and the controller around it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

from slipangle.control.mpc import MPC
from slipangle.export.controllers import around, number, project, table
from slipangle.export.drives import Drive
from slipangle.export.joined import has_parts, joined_solver
from slipangle.export.mpc_tables import real_time, solver_tables
from slipangle.export.project import Project, template
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.backend import FLAGS
from slipangle.optimal.realtime.program import source


def mpc_project(mpc: MPC, name: str, drive: Drive) -> Project:
    """The files of an MPC that the real-time solver solves; name and drive as for `project`.

    Raises ParameterError if another solver solves it.
    """
    settings = real_time(mpc.solver)
    joined = joined_solver(mpc.ocp, settings) if has_parts(mpc) else None
    solve = template("mpc_joined.c" if joined else "mpc_solve.c")
    decision = [template("begin_solver.c"), template("mpc.c").replace("@SOLVE@", solve)]
    text = "\n".join([source(mpc.ocp, caller=True, qp=settings.qp), _constants(mpc, settings), around(*decision)])
    text = re.sub(r"\brt_(?=[a-z])", "car_rt_", text)  # so that several projects go into one program
    facts = {"solver": "realtime", "horizon": mpc.horizon, "deadline": mpc.deadline}
    kind = "model predictive controller"
    return project(mpc, name, drive, text, kind=kind, facts=facts, flags=FLAGS, parts=(joined,) if joined else ())


def as_in_c(controller: Any) -> Any:
    """A controller as its C plans: that of an MPC goes to convergence without the last steps of `RealTime`."""
    settings = getattr(controller, "solver", None)
    if not isinstance(controller, MPC) or not isinstance(settings, RealTime):
        return controller
    if settings.iterations > 0 or settings.hessian != "auto":
        return controller
    return replace(controller, solver=replace(settings, hessian="gauss-newton"))


def said_alone(made: Project, *planners: object) -> Project:
    """The project of these planners, whose README says where its C goes less far than Python."""
    most = {p.solver.max_iterations for p in planners if isinstance(p, MPC) and as_in_c(p) is not p}
    return replace(made, about=f"{made.about}\n\n{_ALONE.format(most=max(most))}") if most else made


_ALONE = (
    "Plans go to convergence by at most {most} Gauss-Newton steps; one that these do not end, where Python goes on by "
    'the exact Hessian, is told by its status. Exported with `hessian="exact"`, plans are by that from the start.'
)


def _constants(mpc: MPC, settings: RealTime) -> str:
    """What the controller is made with, around what its solver is."""
    low, high = mpc._judge.ranges
    arrays = {"LOWEST": low, "HIGHEST": high, "SAFE": mpc._safe_input, "RELAXING": mpc._relaxing}
    lines = [table(n, v) for n, v in arrays.items()]
    if mpc.ocp.duration is not None:
        at, span = mpc.ocp.decided_once.index("duration"), mpc.ocp.horizon * mpc.ocp.dt
        lines += [f"#define DURATION {at}", f"#define SPAN {number(span)}"]
    return "\n".join([*lines, solver_tables(mpc.ocp, settings), f"#define FALLBACK {mpc.fallback}", ""])
