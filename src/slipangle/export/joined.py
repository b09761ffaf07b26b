"""C of the solver of a problem of several parts, such as scenarios: the one problem that it is, in its own file."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipangle.errors import ParameterError
from slipangle.export.controllers import Part, inner_solver, table
from slipangle.export.mpc_tables import solver_tables
from slipangle.export.project import template
from slipangle.optimal.joined import Joined, rated
from slipangle.optimal.ocp import OCP, Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.curvature import require_curvature
from slipangle.optimal.realtime.program import source


def has_parts(mpc: Any) -> bool:
    """Whether the solver of a controller is given another problem than the controller's."""
    return mpc.ocp.composed or getattr(mpc.solver, "hessian", "") == "exact"


def joined_solver(ocp: OCP, settings: RealTime) -> Part:
    """``car_joined.h`` and ``car_joined.c`` of a problem of several parts.

    Raises ParameterError if it has stages of several steps, or no exact Hessian where that is asked for.
    """
    if ocp.steps is not None:
        raise ParameterError(
            "a Huber cost over stages of several steps has no C; expected stages of one: leave out steps"
        )
    exact = settings.hessian == "exact"
    if exact:
        require_curvature(ocp)
    joined = Joined(ocp, curved=exact)
    bounds = joined.limits_at_nodes.copy()
    bounds[~joined.limited_at] = -np.inf, np.inf
    text = [source(joined, caller=True, qp=settings.qp), solver_tables(joined, settings, bounds), *_tables(joined)]
    return inner_solver("joined", "\n".join([*text, template("begin_solver.c"), template("joined.c")]))


def _tables(joined: Joined) -> list[str]:
    """How one part is spread over all: where each exogenous input comes from, and what is the same at every step."""
    base, once = joined.base, joined.base.decided_once
    nx, nu, states = base.model.n_states, len(base.controls), [f"@{n}" for n in base.model.states]
    varied = () if base.scenarios is None else base.scenarios.values
    known = [base.exogenous.index(n) if n in base.exogenous and n not in varied else -1 for n in joined.exogenous]
    nothing = Reference(
        tracked=np.zeros((base.horizon + 1, len(base.references))),
        exogenous=np.zeros((base.horizon + 1, len(base.exogenous))),
        corridor=None if base.corridor is None else np.zeros((base.horizon + 1, 2)),
    )
    numbers = {
        "ONE_N": base.horizon,
        "ONE_NX": nx,
        "ONE_NU": nu,
        "ONE_NW": len(base.exogenous),
        "N_ONCE": len(once),
        "N_BEFORE": len(rated(base)),
        "LEAD": int(joined.starts[0]),
        "LIKELY": int(np.argmax(joined.share)),
    }
    whole = {
        "KNOWN": known,
        "BACK": [states.index(n) if n in states else -1 for n in joined.exogenous],
        "BEFORE": [base.controls.index(n) for n in rated(base)],
        "ONCE_FROM": [base.exogenous.index(n) if n in base.exogenous else -1 for n in once],
    }
    real = {
        "FIXED_W": joined.spread(np.zeros(nx), np.zeros(nu), nothing).exogenous,
        "REST": joined.resting(np.zeros(nu)),
        "ONCE": joined.guess(nothing),
    }
    lines = [f"#define {n} {v}" for n, v in numbers.items()]
    return [*lines, *(table(n, v, "int") for n, v in whole.items()), *(table(n, v) for n, v in real.items())]
