"""`TireData`: what a tire rig measured, in the signs of docs/nomenclature.md, and its sweeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.ndimage import gaussian_filter1d

from slipangle.errors import NotFiniteError, ParameterError, TooShortError, UnitError

_SIGNALS = ("slip_ratio", "slip_angle", "load", "camber", "pressure", "speed", "F_x", "F_y", "M_x", "M_z")
_SIGNALS += ("time", "temperature", "run")
_MIRRORED = ("slip_angle", "camber", "F_y", "M_x", "M_z")  # what a mirror turns round
_MOST_BINS = 80_000  # of a histogram of a signal, eight per tolerance
_LARGEST_FRICTION = 6.0  # beyond any tire: then units differ


class Tolerance(NamedTuple):
    """How far a condition may wander from its level within one sweep."""

    load: float = 90.0  # N
    camber: float = math.radians(0.7)
    pressure: float = 5e3  # Pa


@dataclass(frozen=True, kw_only=True, eq=False)
class TireData:
    """Samples from a tire rig: slip, operating conditions, forces. SI units.

    Raises ParameterError, NotFiniteError, UnitError or TooShortError if lengths differ, a number is not finite, a load
    is not positive, or units cannot be right.

    Parameters
    ----------
    slip_ratio, slip_angle : array, shape (n_samples,)
        ``(omega r - v_x) / max(|v_x|, |omega r|)``, positive drives [-]; positive gives F_y > 0, to the left [rad].
    load, F_x, F_y : array, shape (n_samples,)
        Vertical load, positive; force forward and to the left. [N]
    M_x, M_z : array, shape (n_samples,), optional
        Overturning moment about the axis forward, aligning moment about the axis upward. [N m]
    camber, pressure, speed : array, shape (n_samples,), optional
        Positive leans the top to the right, by default none [rad]; inflation pressure [Pa]; forward speed [m/s].
    time, temperature, run : array, shape (n_samples,), optional
        When it was measured, rising within a run [s]; temperature of the tread [degC]; number of the run, from 0, by
        default 0 for all.
    radius : float, optional
        Unloaded radius as measured. [m]
    name, notes
        What was measured, what was done to it and what was seen in it, such as the sign system.
    """

    slip_ratio: np.ndarray
    slip_angle: np.ndarray
    load: np.ndarray
    name: str = "tire data"
    notes: tuple[str, ...] = ()
    F_x: np.ndarray
    F_y: np.ndarray
    M_x: np.ndarray | None = None
    M_z: np.ndarray | None = None
    camber: np.ndarray | None = None
    pressure: np.ndarray | None = None
    speed: np.ndarray | None = None
    time: np.ndarray | None = None
    temperature: np.ndarray | None = None
    run: np.ndarray | None = None
    radius: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "notes", tuple(self.notes))
        n = len(np.atleast_1d(self.load))
        if n == 0:
            raise TooShortError(f"'{self.name}' holds no sample; expected at least one: check what was cut away")
        for key in _SIGNALS:
            value = getattr(self, key)
            if value is None and key in ("camber", "run"):
                value = np.zeros(n)
            if value is None:
                continue
            array = np.array(value, dtype=float).ravel()
            if len(array) != n:
                raise ParameterError(
                    f"'{self.name}' has {len(array)} samples of {key} and {n} of load; expected as many"
                )
            if not np.isfinite(array).all():
                first = int(np.argmin(np.isfinite(array)))
                raise NotFiniteError(
                    f"{key} of '{self.name}' holds NaN or infinity, first in sample {first}; expected finite numbers: "
                    "leave those samples out"
                )
            array.setflags(write=False)
            object.__setattr__(self, key, array)
        self._check_units()

    def _check_units(self) -> None:
        lowest = float(self.load.min())
        if lowest <= 0:
            raise ParameterError(
                f"the load of '{self.name}' goes down to {lowest:g} N; expected positive loads: turn the sign where z "
                "points down, and leave out samples without load"
            )
        for key in ("F_x", "F_y"):
            friction = float(np.max(np.abs(getattr(self, key)) / self.load))
            if friction > _LARGEST_FRICTION:
                raise UnitError(
                    f"{key} of '{self.name}' reaches {friction:.3g} times the load; expected at most "
                    f"{_LARGEST_FRICTION:g}: forces and load must both be in newtons"
                )
        angle = f"rad, at most {math.pi / 2:.3g}: convert degrees"
        for key, limit, expected in (
            ("slip_angle", math.pi / 2, angle),
            ("camber", math.pi / 2, angle),
            ("slip_ratio", 1.5, "a ratio, at most 1: convert percent"),
        ):
            reach = float(np.max(np.abs(getattr(self, key))))
            if reach > limit:
                raise UnitError(f"{key} of '{self.name}' reaches {reach:.3g}; expected {expected}")

    # ---- looking -----------------------------------------------------------------------------------------------

    @property
    def n_samples(self) -> int:
        """How many samples."""
        return len(self.load)

    def __len__(self) -> int:
        return self.n_samples

    @property
    def gamma(self) -> np.ndarray:
        """Camber, zero where it was not given, shape (n_samples,). [rad]"""
        return np.zeros(self.n_samples) if self.camber is None else self.camber

    @property
    def runs(self) -> tuple[np.ndarray, ...]:
        """Rows of each run, in order."""
        number = np.zeros(self.n_samples) if self.run is None else self.run
        return tuple(np.flatnonzero(number == k) for k in np.unique(number))

    @property
    def mu_x(self) -> np.ndarray:
        """F_x over load. [-]"""
        return self.F_x / self.load

    @property
    def mu_y(self) -> np.ndarray:
        """F_y over load. [-]"""
        return self.F_y / self.load

    # ---- making new ones ---------------------------------------------------------------------------------------

    def rows(self, which: np.ndarray | slice) -> Self:
        """Some of the samples, by mask, index or slice."""
        picked = {key: getattr(self, key)[which] for key in _SIGNALS if getattr(self, key) is not None}
        return replace(self, **picked)

    def thinned(self, limit: int) -> Self:
        """At most ``limit`` samples, one of each stretch of the record, at a random place in it (seed 0).

        Not every n-th one: sweeps repeat, and a fixed stride would meet the same few slips in all of them.
        """
        if self.n_samples <= limit:
            return self
        edges = np.linspace(0, self.n_samples, limit + 1).astype(int)
        rows = np.random.default_rng(0).integers(edges[:-1], edges[1:])
        return replace(self.rows(rows), notes=(*self.notes, f"{limit} of {self.n_samples} samples, evenly spread"))

    def mirrored(self) -> Self:
        """The tire on the other side of the vehicle: left and right exchanged."""
        turned = {k: -getattr(self, k) for k in _MIRRORED if getattr(self, k) is not None}
        return replace(self, **turned, notes=(*self.notes, "mirrored"))

    def sweeps(self, tolerance: Tolerance | None = None) -> tuple[Sweep, ...]:
        """Samples grouped by level of load, camber and pressure.

        Levels are where the samples pile up: peaks of their histogram, at least twice the tolerance apart. Samples
        further than the tolerance from every level, such as those between two loads, belong to no sweep. They rise in
        load, camber, pressure; groups of fewer than 20 samples are left out.
        """
        t = tolerance or Tolerance()
        groups = [levels(self.load, t.load), levels(self.gamma, t.camber)]
        if self.pressure is not None:
            groups.append(levels(self.pressure, t.pressure))
        parts = []
        index = np.column_stack([g[1] for g in groups])
        for key in sorted({tuple(row) for row in index[(index >= 0).all(axis=1)]}):
            rows = np.flatnonzero((index == key).all(axis=1))
            if len(rows) < 20:
                continue
            part = self.rows(rows)
            pressure = None if part.pressure is None else float(part.pressure.mean())
            level = float(part.load.mean()), float(part.gamma.mean()), pressure
            parts.append(Sweep(*level, rows, _span(part.slip_ratio), _span(part.slip_angle)))
        return tuple(parts)


class Sweep(NamedTuple):
    """Samples of one level of load [N], camber [rad] and pressure [Pa or None]; spans of slip ratio and angle."""

    load: float
    camber: float
    pressure: float | None
    rows: np.ndarray
    slip_ratio: tuple[float, float]
    slip_angle: tuple[float, float]

    @property
    def kind(self) -> str:
        """``"lateral"``, ``"longitudinal"`` or ``"combined"``, by which slip moves."""
        moves_x = self.slip_ratio[1] - self.slip_ratio[0] > 0.03
        moves_y = self.slip_angle[1] - self.slip_angle[0] > math.radians(2.0)
        turned = max(abs(a) for a in self.slip_angle) > math.radians(1.0)
        if moves_x:
            return "combined" if moves_y or turned else "longitudinal"
        return "lateral"


def levels(values: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Levels at which values pile up, rising, and which of them each value belongs to; -1 for none.

    ``tolerance`` is half the width of a level; values that reach further than 10 000 times that are refused.

    >>> rng = np.random.default_rng(0)
    >>> found, index = levels(np.concatenate([v + rng.normal(size=500) for v in (50.0, 100.0)]), 10.0)
    >>> found.round(), np.bincount(index)
    (array([ 50., 100.]), array([500, 500]))
    """
    low, high = float(values.min()), float(values.max())
    if high - low <= tolerance:
        return np.array([float(values.mean())]), np.zeros(len(values), dtype=int)
    width = tolerance / 8
    if not high - low < _MOST_BINS * width:
        raise ParameterError(
            f"the values reach from {low:.4g} to {high:.4g}, which is {(high - low) / tolerance:.3g} times the "
            f"tolerance {tolerance:g}; expected at most {_MOST_BINS / 8:.3g} times: leave outliers out"
        )
    bins = math.ceil((high - low) / width) + 33
    edges = low - 16 * width + width * np.arange(bins + 1)
    count = gaussian_filter1d(np.histogram(values, edges)[0].astype(float), 3.0, mode="constant")
    lowest = 0.02 * float(count.max())
    peaks = [
        k for k in range(1, bins - 1) if count[k] >= count[k - 1] and count[k] > count[k + 1] and count[k] > lowest
    ]
    kept: list[int] = []
    for k in sorted(peaks, key=lambda k: -count[k]):
        if all(abs(k - other) * width >= 1.5 * tolerance for other in kept):
            kept.append(k)
    centres = np.array([edges[k] + width / 2 for k in sorted(kept)])
    index = np.argmin(np.abs(values[:, None] - centres), axis=1)
    index[np.abs(values - centres[index]) > tolerance] = -1
    means = np.array([values[index == k].mean() if (index == k).any() else c for k, c in enumerate(centres)])
    return means, index


