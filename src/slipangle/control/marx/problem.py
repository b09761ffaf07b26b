"""What a solver of MARX-MPC is given and gives back."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from slipangle.optimal.solution import Status

Offset = np.ndarray | float  # of the models' outputs


@dataclass(frozen=True, kw_only=True, eq=False)
class MarxProgram:
    """Sizes, weights and limits; see `MultiARXMPC`. ``steps`` limits the change per step."""

    horizon: int
    knots: tuple[int, ...]
    dt: float
    na: int
    reach: int
    outputs: tuple[str, ...]
    n_models: int
    smooth: bool
    rated: bool
    q: np.ndarray
    end: np.ndarray
    r: float
    s: float
    bounds: np.ndarray
    steps: np.ndarray

    @cached_property
    def shares(self) -> np.ndarray:
        """Of each decided input in each step's, shape (horizon, knots): straight between knots, level after them."""
        steps = np.arange(self.horizon)
        return np.column_stack([np.interp(steps, self.knots, one) for one in np.eye(len(self.knots))])

    @cached_property
    def changes(self) -> np.ndarray:
        """Of the shares from step to step, those of the first step from zero, shape (horizon, knots)."""
        return np.diff(self.shares, axis=0, prepend=0.0)

    @property
    def posed(self) -> bool:
        """Whether the models' outputs are v_y and r."""
        return "r" in self.outputs

    @property
    def n_states(self) -> int:
        """Length of the state: lagged outputs, past inputs and, if posed, X, Y, psi."""
        return self.na * len(self.outputs) + self.reach - 1 + 3 * self.posed


@dataclass(frozen=True, kw_only=True, eq=False)
class Numbers:
    """Speeds and coefficients of the models, as in ``MultiARXModel.coefficients``."""

    speeds: np.ndarray
    A: np.ndarray
    B: np.ndarray
    c: np.ndarray


class Answer(NamedTuple):
    """What a solve found; ``x`` has shape (horizon + 1, n_states), ``u`` (horizon, 1)."""

    status: Status
    u: np.ndarray
    x: np.ndarray
    weights: np.ndarray
    cost: float
    iterations: int
    residual: float


class Solver(abc.ABC):
    """A solver for one `MarxProgram`."""

    @abc.abstractmethod
    def solve(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None, offset: Offset
    ) -> Answer:
        """Solve from a state; ``numbers`` replace the models' coefficients, ``offset`` is added to every output."""

    def expect(self, lowest: np.ndarray, highest: np.ndarray) -> None:  # noqa: B027  # that need not be known
        """Ranges of the state's entries, of X, Y, psi and of the speed, beyond which a value is doubtful."""

    def again(
        self, x: np.ndarray, path: np.ndarray, v_x: np.ndarray, applied: float, numbers: Numbers | None
    ) -> dict[str, Any] | None:
        """What a plan says of the usual call's answer, which is judged here; None if anything is unusual."""
        return None
