"""What a recording is worth before anything is fitted to it: `inspect` reports, nothing is repaired or hidden."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.ndimage import uniform_filter1d

from slipangle.data.dataset import Dataset
from slipangle.data.quality.delay import MOTION, STEERING, Delay, estimate_delay
from slipangle.data.quality.dropouts import Dropout, find_dropouts
from slipangle.data.quality.events import (
    Jump,
    Spike,
    Wrap,
    despike,
    find_jumps,
    find_spikes,
    find_wrap,
    level_step,
    runs,
)
from slipangle.errors import ExcitationError, TooShortError
from slipangle.shown import Shown
from slipangle.units import read_in

_STRAIGHT, _STRAIGHT_BY = 0.05, ("r", "a_y")  # below this share of their largest values a car drives straight,
_SETTLED, _SMOOTH = 0.4, 0.1  # s, if for as long, in means over so long; between two bends steering is ahead of the car
_SPEED = ("v_x", "v_x_dot", "a_x", "throttle", "brake", "pedal")
_STANDING = 0.2  # of the highest speed
_MOST = 0.99  # quantile that counts as the largest
_FEW_LEVELS = 8  # a channel with no more levels is a switch, not clipped
_MANY = 10  # events of one channel that are told one by one
_ACROSS, _FASTEST = 0.25, 0.75  # s to either side that tell how fast a channel moves; quantile from which it is fast
_AS_OFTEN = 0.7  # share of the repeats that are left there, from which it is held
_HELD = 1.0  # a channel at rest for longer is worth a word [s]


def _read(channel: str, unit: str, value: float) -> str:
    """A value of a channel in the unit that people read."""
    factor, unit = read_in(channel, unit)
    return f"{factor * value:.4g}" + ("" if unit == "-" else f" {unit}")


@dataclass(frozen=True, kw_only=True)
class Seen:
    """Something seen in a channel."""

    channel: str

    @property
    def sentence(self) -> str:
        """The finding in words."""
        return self._said()

    def _said(self) -> str:
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Offset(Seen):
    """What a channel shows while the car drives straight, where it should show zero."""

    value: float  # mean while driving straight, in the channel's unit
    error: float  # standard error of that mean, in the channel's unit
    samples: int
    unit: str

    def _said(self) -> str:
        factor, unit = read_in(self.channel, self.unit)
        value = f"{factor * self.value:{'+.2f' if unit == 'deg' else '+.2g'}} {unit}"
        size = f"{value} (95 % within {1.96 * factor * self.error:.1g} {unit})"
        return f"{self.channel} shows {size} while the car drives straight ({self.samples} samples)"


@dataclass(frozen=True, kw_only=True)
class Stretch(Seen):
    """A channel that stands still for a while: since when and how long [s], at which value.

    It is the longest of ``count`` such stretches.
    """

    t: float
    duration: float
    value: float  # at which it stands, in its SI unit
    count: int
    unit: str = "-"

    def _said(self) -> str:
        value = _read(self.channel, self.unit, self.value)
        return (
            f"{self.channel} stays at {value} for {self.duration:.3g} s from t = {self.t:.2f} s, the longest "
            f"of {self.count} such stretches"
        )


@dataclass(frozen=True, kw_only=True)
class Clipping(Seen):
    """A channel that rests at its largest or smallest value as if it could go no further."""

    value: float  # at which it rests, in the channel's unit
    share: float  # of the samples that rest there [-]
    unit: str = "-"

    def _said(self) -> str:
        share = f"{100 * self.share:.2g} %"
        value = _read(self.channel, self.unit, self.value)
        return f"{self.channel} rests at its limit {value} for {share} of the time: saturated or clipped"


@dataclass(frozen=True, kw_only=True)
class Resolution(Seen):
    """Steps in which a channel comes, and how often a sample repeats the one before."""

    step: float  # between its levels, in the channel's unit; 0 if it has none
    repeats: float  # share of the samples that repeat the one before [-]
    unit: str
    rate: float  # of the samples [Hz]

    def _said(self) -> str:
        said = []
        if self.step:
            factor, unit = read_in(self.channel, self.unit)
            said.append(f"{self.channel} comes in steps of {factor * self.step:.3g} {unit}")
        if self.repeats > 0.02:
            real = (1 - self.repeats) * self.rate
            said.append(
                f"{100 * self.repeats:.0f} % of the samples of {self.channel} repeat the one before: new values come "
                f"at about {real:.3g} Hz"
            )
        return "; ".join(said)


@dataclass(frozen=True, kw_only=True)
class Excitation(Seen):
    """How far and how fast an input moves."""

    low: float  # smallest value, in the channel's unit
    high: float  # largest value, in the channel's unit
    std: float  # standard deviation, in the channel's unit
    bandwidth: float  # below which 95 % of its power is [Hz]
    unit: str

    @property
    def constant(self) -> bool:
        """Whether it does not move at all."""
        return self.high - self.low <= 1e-12 * max(1.0, abs(self.low), abs(self.high))

    def _said(self) -> str:
        if self.constant:
            return f"{self.channel} is constant at {_read(self.channel, self.unit, self.low)}: it excites nothing"
        factor, unit = read_in(self.channel, self.unit)
        low, high, std = (factor * v for v in (self.low, self.high, self.std))
        return (
            f"{self.channel} runs from {low:.3g} to {high:.3g} {unit}, standard deviation {std:.3g}, "
            f"95 % of its power below {self.bandwidth:.2g} Hz"
        )


@dataclass(frozen=True, kw_only=True)
class DataReport(Shown):
    """What was found in a recording; `sentences` says it all in words."""

    name: str
    gaps: tuple[float, ...]  # length of each border between experiments [s]
    spikes: tuple[Spike, ...]  # few samples that leave the signal and come back
    jumps: tuple[Jump, ...]  # steps that are too large for the signal
    dropouts: tuple[Dropout, ...]  # channels that fall to zero and come back, again and again
    delays: tuple[Delay, ...]  # of outputs behind inputs
    dt: float
    samples: int
    offsets: tuple[Offset, ...]  # of channels that should be zero when the car drives straight
    stretches: tuple[Stretch, ...]  # in which a channel stands still
    clippings: tuple[Clipping, ...]  # channels that rest at an end of their range
    wraps: tuple[Wrap, ...]  # angles that start again after a full turn
    duration: float
    resolutions: tuple[Resolution, ...]  # steps in which channels come
    excitations: tuple[Excitation, ...]  # how inputs move
    notes: tuple[str, ...]

    def _words(self) -> str:
        return f"{self.clock_sentence}; {len(self.findings)} findings"

    @property
    def clock_sentence(self) -> str:
        """Sample time, length and gaps in words."""
        text = f"{self.samples} samples at {1 / self.dt:.6g} Hz, {self.duration:.4g} s"
        if not self.gaps:
            return text + ", no gaps"
        longest = max(self.gaps)
        plural = "s" if len(self.gaps) > 1 else ""
        between = f"{len(self.gaps)} border{plural} between experiments"
        return f"{text}, {between}" + (f", the longest gap {longest:.3g} s" if longest > 0 else "")

    @property
    def findings(self) -> tuple[Spike | Jump | Dropout | Wrap | Delay | Seen, ...]:
        """All findings, the most alarming kind first."""
        wrong = (*self.spikes, *self.jumps, *self.dropouts, *self.wraps, *self.clippings, *self.stretches)
        return (*wrong, *self.offsets, *self.delays, *self.excitations, *self.resolutions)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Everything in words, the sample time first and what was done to the data last.

        Of more than ten spikes or jumps of a channel only the number and the largest are told.
        """
        events = (*_told(self.spikes, "spikes"), *_told(self.jumps, "jumps"))
        others = [f.sentence for f in self.findings if not isinstance(f, Spike | Jump)]
        return (self.clock_sentence, *events, *others, *self.notes)


