"""`setpoint`: what is wanted over the horizon where there is no path, by name; `vary`: limits and weights over it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.errors import ParameterError
from slipangle.optimal.arrays import array, short
from slipangle.optimal.end import TerminalCost
from slipangle.optimal.idle import require_range
from slipangle.optimal.ocp import NOTHING, OCP, POSE, Reference, at_nodes
from slipangle.optimal.terms import Limits, require_names

VARIED = ("limits", "Q", "R", "S", "scenarios")


def setpoint(ocp: OCP, wanted: Mapping[str, Any]) -> Reference:
    """`Reference` that holds values, or follows given ones, over the horizon of a problem.

    Parameters
    ----------
    ocp : OCP
        The problem.
    wanted : mapping of str to float or array, shape (horizon + 1,)
        Wanted values by name: of tracked quantities, of exogenous inputs, which must all be there, and of decided
        inputs, from which R counts; inputs may be without the end. Tracked quantities that are not named are wanted at
        zero, but a pose or a speed must be said. SI units. ``limits``, ``Q``, ``R``, ``S`` and
        ``scenarios`` are those of `vary`.

    Raises
    ------
    ParameterError
        If a name is not known or missing, or values are no numbers of that shape.
    """
    n = ocp.horizon
    own = {name: wanted[name] for name in VARIED if isinstance(wanted.get(name), Mapping)}
    wanted = {name: value for name, value in wanted.items() if name not in own}
    require_names(
        wanted, (*ocp.references, *ocp.exogenous, *ocp.controls), "the setpoint", "use a tracked quantity or an input"
    )
    wanted = {**{name: value for name, value in ocp.presumed.items() if name in ocp.exogenous}, **wanted}
    said = [name for name in ocp.exogenous if name not in wanted]
    if said:
        raise ParameterError(
            f"the setpoint lacks the exogenous input '{said[0]}'; expected its value: say {said[0]}=..., or decide it "
            "by naming it in controls"
        )
    lost = [name for name in (*POSE, "v_x") if name in ocp.references and name not in wanted]
    if lost:
        raise ParameterError(
            f"the setpoint lacks '{lost[0]}', which is tracked; expected its value: say {lost[0]}=..., or use a path"
        )
    idle = [name for name in wanted if name in ocp.controls and name not in ocp.R]
    if idle:
        raise ParameterError(
            f"the setpoint names the input '{idle[0]}', which has no weight in R to bring it there; expected one: say "
            f"R=Weights({idle[0]}=...), or leave it out"
        )
    held = (*ocp.exogenous, *ocp.controls)
    columns = {name: _column(name, value, n, ends=name not in held) for name, value in wanted.items()}
    zero = np.zeros(n + 1)
    inputs = [columns.get(name, zero)[:n] for name in ocp.controls] if set(ocp.controls) & set(wanted) else None
    reference = Reference(
        tracked=np.array([columns.get(name, zero) for name in ocp.references]).reshape(-1, n + 1).T.copy(),
        exogenous=np.array([columns[name] for name in ocp.exogenous]).reshape(-1, n + 1).T.copy(),
        inputs=None if inputs is None else np.array(inputs).T.copy(),
        corridor=None if ocp.corridor is None else np.full((n + 1, 2), np.inf),
    )
    return vary(ocp, reference, **own) if own else reference


def vary(
    ocp: OCP,
    reference: Reference,
    *,
    limits: Mapping[str, Any] | None = None,
    Q: Mapping[str, Any] | None = None,
    R: Mapping[str, Any] | None = None,
    S: Mapping[str, Any] | None = None,
    scenarios: Mapping[str, Any] | None = None,
) -> Reference:
    """The same with limits and weights that change over the horizon; nothing is compiled again.

    Parameters
    ----------
    ocp : OCP
        The problem; names that are not given keep what they have there.
    reference : Reference
        What is wanted.
    limits : mapping of str to (float or array, float or array)
        Lower and upper limit of what the problem limits along the horizon, decided inputs apart, shape (horizon + 1,)
        each. A limit that comes with every plan is ``Limits(name=inf)`` in the problem. SI units.
    Q : mapping of str to float or array, shape (horizon + 1,)
        Weights of what the problem's Q and terminal name. The end has the last of ``horizon + 1``; else that of the
        problem's ``terminal`` if it has one.
    R, S : mapping of str to float or array, shape (horizon,)
        Weights of what the problem's R and S name.
    scenarios : mapping of str to sequence of (float or array, shape (horizon + 1,))
        A value for each scenario of what the problem's scenarios name. SI units.

    Raises
    ------
    ParameterError
        If a name has no limit or weight in the problem, or values make no sense.
    """
    n, changed = ocp.horizon, {}
    if limits is not None:
        along = [name for name, used in zip(ocp.limited, ocp.limited_along, strict=True) if used and name in ocp.limits]
        require_names(limits, along, "limits", "use a state, output or term of the problem's limits")
        rows = ocp.limits_at_nodes.copy()
        for name, both in limits.items():
            if isinstance(both, int | float):
                both = Limits({name: both})[name]
            if isinstance(both, np.ndarray) and np.ndim(both):
                both = [*both]
            if not (isinstance(both, tuple | list) and len(both) == 2):
                raise ParameterError(f"the limits of '{name}' are {short(both)}; expected a lower and an upper one")
            j, (low, high) = (
                ocp.limited.index(name),
                (_column(name, side, n, ends=True, what="the limit of") for side in both),
            )
            apart = ocp._named_at_end(name) != name
            end = (-np.inf, np.inf) if apart else ocp.terminal_limits.get(name, (-np.inf, np.inf))
            low[-1], high[-1] = max(low[-1], end[0]), min(high[-1], end[1])
            rows[:, j, 0], rows[:, j, 1] = low, high
        changed["limits"] = rows
    weighed = ocp.Q if isinstance(ocp.terminal, TerminalCost) else ocp.tracked
    tracked = [name for name in weighed if name != NOTHING]
    for what, given, names, known, height in (
        ("Q", Q, ocp.tracked, tracked, n + 1),
        ("R", R, ocp.controls, list(ocp.R), n),
        ("S", S, ocp.controls, list(ocp.S), n),
    ):
        if given is None:
            continue
        require_names(given, known, what, f"use a name of the problem's {what}")
        rows = _own_weights(ocp, what)
        for name, value in given.items():
            many = n if what == "Q" and ocp.terminal is not None and np.shape(value) != (n + 1,) else height
            if what != "Q" and np.ndim(value) == 1 and len(value) not in (n, n + 1):
                raise ParameterError(
                    f"{what} of '{name}' has {len(value)} entries; expected a number or {n}, one per stage"
                )
            rows[:many, names.index(name)] = _column(name, value, n, what=f"{what} of")[:many]
        changed[what] = rows
    if scenarios is not None:
        changed["scenarios"] = _of_scenarios(ocp, scenarios)
    return ocp.check_reference(replace(reference, **changed))


def _of_scenarios(ocp: OCP, given: Mapping[str, Any]) -> np.ndarray:
    """Values of every scenario at every node, shape (n_scenarios, horizon + 1, n_values).

    Raises
    ------
    ParameterError
        If there are none in the problem, a name is not among them, or there is not one of each.
    """
    own = ocp.scenarios
    if own is None:
        raise ParameterError("scenarios are given; expected a problem with some: OCP(..., scenarios=Scenarios(...))")
    require_names(given, own.values, "scenarios", "use a name of the problem's scenarios")
    many, rows = ocp.horizon + 1, np.empty((len(own), ocp.horizon + 1, len(own.values)))
    for j, (name, values) in enumerate(own.values.items()):
        each = given.get(name, values)
        if not hasattr(each, "__len__") or len(each) != len(own):
            raise ParameterError(f"scenarios of '{name}' are {short(each)}; expected one for each of {len(own)}")
        for i, value in enumerate(each):
            rows[i, :, j] = _column(name, value, many - 1, what="the scenario of")
        if name in given:
            require_range(ocp, name, rows[:, :, j], "scenarios")
    return rows


def _own_weights(ocp: OCP, what: str) -> np.ndarray:
    """Weights of the problem at every node or stage, of stages of one step."""
    q, end, r, s = ocp.weights
    return (
        np.vstack([np.tile(q, (ocp.horizon, 1)), end])
        if what == "Q"
        else np.tile(r if what == "R" else s, (ocp.horizon, 1))
    )


def _column(name: str, given: Any, horizon: int, ends: bool = False, what: str = "the setpoint of") -> np.ndarray:
    """One value for each node; unless it ``ends`` there, as a state does, the last may be left out."""
    if np.ndim(given) == 0 and isinstance(given, int | float | np.number | np.ndarray):
        return np.full(horizon + 1, float(given))
    if np.shape(given) == (horizon,) and not ends:
        given = at_nodes(np.asarray(given, dtype=float), horizon)
    if np.ndim(given) != 1:
        raise ParameterError(
            f"{what} '{name}' is {short(given)}; expected a number, or {horizon + 1} of them, one per node"
        )
    return array(given, (horizon + 1,), [name], f"{what} '{name}'")
