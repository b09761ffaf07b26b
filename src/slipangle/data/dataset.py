"""`Dataset`: uniformly sampled recordings of named channels with units."""

# Long: the record that every room takes is read as a whole, and half of it are docstrings.
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from math import isclose
from numbers import Integral, Real
from typing import Self

import numpy as np

from slipangle import units as unit_table
from slipangle.data.channels import STANDARD
from slipangle.data.clock import at_rate
from slipangle.data.frames import InFrames
from slipangle.data.headings import continued, wrap_note
from slipangle.data.holds import held
from slipangle.equal import Equal
from slipangle.errors import (
    MissingColumnError,
    NotFiniteError,
    ParameterError,
    SampleTimeError,
    TooShortError,
    UnitError,
    nearest,
    shown,
)
from slipangle.shown import Brief, Shown

_MOST = 100_000_000  # samples that resampling makes; with ten channels 8 GB

MEANS, HELD = "inputs are means over each sample interval", "inputs are held for a sample"  # notes of `hold_...`
BETWEEN = "what is between the samples is interpolated, not measured; sample time before: "  # note of `resample`, and s
_FASTER = 1.02  # a rate that is higher by more is no clock that is off


@dataclass(frozen=True)
class Channel(Brief):
    """Name and SI unit of one column."""

    name: str
    unit: str = "-"


