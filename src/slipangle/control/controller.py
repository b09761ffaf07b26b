"""`Controller` is what each one is; `SteeringController` steers at a given speed, `Led` is around another one."""

from __future__ import annotations

import abc
from functools import cached_property
from importlib import import_module
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from slipangle.models.model import without_caches
from slipangle.optimal.arrays import array
from slipangle.optimal.checks import Judge
from slipangle.optimal.ocp import Reference, require_reference
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import require_names
from slipangle.paths.preview import Preview
from slipangle.shown import Brief

Ahead = Reference | Preview  # what is wanted over the horizon, or a look along a path


class Controller(Brief, abc.ABC):
    """Plans from a state and a path ahead, at every step; `slipangle.simulate.loop.closed_loop` drives with it.

    Attributes
    ----------
    model : Model
        Whose state `plan` is given, and whose outputs must be measured.
    dt : float
        Time between plans. [s]
    horizon : int
        Stages ahead.
    times : array, shape (horizon + 1,)
        Instants at which it wants to see the path, rising from 0. [s]
    controls, exogenous, references : tuple of str
        Inputs of the model that it decides, those that it does not, and columns of the reference.
    steady : bool
        Whether it finds the heading of steady driving on the path by itself, pushed as its model says.
    """

    steady = False

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs, in this process or another: the settings, nothing compiled."""
        return without_caches(self)

    model: Any
    dt: Any
    horizon: Any
    times: Any
    controls: Any
    exogenous: Any
    references: Any

    @cached_property
    def _judge(self) -> Judge:
        ranges = getattr(self, "plausible", None)
        return Judge(self.model.states, self.references, self.exogenous, self.horizon, ranges)

    @cached_property
    def _shape_u(self) -> tuple[int, int]:
        return self.horizon, len(self.controls)

    @cached_property
    def _shape_x(self) -> tuple[int, int]:
        return self.horizon + 1, len(self.model.states)

    def export(self, folder: str | FilePath, **settings: Any) -> FilePath:
        """Write the controller as C that runs without Python; see `slipangle.export.export`, also for its settings.

        Raises ParameterError if there is no C of it, WriteError if the folder is not empty or cannot be written.
        """
        return import_module("slipangle.export").export(self, folder, **settings)  # a room above this one

    @abc.abstractmethod
    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path."""

    @abc.abstractmethod
    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of the problem."""

    @abc.abstractmethod
    def plan(
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
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


class SteeringController(Controller):
    """A controller that decides steering at equal steps, from columns of a preview and the speed, which is given.

    Attributes
    ----------
    columns : tuple of str
        Those of a preview that it reads, and of ``Reference.tracked``.
    """

    exogenous = ("v_x",)
    columns: Any

    @cached_property
    def times(self) -> np.ndarray:
        """Instants of the plan's states, shape (horizon + 1,). [s]"""
        return self.dt * np.arange(self.horizon + 1)

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path: its columns, and its speed unless ``v_x`` is given.

        Raises
        ------
        ParameterError
            If the preview is not at `times`, or another input than the speed is given.
        """
        preview.require_times(self.times)
        require_names(exogenous, self.exogenous, "reference()", "only the speed is given from outside")
        speed = np.asarray(exogenous.get("v_x", preview.v_x), dtype=float)
        speed = speed[: self.horizon] if speed.shape == (self.horizon + 1,) else speed  # the end's counts nowhere here
        return Reference(
            tracked=np.column_stack([getattr(preview, n) for n in self.columns]),
            exogenous=np.broadcast_to(speed, (self.horizon,))[:, None],
        )

    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of this problem; the same one where it has them.

        Raises
        ------
        ParameterError
            With the array, its shape and the one expected, or what it varies.
        """
        require_reference(reference)
        reference.require_plain("this controller")
        tracked = array(reference.tracked, (self.horizon + 1, len(self.columns)), self.columns, "reference.tracked")
        speed = reference.exogenous  # perhaps with a row for the end, which counts nowhere here
        speed = speed[: self.horizon] if np.ndim(speed) == 2 and len(speed) == self.horizon + 1 else speed
        exogenous = array(speed, (self.horizon, 1), self.exogenous, "reference.exogenous")
        if tracked is reference.tracked and exogenous is reference.exogenous:
            return reference
        return Reference(tracked=tracked, exogenous=exogenous)


def _of_leader(name: str) -> Any:
    return cached_property(lambda self: getattr(self.leader, name))


class Led(Controller):
    """What a controller takes over from the one it is built around."""

    @property
    @abc.abstractmethod
    def leader(self) -> Any:
        """The controller whose settings count."""

    dt, horizon, times, controls, exogenous, references = map(
        _of_leader, ("dt", "horizon", "times", "controls", "exogenous", "references")
    )

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """As the leader's."""
        return self.leader.reference(preview, **exogenous)

    def check_reference(self, reference: Reference) -> Reference:
        """As the leader's."""
        return self.leader.check_reference(reference)
