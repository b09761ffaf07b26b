"""`Sensing`: what a racer knows from its sensors, none of which is believed a glitch."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from slipangle.control.racing.on_road import OnRoad, RacingCar, steps_in
from slipangle.control.watch import UNCERTAIN, Blind
from slipangle.errors import SimulationError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.recursive import RecursiveVehicle
from slipangle.optimal.checks import Plausible
from slipangle.optimal.lap.car import LapCar

NOISE = {"X": 0.05, "Y": 0.05, "psi": 0.005, "v_x": 0.05, "r": 0.005, "a_x": 0.2, "a_y": 0.2}
WANDER = {"X": 0.01, "Y": 0.01, "psi": 0.001, "v_x": 0.1, "v_y": 0.2, "r": 0.1, "d_v_x": 2.0, "d_r": 1.0}
START = {"X": 0.1, "Y": 0.1, "psi": 0.01, "v_x": 0.1, "v_y": 0.1, "r": 0.02, "d_v_x": 0.5, "d_r": 0.2}
GRIP_WANDER = 0.002  # relative, per root of a second
# Of the size of the car, that what is above goes with; what wanders in a root of a second by a quarter less.
POWER = {"X": 1.0, "Y": 1.0, "v_x": 0.5, "v_y": 0.5, "r": -0.5, "d_r": -1.0}
POSE = ("X", "Y", "psi", "v_x")  # without which there is no start
WANTED = (*POSE, "r")  # of channels that the state begins with
RANGES = Plausible(tuple(NOISE)).by_name
WHOLE = Plausible(RacingCar.states)


def usual_noise(size: float) -> dict[str, float]:
    """Standard deviations of sensors by channel, SI units, for a car of a ``size`` as of `LapCar`. [-]"""
    return {name: value * size ** POWER.get(name, 0.0) for name, value in NOISE.items()}


class Sensing:
    """State and grip from noisy sensors, one sample at a time, by an `EKF` of `RacingCar`.

    A value that no car reads (`Plausible`) is as good as missing. One that is far from what the filter expects is an
    outlier, which the filter goes on without. There is an estimate once a second pose agrees with the first; until then
    every new one may be the first. An estimate that is no car's any more is dropped.

    Parameters
    ----------
    car : LapCar
        As believed.
    grip_std : float
        Standard deviation of the friction over the believed one, at the start. [-]
    noise : mapping of str to float
        Of the sensors, SI units; where not given that of `usual_noise`.
    gate : float or None
        Standard deviations, as of `EKF`.
    patience : int
        As of `EKF`.
    sample : float
        Between samples. [s]
    """

    def __init__(
        self,
        car: LapCar,
        *,
        grip_std: float,
        noise: Mapping[str, float],
        gate: float | None,
        patience: int,
        sample: float,
    ) -> None:
        size, steps = float(car.size), max(steps_in(car, sample), math.ceil(sample / RacingCar.max_step - 1e-9))
        self.sample, self._uncertain = sample, UNCERTAIN * size
        wander = {name: value * size ** (POWER.get(name, 0.0) - 0.25) for name, value in WANDER.items()}
        self.filter = EKF(
            start=RacingCar(params=OnRoad.of(car), dt=sample, substeps=steps),
            free=("grip",),
            noise_std={**usual_noise(size), **noise},
            process_std=wander,
            state_std={name: value * size ** POWER.get(name, 0.0) for name, value in START.items()},
            prior_std={"grip": max(grip_std, 1e-4)},
            walk_std={"grip": GRIP_WANDER * size**-0.25},
            gate=gate,
            patience=patience,
        )
        self.reset()

    def reset(self) -> None:
        """Forget the drive so far."""
        self._tracker: RecursiveVehicle | None = None
        self._agreed, self.restarts = False, 0
        self._refused = dict.fromkeys(NOISE, 0)
        self._seen: dict[str, float] = {}
        self._blind = Blind()

    def take(self, measurements: Mapping[str, float], inputs: Mapping[str, float], t: float) -> bool:
        """Take in channels by name, and ``delta`` [rad] and ``F_x`` [N], at a time [s]; whether a state is known."""
        given = {name: value for name, value in measurements.items() if self._possible(name, value)}
        whole = all(name in given for name in POSE)
        if self._tracker is not None and not self._follows(self._tracker, {**given, **inputs}):
            self._drop(self._tracker)
        if self._tracker is not None:
            self._agreed = self._agreed or whole
        elif whole:
            self._tracker = self.filter.begin({**given, **inputs})
            if not self._follows(self._tracker, {**given, **inputs}):
                self._drop(self._tracker)
        if self._tracker is not None:
            self._seen |= {name: t for name, good in zip(NOISE, self._tracker.taken, strict=True) if good}
            if self._seen.get("X") == self._seen.get("Y") == t:
                self._blind.see(t)
            else:
                self._blind.move(float(self._tracker.state[3]) * self.sample, t)
        return self._agreed

    def _possible(self, name: str, value: float) -> bool:
        """Whether a sensor that works can read that of a car; a value that it cannot counts as refused."""
        if name not in RANGES or math.isnan(value):
            return False
        low, high = RANGES[name]
        possible = low <= value <= high
        self._refused[name] += not possible
        return possible

    def _follows(self, tracker: RecursiveVehicle, given: Mapping[str, float]) -> bool:
        """Whether the state stays a car's and, before a second pose, agrees with what is measured of it."""
        try:
            tracker.take(given)
        except SimulationError:
            return False
        if self._agreed:
            return WHOLE.holds(tracker.state)
        error, _ = tracker.innovation
        off = np.isfinite(error) & ~tracker.taken
        return WHOLE.holds(tracker.state) and not any(off[i] for i, name in enumerate(NOISE) if name in WANTED)

    def _drop(self, tracker: RecursiveVehicle) -> None:
        self._refused = self._with(tracker)
        self._tracker, self._agreed = None, False
        self.restarts += 1

    def _with(self, tracker: RecursiveVehicle) -> dict[str, int]:
        """What was refused, by the filter too."""
        return {name: n + m for (name, n), m in zip(self._refused.items(), tracker.n_outliers.tolist(), strict=True)}

    # ---- what is known now -------------------------------------------------------------------------------------

    @property
    def known(self) -> RecursiveVehicle:
        """The filter at work; there is one where `take` said so."""
        if self._tracker is None:
            raise SimulationError("there is no estimate yet; expected one: ask for it where take returned True")
        return self._tracker

    @property
    def lost(self) -> bool:
        """Whether the position is not known any more."""
        return not max(self.known.state_std[:2]) + self._blind.off <= self._uncertain

    @property
    def grip(self) -> tuple[float, float]:
        """Friction over the believed one, and its standard deviation. [-]"""
        return float(self.known.parameters[0]), float(self.known.parameters_std[0])

    @property
    def outliers(self) -> dict[str, int]:
        """How many values of each channel were not believed so far."""
        return dict(self._refused) if self._tracker is None else self._with(self._tracker)

    def age(self, t: float) -> dict[str, float]:
        """How long before a time [s] each channel was measured and believed. [s]"""
        return {name: t - at for name, at in self._seen.items()}
