"""`Controller`: what every controller is asked; `Led`: one that takes over the problem of another object."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from slipangle.models.model import without_caches
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan
from slipangle.paths.preview import Preview

Ahead = Reference | Preview  # what is wanted over the horizon, or a look along a path


class Controller(abc.ABC):
    """Plans from a state and a path ahead, at every step; `slipangle.simulate.loop.closed_loop` drives with it.

    Attributes
    ----------
    model : Model
        Whose state `plan` is given, and whose outputs must be measured.
    dt : float
        Time between plans. [s]
    times : array, shape (horizon + 1,)
        Instants at which it wants to see the path, rising from 0. [s]
    controls, exogenous : tuple of str
        Inputs of the model that it decides, and those that it does not.
    """

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: the settings, nothing compiled."""
        return without_caches(self)

    model: Any
    dt: Any
    times: Any
    controls: Any
    exogenous: Any

    @abc.abstractmethod
    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path."""

    @abc.abstractmethod
    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of the problem."""

    @abc.abstractmethod
    def plan(
        self, x: np.ndarray, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> Plan:
        """Plan from the state now.

        Parameters
        ----------
        x : array, shape (n_states,)
            State of `model` now.
        reference : Reference or Preview
            What to do over the horizon; a look along a path is turned into one by `reference`.
        previous : Plan, optional
            The plan of the step before: warm start and fallback.
        applied : array, shape (n_controls,), optional
            Input applied over the step before; by default the previous plan's command, else zero.

        Returns
        -------
        Plan
            Never NaN, never outside limits and rates, whatever the values; `Plan.status` says how the solve ended.

        Raises
        ------
        ParameterError
            If an argument has the wrong type, or an array the wrong shape.
        """


def along(preview: Preview, times: np.ndarray, columns: Sequence[str], v_x: np.ndarray | float | None) -> Reference:
    """Columns of a preview, and the speed alone from outside: the preview's unless given.

    Raises
    ------
    ParameterError
        If the preview is not at these times.
    """
    preview.require_times(times)
    speed = np.asarray(preview.v_x[:-1] if v_x is None else v_x, dtype=float)
    return Reference(
        tracked=np.column_stack([getattr(preview, n) for n in columns]),
        exogenous=np.broadcast_to(speed, (len(times) - 1,))[:, None],
    )


class Led(Controller):
    """What a controller takes over from the one it is built around."""

    @property
    @abc.abstractmethod
    def leader(self) -> Any:
        """The controller whose settings count."""

    @cached_property
    def dt(self) -> float:
        """Step. [s]"""
        return self.leader.dt

    @cached_property
    def horizon(self) -> int:
        """Steps ahead."""
        return self.leader.horizon

    @cached_property
    def times(self) -> np.ndarray:
        """Instants of the plan's states, shape (horizon + 1,). [s]"""
        return self.leader.times

    @cached_property
    def controls(self) -> tuple[str, ...]:
        """Inputs that are decided."""
        return self.leader.controls

    @cached_property
    def exogenous(self) -> tuple[str, ...]:
        """Inputs that are not decided."""
        return self.leader.exogenous

    @cached_property
    def references(self) -> tuple[str, ...]:
        """Columns of the reference."""
        return self.leader.references

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """As the leader's."""
        return self.leader.reference(preview, **exogenous)

    def check_reference(self, reference: Reference) -> Reference:
        """As the leader's."""
        return self.leader.check_reference(reference)