def _told(events: Sequence[Spike] | Sequence[Jump], kind: str) -> list[str]:
    """Sentences of events, those of a channel with many as one."""
    said = []
    for channel in dict.fromkeys(e.channel for e in events):
        own = [e for e in events if e.channel == channel]
        largest = max(own, key=lambda e: abs(e.size))
        if len(own) <= _MANY:
            said += [e.sentence for e in own]
        else:
            said.append(f"{channel} has {len(own)} {kind}, the largest {largest.read} at t = {largest.t:.2f} s")
    return said


def inspect(data: Dataset, *, width: int = 5, threshold: float = 12.0) -> DataReport:
    """Look for what spoils an identification: spikes, jumps, delays, offsets, clipping, poor excitation.

    Nothing is changed: spikes are taken out only for the estimates of delay, offset and excitation, which they would
    distort. The inputs and outputs of the data say which delays to estimate; ``width`` and ``threshold`` are those of
    `find_spikes` (samples; multiples of the usual scatter [-]), which raises ParameterError where they make no sense.
    """
    going_on = data.unwrapped()
    spikes, jumps, turns, clean = [], [], [], going_on
    for name in data.names:
        marked = find_spikes(going_on, name, width=width, threshold=threshold)
        spikes += marked
        wrap = find_wrap(data, name)
        turns += [wrap] if wrap else []
        found = find_jumps(going_on, name, threshold=threshold, skip=marked)
        jumps += [jump for jump in found if not wrap or jump.row not in wrap.rows]
        clean = despike(clean, name, width, threshold)[0] if marked else clean
    ends = [t0 + (b - a) * data.dt for t0, a, b in zip(data.start_times, data.starts, data.stops, strict=True)]
    return DataReport(
        name=data.name,
        dt=data.dt,
        samples=data.n_samples,
        duration=data.duration,
        gaps=tuple(max(begin - end, 0.0) for end, begin in zip(ends, data.start_times[1:], strict=False)),
        spikes=tuple(sorted(spikes, key=lambda s: s.row)),
        jumps=tuple(sorted(jumps, key=lambda j: j.row)),
        dropouts=tuple(d for n in data.names if (d := find_dropouts(data, n))),
        delays=_delays(clean),
        offsets=_offsets(clean),
        stretches=tuple(s for n in data.names if (s := _stretch(data, n))),
        clippings=tuple(c for n in data.names for c in _clippings(data, n)),
        resolutions=tuple(r for n in data.names if (r := _resolution(data, n)).sentence),
        wraps=tuple(turns),
        excitations=tuple(_excitation(clean, n) for n in data.inputs),
        notes=data.notes,
    )