@dataclass(frozen=True, kw_only=True)
class Dataset(InFrames, Shown, Equal):
    """One or several recordings ("experiments") of the same channels at one sample time.

    Experiments are stored one after another; `experiments` gives each as a data set of its own.
    A gap in a log ends one experiment and starts the next: nothing is interpolated across it.

    Raises NotFiniteError or MissingColumnError if a value is NaN or infinite, or an input or output is not a channel,
    UnitError if a channel's unit is known and not SI, ParameterError or SampleTimeError if counts of columns, names or
    experiments do not match, a name repeats, or the sample time is not positive.

    Parameters
    ----------
    values, channels
        All samples, shape (n_samples, n_channels), SI units, finite; one `Channel` per column.
    dt : float
        Sample time. [s]
    inputs, outputs : sequence of str
        Which channels drive the system and which are to be explained, in order. The others ride along.
    starts, start_times
        Row at which each experiment starts, the first being 0, and the time of that sample. [s]
    name, notes
        What the data are, what was done to them and what was seen in them; for reports.
    """

    values: np.ndarray
    channels: tuple[Channel, ...]
    dt: float
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    name: str = "data"
    starts: tuple[int, ...] = (0,)
    start_times: tuple[float, ...] = (0.0,)
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        values = np.asarray(without_mask(self.values), dtype=float)
        if values.flags.writeable:
            values = values.copy()  # the caller's array stays the caller's
        if values.ndim == 1:
            values = values[:, None]
        object.__setattr__(self, "values", values)
        for key in ("channels", "inputs", "outputs", "starts", "start_times", "notes"):
            given = getattr(self, key)
            object.__setattr__(self, key, (given,) if isinstance(given, str) else tuple(given))
        if values.shape[1] != len(self.channels):
            raise ParameterError(
                f"the data have {values.shape[1]} columns but {len(self.channels)} channel names; expected one "
                "name per column: give a Channel for each"
            )
        if len(set(self.names)) != len(self.names):
            raise ParameterError(f"channel names repeat in {list(self.names)}; expected each once: rename one")
        for channel in self.channels:
            _require_si(channel)
        if not isinstance(self.dt, Real) or not self.dt > 0:
            raise SampleTimeError(f"the sample time is {self.dt!r} s; expected a positive number: check the clock")
        if len(self.starts) != len(self.start_times):
            raise ParameterError(
                f"{len(self.starts)} starts but {len(self.start_times)} start times; expected one time per experiment"
            )
        self._check_starts(len(values))
        for name in (*self.inputs, *self.outputs):
            self.index(name)
        if not np.isfinite(values).all():
            row, column = np.argwhere(~np.isfinite(values))[0]
            count = int((~np.isfinite(values[:, column])).sum())
            raise NotFiniteError(
                f"channel '{self.names[column]}' holds {count} NaN or infinite samples, the first at sample {row}; "
                "expected finite numbers: cut that stretch (it then becomes a gap) or repair the log"
            )
        values.setflags(write=False)

    def _check_starts(self, n: int) -> None:
        if n == 0:
            raise TooShortError(f"'{self.name}' holds no sample; expected at least one: check what was cut away")
        edges = (*self.starts, n)
        if not self.starts or self.starts[0] != 0 or any(b <= a for a, b in pairwise(edges)):
            raise ParameterError(
                f"'{self.name}' has {n} samples and experiments starting at rows {list(self.starts)[:12]}; "
                f"expected rising rows from 0 to below {n}: give the first row of each experiment"
            )

    @classmethod
    def from_arrays(
        cls,
        inputs: Mapping[str, np.ndarray],
        outputs: Mapping[str, np.ndarray],
        dt: float,
        *,
        extra: Mapping[str, np.ndarray] | None = None,
        units: Mapping[str, str] | None = None,
        name: str = "data",
    ) -> Self:
        """One experiment from one array per channel, shape (n_samples,), already in SI units.

        ``extra`` are channels that are neither input nor output. ``units`` name the SI units, and convert nothing; by
        default those of the nomenclature, "-" for other names. Raises ParameterError if lengths differ, a name repeats,
        channels come without names, or one is no row of real numbers, UnitError if a unit is known and not SI,
        NotFiniteError if samples are missing, masked ones among them.

        >>> data = Dataset.from_arrays({"delta": np.zeros(5)}, {"r": np.ones(5)}, 0.1)
        >>> data.n_samples, data.u.shape
        (5, (5, 1))
        """
        for what, given in {"inputs": inputs, "outputs": outputs, "extra": extra or {}}.items():
            if not hasattr(given, "keys"):
                raise ParameterError(
                    f"{what} is a {type(given).__name__}; expected channels by name, such as {{'delta': array}}"
                )
        names = [*inputs, *outputs, *(extra or {})]
        if twice := sorted({n for n in names if names.count(n) > 1}):
            raise ParameterError(f"channels {twice} are given twice; expected each as input, output or extra: rename")
        columns = {n: real_row(n, c) for n, c in {**inputs, **outputs, **(extra or {})}.items()}
        lengths = {len(c) for c in columns.values()}
        if len(lengths) > 1:
            raise ParameterError(f"channels have lengths {sorted(lengths)}; expected one length: cut them alike")
        known = {n: STANDARD[n].unit for n in columns if n in STANDARD} | {**(units or {})}
        return cls(
            values=np.column_stack(list(columns.values())),
            channels=tuple(Channel(n, known.get(n, "-")) for n in columns),
            dt=dt,
            inputs=tuple(inputs),
            outputs=tuple(outputs),
            name=name,
        )

    # ---- looking -----------------------------------------------------------------------------------------------

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Channel names, in column order."""
        return tuple(c.name for c in self.channels)

    def _words(self) -> str:
        return f"{self.n_samples} samples of {', '.join(self.names[:8])} at {1 / self.dt:g} Hz, {self.duration:.4g} s"

    @property
    def n_samples(self) -> int:
        """Samples of all experiments together."""
        return len(self.values)

    @property
    def n_longest(self) -> int:
        """Samples of the longest experiment."""
        return max(b - a for a, b in zip(self.starts, self.stops, strict=True))

    @property
    def duration(self) -> float:
        """Length of all experiments together. [s]"""
        return self.n_samples * self.dt

    @property
    def stops(self) -> tuple[int, ...]:
        """Row after the last of each experiment."""
        return (*self.starts[1:], self.n_samples)

    @cached_property
    def t(self) -> np.ndarray:
        """Time of every sample, shape (n_samples,). [s]"""
        t = np.empty(self.n_samples)
        for t0, a, b in zip(self.start_times, self.starts, self.stops, strict=True):
            t[a:b] = np.arange(b - a)
            t[a:b] *= self.dt
            t[a:b] += t0
        t.setflags(write=False)
        return t

    @property
    def u(self) -> np.ndarray:
        """Inputs, shape (n_samples, n_inputs)."""
        return self.values[:, [self.index(n) for n in self.inputs]]

    @property
    def y(self) -> np.ndarray:
        """Outputs, shape (n_samples, n_outputs)."""
        return self.values[:, [self.index(n) for n in self.outputs]]

    def columns(self, names: Sequence[str]) -> np.ndarray:
        """Samples of some channels, shape (n_samples, n_names); a view to be read only where they are neighbours."""
        indices = [self.index(n) for n in names]
        if indices and indices == list(range(indices[0], indices[0] + len(indices))):
            return self.values[:, indices[0] : indices[0] + len(indices)]
        return self.values[:, indices]

    def index(self, name: str) -> int:
        """Column of a channel; a MissingColumnError gives the nearest names where there is none.

        Raises ParameterError if it is no name.
        """
        if not isinstance(name, str):
            raise ParameterError(
                f"'{self.name}' has no channel {name!r}; expected a channel's name: samples are data.rows(start, stop)"
            )
        try:
            return self.names.index(name)
        except ValueError:
            raise MissingColumnError(
                f"'{self.name}' has no channel '{name}'; {nearest(name, self.names)}: use one of these names"
            ) from None

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __getitem__(self, name: str) -> np.ndarray:
        """Samples of one channel, shape (n_samples,)."""
        return self.values[:, self.index(name)]

    def unit(self, name: str) -> str:
        """Unit of a channel."""
        return self.channels[self.index(name)].unit

    @property
    def experiments(self) -> tuple[Self, ...]:
        """Each experiment as a data set of its own."""
        return tuple(
            replace(self, values=self.values[a:b], starts=(0,), start_times=(t0,))
            for t0, a, b in zip(self.start_times, self.starts, self.stops, strict=True)
        )

    def __iter__(self) -> Iterator[Self]:
        return iter(self.experiments)

    def __len__(self) -> int:
        return self.n_samples

    @property
    def dt_recorded(self) -> float:
        """Sample time before `resample` interpolated between the samples; `dt` where it did not. [s]"""
        before = [float(n.removeprefix(BETWEEN).split()[0]) for n in self.notes if n.startswith(BETWEEN)]
        return max([self.dt, *before[:1]])

    # ---- making new ones ---------------------------------------------------------------------------------------

    def select(self, *, inputs: Sequence[str] | None = None, outputs: Sequence[str] | None = None) -> Self:
        """The same samples with other inputs and outputs."""
        others = {"inputs": inputs, "outputs": outputs}
        return replace(self, **{key: tuple(names) for key, names in others.items() if names is not None})

    def with_channel(self, name: str, values: np.ndarray, unit: str = "-") -> Self:
        """The data with one channel added or replaced: ``values``, shape (n_samples,), SI units.

        Raises ParameterError if they are no real numbers, or more or fewer than samples.
        """
        column, n = real_row(name, values)[:, None], self.n_samples
        if len(column) != n:
            raise ParameterError(f"channel '{name}' has {len(column)} samples, the data have {n}; expected the same")
        if name in self:
            i = self.index(name)
            table = self.values.copy()
            table[:, i] = column[:, 0]
            channels = (*self.channels[:i], Channel(name, unit), *self.channels[i + 1 :])
        else:
            table = np.hstack([self.values, column])
            channels = (*self.channels, Channel(name, unit))
        return replace(self, values=table, channels=channels)

    def with_note(self, note: str) -> Self:
        """The data with one more line in `notes`: ``note``."""
        return replace(self, notes=(*self.notes, note))

    def head(self, n: int) -> Self:
        """The first ``n`` samples of a single experiment, all of one that is shorter.

        Raises ParameterError if there are several, or ``n`` is no whole number of at least 1.
        """
        if len(self.starts) > 1:
            raise ParameterError("head() of several experiments is ambiguous: take it of one of data.experiments")
        if not isinstance(n, Integral) or n < 1:
            raise ParameterError(f"head() got {n!r}; expected a whole number of samples of at least 1")
        return replace(self, values=self.values[:n])

    def rows(self, start: int, stop: int) -> Self:
        """Samples ``start`` to ``stop`` (exclusive); experiment borders inside stay borders.

        Raises TooShortError if there is none among them, or the record does not have them all, ParameterError if they
        are no whole numbers.
        """
        if not (isinstance(start, Integral) and isinstance(stop, Integral)):
            raise ParameterError(
                f"rows {start!r} to {stop!r} of '{self.name}' are no samples; expected whole numbers: divide times by "
                f"the sample time, {self.dt:g} s"
            )
        if not 0 <= start < stop <= self.n_samples:
            what = "hold no sample" if stop <= start else "are not all in the record"
            raise TooShortError(
                f"rows {start} to {stop} of '{self.name}' {what}; expected 0 <= start < stop <= {self.n_samples}: "
                "count from its first sample, and at most to n_samples"
            )
        parts = [
            (max(a, start), min(b, stop), t0 + (max(a, start) - a) * self.dt)
            for t0, a, b in zip(self.start_times, self.starts, self.stops, strict=True)
            if a < stop and b > start
        ]
        return replace(
            self,
            values=self.values[start:stop],
            starts=tuple(a - start for a, _, _ in parts),
            start_times=tuple(t0 for _, _, t0 in parts),
        )

    def split(self, fraction: float) -> tuple[Self, Self]:
        """The first ``fraction`` of the samples for training, the rest for testing; never mixed.

        Raises ParameterError if the fraction is not between 0 and 1, TooShortError if a side has fewer than 2 samples.

        >>> train, test = Dataset.from_arrays({"u": np.zeros(10)}, {"y": np.zeros(10)}, 0.1).split(0.7)
        >>> train.n_samples, test.n_samples, round(float(test.t[0]), 9)
        (7, 3, 0.7)
        """
        if not (isinstance(fraction, Real) and 0 < fraction < 1):
            raise ParameterError(
                f"the training share is {shown(fraction)}; expected a number between 0 and 1, such as 0.7"
            )
        n = round(fraction * self.n_samples)
        if n < 2 or self.n_samples - n < 2:
            raise TooShortError(
                f"'{self.name}' has {self.n_samples} samples, a split at {fraction} leaves {n} and "
                f"{self.n_samples - n}; expected at least 2 on each side: record longer or move the split"
            )
        return self.rows(0, n), self.rows(n, self.n_samples)

    def unwrapped(self) -> Self:
        """The data with headings that go on after a full turn, where they were logged from -pi to pi, or 0 to 2 pi.

        Headings are channels called psi, heading, yaw, course and the like, in rad. In each experiment leaps of more
        than pi between neighbouring samples lose their whole turns, and a note says so; the very same data where there
        are none. What interpolates or averages does this first, and models integrate a heading so.

        >>> psi = np.array([3.0, 3.1, -3.1, -3.0])
        >>> Dataset.from_arrays({}, {"psi": psi}, 0.1, units={"psi": "rad"}).unwrapped()["psi"].round(2).tolist()
        [3.0, 3.1, 3.18, 3.28]
        """
        unit_of, tables, wrapped = [c.unit for c in self.channels], list[np.ndarray](), list[str]()
        for a, b in zip(self.starts, self.stops, strict=True):
            table, found = continued(self.values[a:b], self.names, unit_of)
            tables.append(table)
            wrapped += found
        if not wrapped:
            return self
        return replace(self, values=np.vstack(tables), notes=(*self.notes, *wrap_note(wrapped)))

    def resample(self, dt: float, *, cutoff: float | None = None) -> Self:
        """Another sample time, with a zero-phase anti-alias filter first.

        ``dt`` is the new sample time [s], ``cutoff`` the corner frequency of the low-pass [Hz]; by default 0.4 of the
        new sample rate when slowing down, else none.

        Fourth-order Butterworth run forwards and backwards, then interpolation to the new instants (cubic after the
        low-pass, where the record is smooth; linear otherwise, which never overshoots a step), inside each experiment.
        Forwards and backwards halve the amplitude at the corner and keep the phase; a filtered record must not be used
        to measure causality. Headings are `unwrapped` first. Raises SampleTimeError if ``dt`` is not positive or makes
        too many samples, ParameterError if the corner is not between 0 and half the sample rate.
        """
        if not dt > 0:
            raise SampleTimeError(f"the new sample time is {dt} s; expected a positive number")
        slower = dt > self.dt * (1 + 1e-9)
        corner = cutoff if cutoff is not None else (0.4 / dt if slower else None)
        if corner is not None and not 0 < corner < 0.5 / self.dt:
            raise ParameterError(
                f"the filter corner is {corner} Hz; expected between 0 and half the sample rate, {0.5 / self.dt:g} Hz"
            )
        rows = self.n_samples * self.dt / dt
        if rows > _MOST:
            raise SampleTimeError(
                f"resampling '{self.name}' from {self.dt:g} to {dt:g} s makes {rows:.3g} samples; expected at most "
                f"{_MOST:.0e}: choose a longer sample time, and check the unit of the log's time"
            )
        data = self.unwrapped()
        pieces = [at_rate(part.values, self.dt, dt, corner) for part in data.experiments]
        starts = tuple(np.cumsum([0, *map(len, pieces[:-1])]).tolist())
        how = "" if isclose(dt, self.dt) else f"resampled from {1 / self.dt:g} to {1 / dt:g} Hz"
        if corner is not None:
            how += f"{' after a' if how else 'a'} zero-phase low-pass at {corner:g} Hz"
        said = [how] if how else []
        if self.dt > _FASTER * dt:
            said.append(f"{BETWEEN}{self.dt:.12g} s")
        return replace(self, values=np.vstack(pieces), dt=dt, starts=starts, notes=(*data.notes, *said))

    def hold_mean(self) -> Self:
        """Each input as its mean over the interval to the next sample, instead of its value at the sample.

        A `Model` holds its inputs for a sample; a logged input goes on moving meanwhile. The sampled value makes the
        model late by half a sample, which an identification takes for lag of the vehicle. The mean of both ends does
        not, but with the hold it smooths fast motion, which looks like less lag and more delay: the mean is that of the
        input sharpened by as much, to sixth order in frequency. An end at which an input rests is never left. Not for
        inputs that a controller held. Headings are `unwrapped` first.
        """
        data = self.unwrapped()
        table = data.values.copy()
        for a, b in zip(self.starts, self.stops, strict=True):
            for name in self.inputs:
                table[a : b - 1, self.index(name)] = held(data.values[a:b, self.index(name)])
        return replace(data, values=table, notes=(*data.notes, MEANS))

    def hold_sample(self) -> Self:
        """The same data, whose user says that each input was held until the next sample, as a controller holds it.

        Intervals of a `GreyBox` then need not take in inputs that go on between the samples.
        """
        return self.with_note(HELD)

    def detrend(self, offsets: Mapping[str, float] | None = None) -> tuple[Self, dict[str, float]]:
        """Subtract offsets from inputs and outputs, by default their means; gives what was subtracted, too. [SI]

        Give the training data's offsets to treat test data alike. Headings are `unwrapped` first.
        """
        data, names = self.unwrapped(), (*self.inputs, *self.outputs)
        used = dict(offsets) if offsets is not None else {n: float(data[n].mean()) for n in names}
        table = data.values.copy()
        for name, value in used.items():
            table[:, self.index(name)] -= value
        return replace(data, values=table), used

    def require_dt(self, dt: float, who: str = "the model") -> None:
        """Raise a SampleTimeError if the data's sample time differs by more than 1e-6 of ``dt``; ``who`` asks."""
        if not isclose(self.dt, dt, rel_tol=1e-6):
            raise SampleTimeError(
                f"'{self.name}' is sampled at {self.dt:g} s, {who} works at {dt:g} s; expected the same: "
                f"use data.resample({dt:g})"
            )


