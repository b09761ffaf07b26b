"""`Commands`: what a driver wants, and how it is; `AnyDriver`: what gives them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from slipangle.errors import ParameterError
from slipangle.optimal.solution import NEW, Health, Plan, Status
from slipangle.paths.path import Path

LATEST = 1e10  # s, which Unix time is well below
TOGETHER = 1e-9  # s between calls that count as at the same time
HINDERED = ("", "the speed is not known", "the car stands or creeps", "the pose is not known")
STAY = "the wheels stay where they are"
UNSURE = (  # why a car that moves should stop, in the order of the reasons after those above
    "the position is not known any more, the car should stop",
    "the speed was not measured for a second, the car should stop",
    "speed and positions contradict each other, the car should stop",
    "yaw rate and headings contradict each other, the car should stop",
    "the path has ended, the car should stop",
    "the car faces away from the path, it should stop",
    "the car is far beside the path and gets ever farther, it should stop",
    "the car is far beside the path",  # the last one says no more than that
)


def require_time(t: float, before: float | None) -> float:
    """The time of a call. [s]

    Raises ParameterError unless it is finite, at most `LATEST` and not before that of the call ``before``, if any.
    """
    t = float(t)
    if not abs(t) <= LATEST or (before is not None and t < before - TOGETHER):
        after = "" if before is None else f" after {before:g} s"
        raise ParameterError(f"t is {t:g} s{after}; expected finite times, at most {LATEST:g} s, that do not go back")
    return t


@dataclass(frozen=True, kw_only=True, eq=False)
class Commands:
    """What a `Driver` wants, and how it is.

    Parameters
    ----------
    values : dict of str to float
        Inputs of the car by name, finite and within limits, SI units.
    wanted_v_x : float
        Speed that the car should have: the path's, or 0 to stop. [m/s]
    plan : Plan or None
        Of the controller; None before the first pose and at walking pace.
    message : str
        One sentence on where the commands come from.
    s, e_y : float
        Arc length of the path beside the car, and how far it is to the left of it, as estimated. [m]
    state, state_std : array, shape (n_states,)
        Estimated state of the driver's model, and its standard deviation.
    age : dict of str to float
        How long ago each output was measured and believed. [s]
    restarts : int
        How often the estimator had to start anew.
    """

    values: dict[str, float]
    wanted_v_x: float
    plan: Plan | None = None
    message: str
    s: float = 0.0
    e_y: float = 0.0
    state: np.ndarray
    state_std: np.ndarray
    age: dict[str, float] = field(default_factory=dict)
    restarts: int = 0

    def __getitem__(self, name: str) -> float:
        """One command."""
        return self.values[name]

    @property
    def status(self) -> Status:
        """How the controller's solve ended; NOT_FINITE before the first pose and at walking pace."""
        return Status.NOT_FINITE if self.plan is None else self.plan.status

    @property
    def fallback(self) -> bool:
        """Whether the commands are not those of a fresh plan."""
        return self.plan is None or self.plan.age > 0

    @property
    def health(self) -> Health:
        """Plans, fallbacks and overruns so far."""
        return NEW if self.plan is None else self.plan.health


class CompiledDriver(NamedTuple):
    """How C calls a driver that was compiled, as its header has it: addresses and sizes in bytes."""

    decide: int  # int step(void *memory, const void *measurements, void *commands); 0 unless it refuses the time
    last_plan: int  # const void *last_plan(const void *memory)
    memory: int
    channels: tuple[str, ...]  # what it is told, after the time, as doubles
    commands: (
        np.dtype
    )  # of its commands: value (in the order of `controls`), wanted_v_x, s, planned, plan_age and others
    plan_bytes: int
    plan: Callable[[bytes, float], Plan]  # from the bytes of a plan, and how long it took [s]
    begin: Callable[[int], np.ndarray]  # memories of so many, each at its start, shape (n, n_bytes)


class AnyDriver(Protocol):
    """What `slipangle.simulate.drive.drive` drives with: a `Driver`, one that was compiled, or one of your own."""

    @property
    def path(self) -> Path:
        """What it follows, with a speed profile."""
        ...

    @property
    def controls(self) -> tuple[str, ...]:
        """Names of its commands."""
        ...

    def reset(self) -> None:
        """Forget the drive so far."""
        ...

    def step(self, measurements: Mapping[str, float], t: float) -> Commands:
        """Take in what was measured at a time [s], SI units, and say what to do."""
        ...