def _moves(x: np.ndarray) -> bool:
    return float(np.ptp(x)) > 1e-12 * max(1.0, float(np.abs(x).max()))


def _delays(data: Dataset) -> tuple[Delay, ...]:
    """Of every pair that physics ties together; a single one that says why where the data are too short."""
    delays = []
    for i in data.inputs:
        for o in data.outputs:
            if (i in _SPEED and o in MOTION) or (i in STEERING and o in _SPEED):
                continue  # the speed scales what steering does, it makes no car turn
            try:
                delays.append(estimate_delay(data, i, o))
            except ExcitationError:
                continue  # told by the excitation
            except TooShortError as error:
                none = Delay(input=i, output=o, seconds=0.0, agreement=0.0, coherent=0.0, reason=str(error))
                return (none,)
    return tuple(delays)


def _offsets(data: Dataset) -> tuple[Offset, ...]:
    """Channels that should be zero on the straight: their means there, with the error of the mean."""
    turning = [n for n in _STRAIGHT_BY if n in data]
    if not turning:
        return ()
    straight = np.all([_small(data, n) for n in turning], axis=0)
    if "v_x" in data:
        straight &= data["v_x"] > _STANDING * np.quantile(data["v_x"], _MOST)
    lasting = [(a, b) for a, b in runs(data, straight) if (b - a) * data.dt >= _SETTLED]
    straight = np.zeros(len(straight), dtype=bool)
    for a, b in lasting:
        straight[a:b] = True
    if straight.sum() < max(20, round(1 / data.dt)):
        return ()
    count = len(lasting)  # samples side by side tell the same
    offsets = []
    for name in ("delta", "delta_sw", "v_y", "beta", "steering"):
        if name in data and _moves(data[name]):
            x = data[name][straight]
            value, error = float(np.median(x)), float(x.std() / np.sqrt(count))
            samples = int(straight.sum())
            offsets.append(Offset(channel=name, value=value, error=error, samples=samples, unit=data.unit(name)))
    return tuple(offsets)