def joined(parts: Sequence[TireData], *, name: str = "") -> TireData:
    """Several records as one, such as cornering and drive/brake runs of the same tire.

    Runs are numbered through. Signals that only some of the records have are left out, with a note. Where they
    contradict each other is told by `slipangle.data.rig_runs.disagreements`.

    Raises TooShortError if there is no record.
    """
    if not parts:
        raise TooShortError("there is no record to join; expected at least one")
    given: dict[str, np.ndarray] = {}
    notes = [note for part in parts for note in part.notes]
    for key in _SIGNALS:
        columns = [getattr(part, key) for part in parts]
        present = [c for c in columns if c is not None]
        if len(present) == len(parts):
            given[key] = np.concatenate(present)
        elif present:
            notes.append(f"{key} was measured in some of the records only and is left out")
    counts = [len(part.runs) for part in parts]
    numbers = [np.searchsorted(np.unique(p.run), p.run) for p in parts if p.run is not None]
    given["run"] = np.concatenate([k + sum(counts[:i]) for i, k in enumerate(numbers)])
    radius = next((part.radius for part in parts if part.radius), None)
    named = name or " + ".join(p.name for p in parts)
    return TireData(**given, radius=radius, name=named, notes=tuple(dict.fromkeys(notes)))


def _span(values: np.ndarray) -> tuple[float, float]:
    """Range without the outermost half percent on both sides."""
    low, high = np.quantile(values, (0.005, 0.995))
    return float(low), float(high)
