"""`setpoint`: what is wanted over the horizon where there is no path, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slipangle.errors import ParameterError
from slipangle.optimal.arrays import array, short
from slipangle.optimal.ocp import OCP, POSE, Reference, at_nodes
from slipangle.optimal.terms import require_names


def setpoint(ocp: OCP, wanted: Mapping[str, Any]) -> Reference:
    """`Reference` that holds values, or follows given ones, over the horizon of a problem.

    Parameters
    ----------
    ocp : OCP
        The problem.
    wanted : mapping of str to float or array, shape (horizon + 1,)
        Wanted values by name: of tracked quantities, of exogenous inputs, which must all be there, and of decided
        inputs, from which R counts; inputs may be without the end. Tracked quantities that are not named are wanted at
        zero, but a pose or a speed must be said. SI units.

    Raises
    ------
    ParameterError
        If a name is not known or missing, or values are no numbers of that shape.
    """
    n = ocp.horizon
    require_names(
        wanted, (*ocp.references, *ocp.exogenous, *ocp.controls), "the setpoint", "use a tracked quantity or an input"
    )
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
    columns = {name: _column(name, value, n) for name, value in wanted.items()}
    zero = np.zeros(n + 1)
    inputs = [columns.get(name, zero)[:n] for name in ocp.controls] if set(ocp.controls) & set(wanted) else None
    return Reference(
        tracked=np.array([columns.get(name, zero) for name in ocp.references]).reshape(-1, n + 1).T.copy(),
        exogenous=np.array([columns[name] for name in ocp.exogenous]).reshape(-1, n + 1).T.copy(),
        inputs=None if inputs is None else np.array(inputs).T.copy(),
        corridor=None if ocp.corridor is None else np.full((n + 1, 2), np.inf),
    )


def _column(name: str, given: Any, horizon: int) -> np.ndarray:
    """One value for each node; those of inputs may lack the end."""
    if np.ndim(given) == 0 and isinstance(given, int | float | np.number | np.ndarray):
        return np.full(horizon + 1, float(given))
    if np.shape(given) == (horizon,):
        given = at_nodes(np.asarray(given, dtype=float), horizon)
    if np.ndim(given) != 1:
        raise ParameterError(
            f"the setpoint of '{name}' is {short(given)}; expected a number, or {horizon + 1} of them, one per node"
        )
    return array(given, (horizon + 1,), [name], f"the setpoint of '{name}'")
