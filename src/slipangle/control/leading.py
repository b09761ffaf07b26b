"""`Led`: a controller that wraps another one and takes over its step, horizon, input and reference."""

from __future__ import annotations

import abc
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

    @property
    def dt(self) -> float:
        """Step. [s]"""
        return self.leader.dt

    @property
    def horizon(self) -> int:
        """Steps ahead."""
        return self.leader.horizon

    @property
    def times(self) -> np.ndarray:
        """Instants of the plan's states, shape (horizon + 1,). [s]"""
        return self.leader.times

    @property
    def controls(self) -> tuple[str, ...]:
        """The decided input."""
        return self.leader.controls

    @property
    def exogenous(self) -> tuple[str, ...]:
        """The speed."""
        return self.leader.exogenous

    @property
    def references(self) -> tuple[str, ...]:
        """Columns of the reference."""
        return self.leader.references

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path."""
        return self.leader.reference(preview, **exogenous)

    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of the problem."""
        return self.leader.check_reference(reference)
