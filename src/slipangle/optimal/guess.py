"""`Guess`: states, inputs and decided values of somebody's own, with which a plan begins in place of another plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slipangle.errors import ParameterError, shown
from slipangle.optimal.arrays import array, short
from slipangle.optimal.checks import is_number
from slipangle.optimal.ocp import OCP
from slipangle.optimal.terms import require_names
from slipangle.shown import Brief

ROUNDING = 1e-6  # by which a value may be beyond its limits, relative to 1 + its size, as those of a solver may


@dataclass(frozen=True, kw_only=True, eq=False)
class Guess(Brief):
    """What a plan begins with where its `previous` is no plan; `slipangle.control.mpc.MPC.guess` makes it.

    Parameters
    ----------
    x : array, shape (horizon + 1, n_states), optional
        States at `MPC.times`, a column of NaN for one that stays as it is when the plan begins. SI units.
    u : array, shape (horizon, n_controls), optional
        Decided inputs, a column of NaN for one that is held as it was applied before. SI units.
    decided : mapping of str to float
        Of what is decided once, a duration too, those that are said. SI units.
    states, controls : tuple of str
        Names of the columns.
    """

    x: np.ndarray | None
    u: np.ndarray | None
    decided: Mapping[str, float]
    states: tuple[str, ...]
    controls: tuple[str, ...]

    def inputs(self, applied: np.ndarray, horizon: int) -> np.ndarray:
        """Inputs from the one applied before on, shape (n_controls,): shape (horizon, n_controls)."""
        held = np.tile(applied, (horizon, 1))
        return held if self.u is None else np.where(np.isnan(self.u), held, self.u)

    def states_from(self, x: np.ndarray, *, keep: bool = False) -> np.ndarray | None:
        """States from the one now on, shape (n_states,): shape (horizon + 1, n_states); None where none are said.

        The first one is that now, or with ``keep`` as said.
        """
        if self.x is None:
            return None
        states = np.where(np.isnan(self.x), x, self.x)
        if not keep:
            states[0] = x
        return states

    def require(self, ocp: OCP, of: str = "this controller") -> None:
        """Raise unless this is of a problem with the same states, inputs and horizon; ``of`` names that.

        Raises
        ------
        ParameterError
            With what differs.
        """
        own = {"states": self.states, "controls": self.controls}
        for what, names in {"states": ocp.model.states, "controls": ocp.controls}.items():
            if own[what] != tuple(names):
                raise ParameterError(
                    f"the guess is of a problem with the {what} {list(own[what])}; expected {list(names)}: "
                    f"make it by the guess(...) of {of}"
                )
        stages = {*([] if self.u is None else [len(self.u)]), *([] if self.x is None else [len(self.x) - 1])}
        if stages - {ocp.horizon}:
            raise ParameterError(
                f"the guess is of another horizon; expected one of {ocp.horizon} stages: make it by the guess(...) of "
                f"{of}"
            )
        require_names(self.decided, ocp.decided_once, "the guess", f"make it by the guess(...) of {of}")


def guess(
    ocp: OCP,
    *,
    x: np.ndarray | Mapping[str, Any] | None = None,
    u: np.ndarray | Mapping[str, Any] | None = None,
    decided: Mapping[str, float] | None = None,
) -> Guess:
    """A `Guess` for a problem; see `slipangle.control.mpc.MPC.guess`.

    Parameters
    ----------
    ocp : OCP
        The problem.
    x, u, decided : optional
        As there. SI units.

    Raises
    ------
    ParameterError
        If nothing is given, a name is not known, or values are no numbers of the shape that is wanted.
    """
    if x is None and u is None and not decided:
        raise ParameterError("guess() is given nothing; expected states x, inputs u or decided values: name one")
    n, times = ocp.horizon, ocp.times / ocp.times[-1]
    states = None if x is None else _table(x, ocp.model.states, n + 1, "x of the guess", times)
    inputs = None if u is None else _table(u, ocp.controls, n, "u of the guess", None)
    once = {} if decided is None else _decided(ocp, decided)
    return Guess(x=states, u=inputs, decided=once, states=tuple(ocp.model.states), controls=ocp.controls)


def _table(given: Any, names: Sequence[str], rows: int, what: str, times: np.ndarray | None) -> np.ndarray:
    """One column for each name, NaN where nothing is said; ``times`` from 0 to 1 where two rows are a straight line.

    Raises
    ------
    ParameterError
        If a name is not known, or these are no finite numbers of that shape.
    """
    if not isinstance(given, Mapping):
        ends = times is not None and np.shape(given) == (2, len(names)) and rows != 2
        table = array(given, (2 if ends else rows, len(names)), names, what)
        table = _line(table, times) if ends else np.array(table)
        _require_finite(table, names, what)
        return table
    require_names(given, names, what, "use a state" if times is not None else "use a decided input")
    table = np.full((rows, len(names)), np.nan)
    for name, value in given.items():
        own, ends = f"{what} for '{name}'", times is not None and np.shape(value) == (2,) and rows != 2
        if np.ndim(value) == 0 and isinstance(value, int | float | np.number | np.ndarray):
            column = np.full(rows, float(value))
        else:
            column = array(value, (2 if ends else rows,), [name], own)
            column = _line(column[:, None], times)[:, 0] if ends else column
        _require_finite(column[:, None], [name], what)
        table[:, list(names).index(name)] = column
    return table


def _line(ends: np.ndarray, times: np.ndarray | None) -> np.ndarray:
    """Rows on the straight line between two, at times from 0 to 1."""
    share = np.zeros((0, 1)) if times is None else times[:, None]
    return (1 - share) * ends[0] + share * ends[1]


def _require_finite(table: np.ndarray, names: Sequence[str], what: str) -> None:
    """Raise unless all are finite numbers.

    Raises
    ------
    ParameterError
        With the first that is none.
    """
    wrong = np.argwhere(~np.isfinite(table))
    if len(wrong):
        i, j = wrong[0]
        raise ParameterError(
            f"{what} is {table[i, j]:g} for '{names[j]}' in row {i}; expected finite numbers: leave out what is not "
            "known, by name"
        )


def _decided(ocp: OCP, given: Any) -> dict[str, float]:
    """Values of what is decided once, within their limits.

    Raises
    ------
    ParameterError
        If nothing of that name is decided, or a value is no number within its limits.
    """
    if not isinstance(given, Mapping):
        raise ParameterError(f"decided of the guess is {short(given)}; expected values by name, as Plan.decided has")
    if given and not ocp.decided_once:
        raise ParameterError(
            f"decided of the guess names '{next(iter(given))}', but the problem decides nothing once; expected a "
            "problem with duration=(shortest, longest) or free=Limits(...), or a guess without"
        )
    require_names(
        given, ocp.decided_once, "decided of the guess", "use a free parameter, or the duration if it is free"
    )
    limits = {**ocp.free, **({} if ocp.duration is None else {"duration": ocp.duration})}
    found: dict[str, float] = {}
    for name, value in given.items():
        low, high = limits[name]
        number = value if is_number(value) else np.nan
        more = ROUNDING * (1.0 + abs(float(number)))
        if not low - more <= number <= high + more or not np.isfinite(number):
            raise ParameterError(
                f"decided of the guess is {shown(value)} for '{name}'; expected a number within its limits, "
                f"{low:g} to {high:g}"
            )
        found[name] = float(min(max(number, low), high))
    return found
