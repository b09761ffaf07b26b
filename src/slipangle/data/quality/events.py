"""Spikes, jumps and angles that wrap in a recording: found, named with time and size, and removed only on request."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from scipy import ndimage

from slipangle import units
from slipangle.data.dataset import Dataset
from slipangle.data.headings import TURN, is_heading, wraps
from slipangle.errors import ParameterError, UnitError

_ALONE = 1.5  # of the largest step near by, which a spike exceeds: the summit of a steep signal does not
_NEAR_TURN = 0.1  # of a turn, within which a leap of any angle is one
_NEAR = 25  # samples, of which fewer than half stand alone
_EVEN = 0.8  # of the gaps between the levels of a quantised signal, which are whole steps
_NORMAL_P99 = 2.5758  # 99 % of a normal law lies within this many standard deviations
FASTEST: Mapping[str, float] = MappingProxyType({"speed": 15.0})
"""Largest believable change per second, by quantity, SI: no tire accelerates a car by more than about 1.5 g."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something at one sample of a channel: its row, time [s] and size in the channel's unit."""

    channel: str
    row: int
    t: float
    size: float  # in the channel's unit
    unit: str

    @property
    def read(self) -> str:
        """The size in the unit that people read."""
        factor, unit = units.read_in(self.channel, self.unit)
        return f"{factor * self.size:+.3g} {unit}"


@dataclass(frozen=True, kw_only=True)
class Spike(Event):
    """A few samples that leave the signal and come back."""

    samples: int

    @property
    def sentence(self) -> str:
        """The finding in words."""
        lasts = "a single sample" if self.samples == 1 else f"{self.samples} samples"
        return f"{self.channel} has a spike of {self.read} at t = {self.t:.2f} s, {lasts}"


class Jump(Event):
    """One step between two samples that is too large for the signal."""

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return f"{self.channel} jumps by {self.read} in one sample at t = {self.t:.2f} s"


@dataclass(frozen=True, kw_only=True)
class Wrap(Event):
    """An angle that starts again after a full turn, at the first sample after the first leap."""

    rows: tuple[int, ...]  # after every leap
    heading: bool  # whether it is known as one: then it is unwrapped before anything is interpolated

    @property
    def sentence(self) -> str:
        """The finding in words."""
        first = f"{self.channel} leaps by a full turn at t = {self.t:.2f} s"
        count = f", the first of {len(self.rows)} such leaps" if len(self.rows) > 1 else ""
        if self.heading:
            return f"{first}{count}: an angle that wraps; data.unwrapped() lets it go on, as models have it"
        return (
            f"{first}{count}: an angle that wraps, and what interpolates runs through its half turn: unwrap it, or "
            "call it a heading"
        )


def _spread(residual: np.ndarray) -> float:
    """Standard deviation of the bulk, not swayed by outliers nor by long stretches of rest."""
    size = np.abs(residual)
    return float(max(1.4826 * np.median(size), np.percentile(size, 99) / _NORMAL_P99))


def _usual(residual: np.ndarray) -> float:
    """The same where samples that stand alone are many: they are not what most samples near them are."""
    near = 1.4826 * ndimage.median_filter(np.abs(residual), _NEAR, mode="nearest")
    return min(_spread(residual), float(max(np.median(near), np.percentile(near, 99))))


def level_step(x: np.ndarray) -> float:
    """Step between the levels a quantised signal takes; 0 if it is not quantised.

    >>> round(level_step(np.round(np.sin(np.arange(500.0)), 1)), 9)
    0.1
    """
    levels = np.unique(x)
    if not 3 < len(levels) < 0.25 * len(x):
        return 0.0
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-9 * np.ptp(x)]
    least = float(np.quantile(gaps, 0.1))
    step = float(np.median(gaps[gaps < 1.5 * least]))
    apart = np.abs(gaps / step - np.round(gaps / step))
    return step if np.mean(apart < 0.1) > _EVEN else 0.0  # a value that is held is at no level


