"""Solvers by their names, as every controller and estimator takes them."""

from __future__ import annotations

from typing import Any

from slipangle.errors import ParameterError
from slipangle.optimal.engine import Backend
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime

_NAMED: dict[str, Backend] = {"ipopt": Ipopt(), "realtime": RealTime()}


def require_solver(solver: Any) -> None:
    """Raise ParameterError unless it is a known name, or settings that build a solver."""
    if solver not in _NAMED if isinstance(solver, str) else isinstance(solver, type) or not hasattr(solver, "build"):
        raise ParameterError(f'the solver is {solver!r}; expected "realtime" or "ipopt", or settings such as Ipopt()')


def backend_of(solver: str | Backend) -> Backend:
    """The settings behind a name, or those that are given."""
    return _NAMED[solver] if isinstance(solver, str) else solver
