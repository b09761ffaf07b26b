"""`require_effect`: what a problem is given and has no effect, or parameters whose values their model does not take."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError
from slipangle.ops import is_symbolic
from slipangle.optimal.end import TerminalCost
from slipangle.optimal.terms import Read, evaluated


def require_effect(ocp: Any) -> None:
    """Raise unless terms, equations, weights or limits read every parameter that is declared, free or in scenarios.

    And unless its values are within the range that the model declares, and every soft limit has a price.

    Parameters
    ----------
    ocp : OCP
        The problem, whose names and terms are known to make sense.

    Raises
    ------
    ParameterError
        With the first parameter that changes nothing, or goes beyond its range, or limit that costs nothing.
    """
    prices = {name: max(ocp.slack.get(name, 0.0), ocp.slack_linear.get(name, 0.0)) for name in ocp.soft}
    gifts = [name for name, price in prices.items() if price == 0]
    if gifts:
        raise ParameterError(
            f"the limit of '{gifts[0]}' is soft at no price, so that it limits nothing; expected a weight above 0 in "
            "slack or slack_linear: leave it out of both for a hard limit"
        )
    varied = () if ocp.scenarios is None else tuple(ocp.scenarios.values)
    own = tuple(n for n in (*ocp.free, *varied) if n not in (*ocp.parameters, *ocp.model.inputs))
    given = {**({} if ocp.scenarios is None else ocp.scenarios.values), **ocp.free}
    for name in own:
        require_range(ocp, name, given[name], "free" if name in ocp.free else "scenarios")
    end = ocp.terminal.names if isinstance(ocp.terminal, TerminalCost) else ocp.terminal or ()
    used = {*ocp.Q, *end, *ocp.limits, *ocp.terminal_limits}
    idle = [n for n in _unread(ocp, own) if n not in used]
    if not idle:
        return
    name = idle[0]
    if name in own:
        where = "free names" if name in ocp.free else "scenarios name"
        raise ParameterError(
            f"{where} '{name}', on which neither the model's equations nor a term depend; expected a parameter that "
            "changes something: leave it out"
        )
    raise ParameterError(
        f"parameters name '{name}', which no term reads; expected p.{name} in one of "
        f"{list(ocp.terms) or 'terms, of which there are none'}: leave it out, or read it"
    )


def require_range(ocp: Any, name: str, values: Any, where: str) -> None:
    """Raise ParameterError if a parameter of the model's equations is given values beyond the range they declare."""
    known = getattr(ocp.model, "params", None)
    if name in (*ocp.parameters, *ocp.model.inputs) or known is None or name not in known.metadata():
        return
    declared, given = known.si(name), np.asarray(values, dtype=float)
    low, high = float(given.min()), float(given.max())
    if low < declared.lower or high > declared.upper:
        raise ParameterError(
            f"{where} has {low:g} to {high:g} for '{name}'; expected values from {declared.lower:g} to "
            f"{declared.upper:g}, the range that the model declares: keep within it, or declare a wider one"
        )


def _unread(ocp: Any, own: tuple[str, ...]) -> list[str]:
    """Parameters of the problem, and ``own`` of the model, without an effect on equations, outputs and terms."""
    kind, model = ocp._kind, ocp.model
    symbols = {name: kind.sym(name) for name in (*ocp.parameters, *own)}
    if not symbols:
        return []
    x, u = kind.sym("x", model.n_states), kind.sym("u", model.n_inputs)
    found = []
    if own:
        model = model.with_values(**{name: symbols[name] for name in own})
        found = [model.derivative(x, u), model.output(x, u)]
    known = symbols if ocp.duration is None else {**symbols, "duration": kind.sym("duration")}
    read = Read(getattr(model, "params", None), known)
    found += [evaluated(name, term, x, u, read) for name, term in ocp.terms.items()]
    together = ca.vertcat(*(ca.vec(value) for value in found if is_symbolic(value)))
    return [name for name, symbol in symbols.items() if not (found and ca.depends_on(together, symbol))]
