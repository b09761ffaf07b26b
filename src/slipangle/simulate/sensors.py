"""`Sensor`: what an instrument makes of a true signal: sampling, delay, noise, bias, quantisation, drop-outs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from slipangle.errors import ParameterError, SampleTimeError


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """One instrument; by default a perfect one.

    A sample taken at ``t`` is ``(1 + gain) true(t) + bias + drift(t) + noise``, limited to `range`, rounded to
    `quantum`, and seen from ``t + delay`` on, until the next one arrives.

    Parameters
    ----------
    interval : float
        Time between samples; 0 stands for every step of the plant. [s]
    delay : float
        From sampling to arrival. [s]
    noise : float
        Standard deviation of white noise, in the channel's unit.
    bias : float
        Constant offset, in the channel's unit.
    gain : float
        Relative scale error. [-]
    drift : float
        Standard deviation of a random walk's change in one second, in the channel's unit.
    quantum : float
        Step between values that it can show; 0: none.
    range : tuple of float
        Smallest and largest value that it can show.
    drop_out : float
        Share of the samples that are lost.
    drop_length : float
        Mean number of samples lost in a row.
    lost : {"hold", "nan"}
        What a lost sample shows: the last one that arrived, or NaN.

    Raises
    ------
    ParameterError
        If a number is not finite or negative, or a share is not below 1.

    >>> Sensor(quantum=0.5, bias=0.2).record(np.array([1.0, 1.2]), 0.01).tolist()
    [1.0, 1.5]
    """

    interval: float = 0.0
    delay: float = 0.0
    noise: float = 0.0
    bias: float = 0.0
    gain: float = 0.0
    drift: float = 0.0
    quantum: float = 0.0
    range: tuple[float, float] = (-math.inf, math.inf)
    drop_out: float = 0.0
    drop_length: float = 1.0
    lost: Literal["hold", "nan"] = "hold"

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, int | float):
                signed = f.name in ("bias", "gain")
                if not math.isfinite(value) or (value < 0 and not signed):
                    what = "a finite number" if signed else "a finite number of at least 0"
                    raise ParameterError(f"the sensor's {f.name} is {value}; expected {what}")
        if not self.drop_out < 1 or self.drop_length < 1:
            raise ParameterError(
                f"the sensor's drop_out is {self.drop_out}, drop_length {self.drop_length}; expected a share below 1 "
                "and at least one sample"
            )
        if not self.range[0] < self.range[1]:
            raise ParameterError(f"the sensor's range is {self.range}; expected (lowest, highest)")
        if self.lost not in ("hold", "nan"):
            raise ParameterError(f'the sensor\'s lost is {self.lost!r}; expected "hold" or "nan"')

    def record(self, true: np.ndarray, dt: float, *, seed: int = 0) -> np.ndarray:
        """What the instrument shows at every sample of a true signal.

        Parameters
        ----------
        true : array, shape (n,)
            The signal.
        dt : float
            Its sample time. [s]
        seed : int
            Of noise, drift and drop-outs.

        Returns
        -------
        array, shape (n,)
            Before the first sample arrives, the first true value as the instrument would show it without noise.
        """
        true = np.asarray(true, dtype=float)
        stream = Stream(self, dt, np.random.default_rng(seed), float(true[0]))
        stream.feed(0, true)
        return np.array([stream.read(k) for k in range(len(true))])


class Stream:
    """A sensor at work: fed with the true signal, read at any later step.

    Parameters
    ----------
    sensor : Sensor
        The instrument.
    dt : float
        Step of the true signal. [s]
    rng : Generator
        For noise, drift and drop-outs.
    first : float
        True value before the first sample.

    Raises
    ------
    SampleTimeError
        If the sensor's interval is no multiple of ``dt``.
    """

    def __init__(self, sensor: Sensor, dt: float, rng: np.random.Generator, first: float) -> None:
        self.every = max(round(sensor.interval / dt), 1)
        if sensor.interval and not math.isclose(self.every * dt, sensor.interval, rel_tol=1e-6):
            raise SampleTimeError(
                f"a sensor samples every {sensor.interval:g} s, the plant steps by {dt:g} s; expected a whole "
                "multiple: choose another of the two"
            )
        self._sensor, self._dt, self._rng = sensor, dt, rng
        self._late = round(sensor.delay / dt)
        self._drift = 0.0
        self._lost = False
        self._waiting: list[tuple[int, float]] = []
        self._shown = float(self._convert(np.array([first]))[0])

    def feed(self, tick: int, true: np.ndarray) -> None:
        """Take the samples that fall into steps ``tick``, ``tick + 1``, ... of the true signal, shape (n,)."""
        start = -tick % self.every
        values = np.asarray(true, dtype=float)[start :: self.every]
        if len(values) == 0:
            return
        s, n = self._sensor, len(values)
        walk = np.zeros(n)
        if s.drift:
            walk = self._drift + np.cumsum(self._rng.normal(0.0, s.drift * math.sqrt(self.every * self._dt), n))
            self._drift = float(walk[-1])
        noise = self._rng.normal(0.0, s.noise, n) if s.noise else np.zeros(n)
        shown = self._convert(values, noise + walk)
        lost = self._drops(n) if s.drop_out else np.zeros(n, dtype=bool)
        for k in range(n):
            if lost[k] and s.lost == "hold":
                continue
            arrival = tick + start + k * self.every + self._late
            self._waiting.append((arrival, math.nan if lost[k] else float(shown[k])))

    def read(self, tick: int) -> float:
        """What the instrument shows at a step; steps must not go back."""
        while self._waiting and self._waiting[0][0] <= tick:
            self._shown = self._waiting.pop(0)[1]
        return self._shown

    def _convert(self, values: np.ndarray, error: np.ndarray | float = 0.0) -> np.ndarray:
        s = self._sensor
        shown = (1.0 + s.gain) * values + s.bias + error
        if s.quantum:
            shown = s.quantum * np.round(shown / s.quantum)
        return np.clip(shown, *s.range)

    def _drops(self, n: int) -> np.ndarray:
        """Which samples are lost: a chain with two states, so that losses come in a row."""
        s = self._sensor
        end = 1.0 / s.drop_length
        begin = end * s.drop_out / (1.0 - s.drop_out)
        if begin > 1.0:
            begin, end = 1.0, (1.0 - s.drop_out) / s.drop_out
        chance, lost = self._rng.uniform(size=n), np.zeros(n, dtype=bool)
        for k in range(n):
            self._lost = chance[k] >= end if self._lost else chance[k] < begin
            lost[k] = self._lost
        return lost


class Sensors(Mapping[str, Sensor]):
    """Instruments by channel name, immutable.

    >>> sensors = Sensors(r=Sensor(noise=0.01, interval=0.01), X=Sensor(interval=0.1, delay=0.05))
    >>> sensors["X"].delay
    0.05
    """

    __slots__ = ("_items",)

    def __init__(self, **sensors: Sensor) -> None:
        for name, sensor in sensors.items():
            if not isinstance(sensor, Sensor):
                raise ParameterError(f"the sensor of '{name}' is {sensor!r}; expected Sensor(...)")
        self._items = dict(sensors)

    def __getitem__(self, name: str) -> Sensor:
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def __hash__(self) -> int:
        return hash(frozenset(self._items.items()))

    def __repr__(self) -> str:
        return f"Sensors({', '.join(f'{k}={v!r}' for k, v in self._items.items())})"
