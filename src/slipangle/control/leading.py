"""`Led`: a controller that wraps another one and takes over its step, horizon, input and reference."""

from __future__ import annotations

import abc
from functools import cached_property
from typing import Any

import numpy as np

from slipangle.models.model import without_caches
from slipangle.optimal.ocp import Reference
from slipangle.paths.preview import Preview


class Led(abc.ABC):
    """What a controller takes over from the one it is built around."""

    def __getstate__(self) -> dict[str, Any]:
        """What a copy needs: the settings."""
        return without_caches(self)

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
        """`Reference` from a look along a path."""
        return self.leader.reference(preview, **exogenous)

    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of the problem."""
        return self.leader.check_reference(reference)