def require_dataset(data: object, who: str, fix: str = "read() a log, or make one by Dataset.from_arrays()") -> None:
    """Raise a ParameterError unless it is a `Dataset`; ``who`` got it."""
    if not isinstance(data, Dataset):
        raise ParameterError(f"{who} {type(data).__name__}; expected a Dataset: {fix}")


def _require_si(channel: Channel) -> None:
    """Raise a UnitError if a channel's numbers are in another unit than SI by its own words; what is no unit may stand.

    Nobody converts after this: degrees would count as radians everywhere.
    """
    unit = channel.unit
    if not isinstance(unit, str):
        raise UnitError(f"the unit of channel '{channel.name}' is {shown(unit)}; expected text, such as 'm/s' or '-'")
    if unit_table.known(unit) and unit_table.canonical(unit) != unit_table.si_unit(unit):
        raise UnitError(
            f"channel '{channel.name}' is in {shown(unit)}; expected SI units, {shown(unit_table.si_unit(unit))}: give "
            f"slipangle.units.to_si(values, {shown(unit)}), or let from_frame() convert a column called "
            f"'{channel.name} [{unit}]'"
        )


def real_row(name: str, values: object) -> np.ndarray:
    """Numbers of a channel, shape (n_samples,), NaN where they are masked; raises ParameterError if they are none."""
    try:
        array = np.asarray(without_mask(values))
        found = array.astype(float) if not np.iscomplexobj(array) else None
    except (TypeError, ValueError):
        found = None
    if found is not None and found.ndim and found.size == len(found):
        return found.reshape(-1)
    kinds = np.array(values, dtype=object)
    what = f"holds {kinds.flat[0]!r}" if found is None and kinds.size else f"has the shape {kinds.shape}"
    raise ParameterError(f"channel '{name}' {what}; expected one real number a sample: an array of shape (n_samples,)")