def _checked(width: int, threshold: float) -> None:
    if width < 3 or width % 2 == 0:
        raise ParameterError(f"the median's width is {width} samples; expected an odd number from 3 on, such as 5")
    if not threshold > 0:
        raise ParameterError(
            f"the threshold is {threshold}; expected a positive number of standard deviations, such as 12"
        )


def _median(x: np.ndarray, width: int) -> np.ndarray:
    """The running median; past the ends the recording goes on as its mirror image about the last sample."""
    return ndimage.median_filter(x, width, mode="mirror")


def find_spikes(data: Dataset, channel: str, *, width: int = 5, threshold: float = 12.0) -> tuple[Spike, ...]:
    """Samples that stand out from the median of their neighbourhood, further than it moves itself, and are alone in it.

    At the very ends of a recording a spike cannot be told from a step and is not reported.

    Raises MissingColumnError or ParameterError if there is no such channel, or the settings make no sense.

    Parameters
    ----------
    data, channel
        The recording, and which of its channels.
    width : int
        Samples of the running median, odd; spikes of up to ``(width - 1) / 2`` samples are found.
    threshold : float
        How far a sample must stand out, in standard deviations of the bulk of all samples.

    Returns
    -------
    tuple of Spike
        In order of time; ``size`` is the distance from the running median.
    """
    _checked(width, threshold)
    unit = data.unit(channel)
    residual = np.concatenate([p[channel] - _median(p[channel], width) for p in data.experiments])
    floor = max(1e-4 * float(np.ptp(data[channel])), level_step(data[channel]) / 4)
    limit = threshold * max(_usual(residual), floor)
    size = np.abs(residual)
    stands_out = np.asarray(size > limit)
    steps = np.concatenate([np.append(np.abs(np.diff(part[channel])), 0.0) for part in data.experiments])
    steps[stands_out | np.append(stands_out[1:], False)] = 0.0
    stands_out[[*data.starts, *(stop - 1 for stop in data.stops)]] = False
    spikes, t = [], data.t
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands_out.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2).tolist():
        peak = start + int(np.argmax(size[start:stop]))
        near = slice(max(peak - 2 * width, 0), peak + 2 * width + 1)
        tall = np.flatnonzero(size[near] > 0.3 * size[peak])
        samples = int(tall[-1] - tall[0]) + 1
        if samples <= width // 2 and size[peak] > _ALONE * steps[near].max():
            at = {"row": peak, "t": float(t[peak]), "size": float(residual[peak])}
            spikes.append(Spike(channel=channel, samples=samples, unit=unit, **at))
    return tuple(spikes)


def despike(data: Dataset, channel: str, width: int = 5, threshold: float = 12.0) -> tuple[Dataset, list[Spike]]:
    """Replace spikes, and nothing else, by the median of their neighbourhood; settings and errors as in `find_spikes`.

    Returns
    -------
    data, spikes
        The repaired recording, with one note per spike, and the spikes. Without spikes the data are
        returned as they are.
    """
    spikes = list(find_spikes(data, channel, width=width, threshold=threshold))
    if not spikes:
        return data, spikes
    smooth = np.concatenate([_median(p[channel], width) for p in data.experiments])
    column = data[channel].copy()
    for spike in spikes:
        rows = slice(max(spike.row - spike.samples + 1, 0), spike.row + spike.samples)
        near = np.abs(column[rows] - smooth[rows]) > 0.3 * abs(spike.size)
        column[rows] = np.where(near, smooth[rows], column[rows])
    repaired = data.with_channel(channel, column, data.unit(channel))
    for spike in spikes:
        repaired = repaired.with_note(f"{spike.sentence}: replaced by the median of {width} samples")
    return repaired, spikes