def _small(data: Dataset, name: str) -> np.ndarray:
    """Where the mean of a channel about each sample is a small share of its largest."""
    n = max(round(_SMOOTH / data.dt), 1)
    means = [uniform_filter1d(part[name], n, mode="nearest") for part in data.experiments]
    return np.abs(np.concatenate(means)) < _STRAIGHT * np.quantile(np.abs(data[name]), _MOST)


def resting(data: Dataset, name: str) -> list[tuple[int, int]]:
    """Rows (start, stop) over which a channel does not change, at least two samples long."""
    same = [np.append(np.diff(part[name]) == 0, False) for part in data.experiments]
    return [(a, b + 1) for a, b in runs(data, np.concatenate(same))]


def _stretch(data: Dataset, name: str) -> Stretch | None:
    if not _moves(data[name]):
        return None
    long = [(a, b) for a, b in resting(data, name) if (b - a) * data.dt > _HELD]
    if not long:
        return None
    a, b = max(long, key=lambda r: r[1] - r[0])
    value = float(data[name][a]) + 0.0
    return Stretch(
        channel=name, t=float(data.t[a]), duration=(b - a) * data.dt, value=value, count=len(long), unit=data.unit(name)
    )


def _clippings(data: Dataset, name: str) -> list[Clipping]:
    x = data[name]
    if len(np.unique(x)) <= _FEW_LEVELS:
        return []
    clippings = []
    rests = [(a, b) for a, b in resting(data, name) if b - a >= 5]
    for value in (float(x.max()), float(x.min())):
        rows = sum(b - a for a, b in rests if x[a] == value)
        visits = sum(1 for a, _ in rests if x[a] == value)
        if value != 0.0 and visits >= 3 and rows > 1e-3 * len(x):
            clippings.append(Clipping(channel=name, value=value, share=rows / len(x), unit=data.unit(name)))
    return clippings


def _resolution(data: Dataset, name: str) -> Resolution:
    """Quantisation (if the levels are evenly spaced and few) and repeated samples."""
    x = data[name]
    step = level_step(x)
    repeats = _repeats(data, name) if _moves(x) and not step else 0.0
    return Resolution(channel=name, step=step, repeats=repeats, unit=data.unit(name), rate=1 / data.dt)


def _repeats(data: Dataset, name: str) -> float:
    """Share of the samples that repeat the one before; 0 if they do so far less where the channel moves fastest.

    There a sample that is held until the next one comes repeats as often as anywhere, one that is rounded does not.
    """
    half, still, moved = max(round(_ACROSS / data.dt), 3), list[np.ndarray](), list[np.ndarray]()
    for part in data.experiments:
        x = part[name]
        if len(x) > 2 * half:
            moved.append(np.abs(x[2 * half :] - x[: -2 * half]))
            still.append(np.diff(x)[half - 1 : -half] == 0)
    if not moved:
        return 0.0
    moves, same = np.concatenate(moved), np.concatenate(still)
    rests = sum(b - a - 1 for a, b in resting(data, name) if (b - a) * data.dt > 0.2)
    all_still = sum(int((np.diff(part[name]) == 0).sum()) for part in data.experiments)
    share = (all_still - rests) / max(sum(len(part) - 1 for part in data.experiments) - rests, 1)
    return share if np.mean(same[moves >= np.quantile(moves, _FASTEST)]) > _AS_OFTEN * share else 0.0


def _excitation(data: Dataset, name: str) -> Excitation:
    x = data[name]
    power, f = 0.0, np.zeros(1)
    n = min(data.n_longest, max(round(30 / data.dt), 8))
    for part in data.experiments:
        if len(part) >= n and n > 3:
            f, p = scipy.signal.welch(part[name], fs=1 / data.dt, nperseg=n, detrend="constant")
            power = power + p * len(part)
    total = np.cumsum(np.atleast_1d(power))
    bandwidth = float(f[np.searchsorted(total, 0.95 * total[-1])]) if total[-1] > 0 else 0.0
    low, high, std = (float(v) for v in (x.min(), x.max(), x.std()))
    return Excitation(channel=name, low=low, high=high, std=std, bandwidth=bandwidth, unit=data.unit(name))