def without_mask(values: object) -> object:
    """The same with NaN (NaT of times) where a masked array masks it."""
    if not np.ma.isMaskedArray(values):
        return values
    array = np.ma.asarray(values)
    if array.dtype.kind in "mM":
        return np.where(np.ma.getmaskarray(array), np.array("NaT", array.dtype), array.data)
    return array.astype(np.result_type(array.dtype, float)).filled(np.nan)


def join(*parts: Dataset, name: str | None = None) -> Dataset:
    """Several data sets, ``parts``, as experiments of one.

    Channels that the first has not are left out, which a note says.

    Raises ParameterError, SampleTimeError, MissingColumnError or UnitError if there is nothing to join, or the sample
    times, channels or units differ.
    """
    if not parts:
        raise ParameterError("join() got no data sets; expected at least one: pass them one after another")
    for part in parts:
        require_dataset(part, "join() got", "pass data sets one after another, a list of them as join(*parts)")
    first = parts[0]
    tables, starts, times, notes, row = [], [], [], list(first.notes), 0
    for part in parts:
        part.require_dt(first.dt, f"'{first.name}'")
        for channel in first.channels:
            if "-" not in (given := part.unit(channel.name), channel.unit) and given != channel.unit:
                raise UnitError(
                    f"channel '{channel.name}' is in '{given}' in '{part.name}' and in "
                    f"'{channel.unit}' in '{first.name}'; expected one unit: convert one of them to SI when reading"
                )
        tables.append(np.column_stack([part[n] for n in first.names]))
        starts += [row + s for s in part.starts]
        times += part.start_times
        notes += [n for n in part.notes if n not in notes]
        if more := [n for n in part.names if n not in first.names]:
            said = f"without {', '.join(more[:12])} of '{part.name}', which '{first.name}' has not"
            notes += [said] if said not in notes else []
        row += part.n_samples
    return replace(
        first,
        values=np.vstack(tables),
        starts=tuple(starts),
        start_times=tuple(times),
        name=name or first.name,
        notes=tuple(notes),
    )