def find_jumps(
    data: Dataset, channel: str, *, threshold: float = 12.0, fastest: float | None = None, skip: tuple[Spike, ...] = ()
) -> tuple[Jump, ...]:
    """Steps from one sample to the next that are too large.

    For a speed the limit is physical, 15 m/s2 by default, or 4.5 standard deviations of the bulk of all
    steps where the sensor is noisier, and three quarters of it must not be the trend around the step. For
    other channels a step must exceed ``threshold`` standard deviations, stand apart from the steps beside it, and
    stay: the mean of the three samples after and before must differ by most of it.

    Parameters
    ----------
    data, channel
        The recording, and which of its channels.
    threshold : float
        In standard deviations of the steps.
    fastest : float, optional
        Largest believable change per second, in the channel's unit; replaces the rule above.
    skip : tuple of Spike
        Spikes found before; their flanks are no jumps.

    They come in order of time; ``t`` is the first sample after the step. Errors as in `find_spikes`.
    """
    _checked(5, threshold)
    unit = data.unit(channel)
    limit = fastest if fastest is not None else FASTEST.get(quantity(unit))
    near_spikes = {row for s in skip for row in range(s.row - s.samples, s.row + s.samples + 2)}
    jumps, offset = [], 0
    for part in data.experiments:
        x = part[channel]
        if len(x) > 8:
            if limit is None:
                rows = _rows_apart(x, threshold)
            else:  # noise is no jump: 4.5 standard deviations of all steps are always believable
                steps = np.diff(x)
                rows = _rows_above(x, max(limit * data.dt, 4.5 * _spread(steps - np.median(steps))))
            jumps += [
                Jump(channel=channel, row=offset + k, t=float(part.t[k]), size=float(x[k] - x[k - 1]), unit=unit)
                for k in rows
                if offset + k not in near_spikes
            ]
        offset += len(x)
    return tuple(jumps)


def find_wrap(data: Dataset, channel: str) -> Wrap | None:
    """Leaps of a full turn of a channel in rad, of a heading all beyond half a turn; None where there are none.

    Raises MissingColumnError if there is no such channel.
    """
    unit, rows = data.unit(channel), list[int]()
    heading = is_heading(channel, unit)
    if not heading and unit != "rad":
        return None
    x = data[channel]
    for a, b in zip(data.starts, data.stops, strict=True):
        leaps = a + 1 + wraps(x[a:b])
        whole = np.abs(np.abs(x[leaps] - x[leaps - 1]) / TURN - 1) < _NEAR_TURN
        rows += leaps[heading | whole].tolist()
    if not rows:
        return None
    first, size = rows[0], float(x[rows[0]] - x[rows[0] - 1])
    at = {"row": first, "t": float(data.t[first]), "size": size, "unit": unit}
    return Wrap(channel=channel, rows=tuple(rows), heading=heading, **at)


def quantity(unit: str) -> str:
    """What a unit measures, nothing where it is not known."""
    try:
        return units.quantity(unit)
    except UnitError:
        return ""


def _rows_above(x: np.ndarray, limit: float) -> list[int]:
    """Steps above the limit of which most is not the trend around them (braking, say)."""
    steps = np.diff(x)
    apart = np.abs(steps - _median(steps, 11)) > 0.75 * limit
    return (np.flatnonzero((np.abs(steps) > limit) & apart) + 1).tolist()


def _rows_apart(x: np.ndarray, threshold: float) -> list[int]:
    steps = np.diff(x)
    excess = steps - _median(steps, 7)
    rows = np.flatnonzero(np.abs(excess) > threshold * max(_spread(excess), 1e-4 * np.ptp(x))) + 1
    kept = []
    for k in rows.tolist():
        if 3 <= k <= len(x) - 3 and x[k] != x[k - 1]:
            stays = (x[k : k + 3].mean() - x[k - 3 : k].mean()) / (x[k] - x[k - 1])
            if 0.6 < stays < 1.4:
                kept.append(k)
    return kept


def runs(data: Dataset, where: np.ndarray) -> list[tuple[int, int]]:
    """Rows (start, stop) of each run of samples, none across the border of two experiments."""
    found, offset = [], 0
    for part in data.experiments:
        edges = np.flatnonzero(np.diff([0, *where[offset : offset + len(part)].astype(int), 0])).reshape(-1, 2)
        found += [(offset + a, offset + b) for a, b in edges.tolist()]
        offset += len(part)
    return found
