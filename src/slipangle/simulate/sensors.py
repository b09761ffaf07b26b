"""`Sensor`: what an instrument makes of a true signal: sampling, delay, noise, bias, quantisation, drop-outs."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from slipangle.errors import ParameterError, SampleTimeError
from slipangle.fields import Checked, Finite, Within
from slipangle.optimal.terms import Named

Size = Annotated[float, Within(0, open="high")]


@dataclass(frozen=True, kw_only=True)
class Sensor(Checked):
    """One instrument; by default a perfect one.

    A sample taken at ``t`` is ``(1 + gain) true(t) + bias + drift(t) + noise``, limited to `range`, rounded to
    `quantum`, and seen from ``t + delay`` on, until the next one arrives.

    Parameters
    ----------
    interval, delay : float
        Time between samples, 0 standing for every step of the plant; from sampling to arrival. [s]
    noise, bias : float
        Standard deviation of white noise, constant offset; in the channel's unit.
    gain : float
        Relative scale error. [-]
    drift : float
        Standard deviation of a random walk's change in one second, in the channel's unit.
    quantum, range : float, tuple of float
        Step between values that it can show, 0: none; smallest and largest of them.
    drop_out, drop_length : float
        Share of the samples that are lost, and mean number of those in a row.
    lost : {"hold", "nan"}
        What a lost sample shows: the last one that arrived, or NaN.

    >>> Sensor(quantum=0.5, bias=0.2).record(np.array([1.0, 1.2]), 0.01).tolist()
    [1.0, 1.5]
    """

    interval: Size = 0.0
    delay: Size = 0.0
    noise: Size = 0.0
    bias: Finite = 0.0
    gain: Finite = 0.0
    drift: Size = 0.0
    quantum: Size = 0.0
    range: tuple[float, float] = (-math.inf, math.inf)
    drop_out: Annotated[float, Within(0, 1, open="high")] = 0.0
    drop_length: Annotated[float, Within(1, open="high")] = 1.0
    lost: Literal["hold", "nan"] = "hold"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.range[0] < self.range[1]:
            raise ParameterError(f"range is {self.range}; expected (lowest, highest)")

    def record(self, true: np.ndarray, dt: float, *, seed: int = 0) -> np.ndarray:
        """What the instrument shows at every sample of a true signal, shape (n,), whose sample time is ``dt`` [s].

        Before the first sample arrives it shows the first true value, without noise. ``seed`` is that of noise, drift
        and drop-outs.
        """
        true = np.asarray(true, dtype=float)
        stream = Stream(self, dt, np.random.default_rng(seed), float(true[0]))
        stream.feed(0, true)
        return np.array([stream.read(k) for k in range(len(true))])


class Stream:
    """A sensor at work: fed with the true signal, whose step is ``dt`` [s], read at any later step.

    Raises SampleTimeError if the sensor's interval is no multiple of ``dt``.
    """

    def __init__(self, sensor: Sensor, dt: float, rng: np.random.Generator, first: float) -> None:
        self.every = max(round(sensor.interval / dt), 1)
        if sensor.interval and not math.isclose(self.every * dt, sensor.interval, rel_tol=1e-6):
            raise SampleTimeError(
                f"a sensor samples every {sensor.interval:g} s, the plant steps by {dt:g} s; expected a whole "
                "multiple: choose another of the two"
            )
        self.sensor, self._dt, self._rng = sensor, dt, rng
        self.late = round(sensor.delay / dt)
        self._drift = 0.0
        self._lost = False
        self.waiting: list[tuple[int, float]] = []
        self.shown = float(self._convert(np.array([first]))[0])

    def feed(self, tick: int, true: np.ndarray) -> None:
        """Take the samples that fall into steps ``tick``, ``tick + 1``, ... of the true signal, shape (n,)."""
        start = -tick % self.every
        values = np.asarray(true, dtype=float)[start :: self.every]
        if len(values) == 0:
            return
        s, n = self.sensor, len(values)
        error, lost = self.draw(n)
        shown = self._convert(values, error)
        for k in range(n):
            if lost[k] and s.lost == "hold":
                continue
            arrival = tick + start + k * self.every + self.late
            self.waiting.append((arrival, math.nan if lost[k] else float(shown[k])))

    def draw(self, n: int) -> tuple[np.ndarray, np.ndarray]:
        """What the next samples are off by, noise and drift, and whether they are lost; shape (n,) both."""
        s = self.sensor
        walk = np.zeros(n)
        if s.drift:
            walk = self._drift + np.cumsum(self._rng.normal(0.0, s.drift * math.sqrt(self.every * self._dt), n))
            self._drift = float(walk[-1])
        noise = self._rng.normal(0.0, s.noise, n) if s.noise else np.zeros(n)
        return noise + walk, self._drops(n) if s.drop_out else np.zeros(n, dtype=bool)

    def read(self, tick: int) -> float:
        """What the instrument shows at a step; steps must not go back."""
        while self.waiting and self.waiting[0][0] <= tick:
            self.shown = self.waiting.pop(0)[1]
        return self.shown

    def _convert(self, values: np.ndarray, error: np.ndarray | float = 0.0) -> np.ndarray:
        s = self.sensor
        shown = (1.0 + s.gain) * values + s.bias + error
        if s.quantum:
            shown = s.quantum * np.round(shown / s.quantum)
        return np.clip(shown, *s.range)

    def _drops(self, n: int) -> np.ndarray:
        """Which samples are lost: a chain with two states, so that losses come in a row."""
        s = self.sensor
        end = 1.0 / s.drop_length
        begin = end * s.drop_out / (1.0 - s.drop_out)
        if begin > 1.0:
            begin, end = 1.0, (1.0 - s.drop_out) / s.drop_out
        chance, lost = self._rng.uniform(size=n), np.zeros(n, dtype=bool)
        for k in range(n):
            self._lost = chance[k] >= end if self._lost else chance[k] < begin
            lost[k] = self._lost
        return lost


class Sensors(Named[Sensor]):
    """Instruments by channel name, immutable.

    >>> sensors = Sensors(r=Sensor(noise=0.01, interval=0.01), X=Sensor(interval=0.1, delay=0.05))
    >>> sensors["X"].delay
    0.05
    """

    __slots__ = ()
    _what = "sensor"

    def _checked(self, name: str, value: Any) -> Sensor:
        if not isinstance(value, Sensor):
            raise ParameterError(f"the sensor of '{name}' is {value!r}; expected Sensor(...)")
        return value
