"""Mistakes planted into a clean log or into what its user says of the car, and what a sentence about each must name."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.foreign_cars.scipy_fit import Known

from slipangle.data.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """One mistake: what it does to the log and to what is known of the car, and what its sentence must say."""

    name: str
    says: str  # regular expression, case ignored
    data: Callable[[Dataset], Dataset] = lambda data: data
    known: Callable[[Known], Known] = lambda known: known
    visible: bool = True  # in a log at all

    def named(self, sentences: Iterable[str]) -> bool:
        """Whether one of the sentences names it."""
        return any(re.search(self.says, sentence, re.IGNORECASE) for sentence in sentences)


def _changed(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Dataset], Dataset]:
    """A channel that is logged wrong."""
    return lambda data: data.with_channel(name, change(data[name]), data.unit(name))


def _slower_clock(data: Dataset) -> Dataset:
    """Milliseconds read as seconds."""
    return replace(data, dt=1000 * data.dt, start_times=tuple(1000 * t for t in data.start_times))


def _swapped(data: Dataset) -> Dataset:
    """v_y and a_y under each other's name."""
    return data.with_channel("v_y", data["a_y"], "m/s").with_channel("a_y", data["v_y"], "m/s2")


def _late(data: Dataset, seconds: float = 0.3) -> Dataset:
    """The yaw rate arrives late, in every experiment."""
    n, r = round(seconds / data.dt), data["r"].copy()
    for a, b in zip(data.starts, data.stops, strict=True):
        r[a + n : b], r[a : a + n] = data["r"][a : b - n], data["r"][a]
    return data.with_channel("r", r, data.unit("r"))


def _stuck(data: Dataset, share: float = 0.4) -> Dataset:
    """The yaw rate stays at one value over the middle of every third experiment."""
    r = data["r"].copy()
    for a, b in list(zip(data.starts, data.stops, strict=True))[::3]:
        first = a + round((b - a) * (0.5 - share / 2))
        r[first : first + round((b - a) * share)] = r[first]
    return data.with_channel("r", r, data.unit("r"))


MISTAKES: tuple[Mistake, ...] = (
    Mistake(name="sign of the steering", data=_changed("delta", np.negative), says=r"\bsign\b|opposite|revers|mirror"),
    Mistake(name="steering in degrees", data=_changed("delta", np.rad2deg), says=r"\bdeg"),
    Mistake(name="speed in km/h", data=_changed("v_x", lambda v: 3.6 * v), says=r"km/h"),
    Mistake(
        name="steering ratio forgotten",
        data=_changed("delta", lambda d: 15 * d),
        says=r"hand.?wheel|steering.?wheel|ratio",
    ),
    Mistake(name="time in milliseconds", data=_slower_clock, says=r"\bms\b|millisecond"),
    Mistake(
        name="offset of the yaw rate",
        data=_changed("r", lambda r: r + 0.6 * r.std()),
        says=r"(\br\b|yaw.?rate).*(offset|bias|zero)|(offset|bias).*(\br\b|yaw.?rate)",
    ),
    Mistake(name="yaw rate in deg/s", data=_changed("r", np.rad2deg), says=r"deg/s|degrees per second"),
    Mistake(name="v_y and a_y swapped", data=_swapped, says=r"swap|exchang|interchang|mixed up"),
    Mistake(name="yaw rate 0.3 s late", data=_late, says=r"\blate|delay|behind|lags"),
    Mistake(name="yaw rate stuck", data=_stuck, says=r"stuck|frozen|stands still|does not (move|change)|constant for"),
    Mistake(
        name="gain of the steering",
        data=_changed("delta", lambda d: 1.8 * d),
        says=r"times what delta says|steering ratio|steering.?gain",
    ),
    Mistake(name="mass in tonnes", known=lambda known: replace(known, mass=1e-3 * known.mass), says=r"\bmass\b"),
    Mistake(
        name="twice the mass",
        known=lambda known: replace(known, mass=2 * known.mass),
        says=r"\bmass\b",
        visible=False,  # C_f, C_r and inertia_z go with it: the motion of the car is the same
    ),
    Mistake(
        name="wheelbase half as long again",
        known=lambda known: replace(known, wheelbase=1.5 * known.wheelbase, l_f=1.5 * known.l_f),
        says=r"wheelbase",
    ),
)
