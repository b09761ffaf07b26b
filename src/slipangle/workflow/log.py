"""The logs of a job: read, laid out one after another, conditioned, and parted into training and test."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from glob import glob
from pathlib import Path

import numpy as np

from slipangle import Dataset, public, read
from slipangle.data.dataset import join
from slipangle.data.quality.events import despike
from slipangle.errors import ConfigError, MissingFileError, ParameterError, shown
from slipangle.identify.car.recordings import settled
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.provenance import fingerprint, overlap
from slipangle.models.vehicles.nonlinear_bicycle import with_speed_derivative
from slipangle.report.tables import number
from slipangle.workflow.entries import OtherLogs
from slipangle.workflow.kinds import named_logs
from slipangle.workflow.settings import Settings

_FEWEST, _CELLS = 20, 5e8  # samples of the longest record after resampling, and numbers of all
_CRUMB, _MOST = 1.0, 0.8  # s of a piece that is left out, where so much of the log is whole
_SAME_CLOCK = 1.02  # largest over smallest sample time of files from one logger
_APART = 1.0  # s between files on the time axis that they share
_LONGEST_NAME = 80
_CAR = {"mass", "wheelbase", "l_f"}  # parameters of those models of which it is known what is ordinary


@dataclass(frozen=True, kw_only=True)
class Logs:
    """What a job identifies from and judges on.

    ``raw`` is all of it as it is in the files, in SI units; ``data`` the same as identified from, ``train``,
    ``opening`` and ``test`` its parts. Several files are experiments on one time axis, one file after another. From the
    opening models read what is that day's own. ``others`` are the logs that models name, such as what a saved one was
    fitted to.
    """

    raw: Dataset
    data: Dataset
    train: Dataset
    test: Dataset
    opening: Dataset | None = None
    others: Mapping[OtherLogs, Dataset] = field(default_factory=dict)


def read_logs(settings: Settings) -> Logs:
    """The logs of a job; ``train`` and ``test`` are parts of one log, or the files that the job names for each.

    Raises SlipangleError for every kind of bad input, with the file, channel or entry at fault.
    """
    first, second = _files(settings)
    if second is None:
        data = condition(first, settings)
        train, test = _parted(first, data, settings)
        opening, test = opened(test, settings)
        others = _others(settings, data)
        return Logs(raw=first, data=data, train=train, test=test, opening=opening, others=others)
    _require_apart(first, second)
    train, test = condition(first, settings), condition(second, settings)
    name = _together((first, second))
    raw, data = join(first, second, name=name), join(train, test, name=name)
    opening, test = opened(test, settings)
    return Logs(raw=raw, data=data, train=train, test=test, opening=opening, others=_others(settings, data))


def _parted(raw: Dataset, data: Dataset, settings: Settings) -> tuple[Dataset, Dataset]:
    """Training and test part of one log, conditioned as ``data``.

    A low-pass that runs both ways, and a derivative, carry rows into those before them: what is trained on is
    conditioned without what is judged on.
    """
    train, test = data.split(settings.data.train)
    if not (np.diff(raw.t) > 0).all():  # no time tells the row
        return train, test
    rows = int(np.searchsorted(raw.t, test.t[0] - 1e-6 * raw.dt))
    return _conditioned(raw.rows(0, rows), settings), test


def _require_apart(train: Dataset, test: Dataset) -> None:
    """Raise a ParameterError if rows of the files for testing are in the others, too.

    As logged: samples that fall between the others' after resampling are none that a model was fitted to.
    """
    shared = overlap(fingerprint(train, train.outputs), test) if train.outputs else None
    if shared is not None:
        raise ParameterError(
            f"{int(shared.rows.sum())} of {test.n_samples} rows of '{test.name}' (from t = "
            f"{float(test.t[np.argmax(shared.rows)] - test.t[0]):.6g} s of it), which is to test, are rows of "
            f"'{train.name}', too; expected another drive: name one, or leave out test and part the log by train"
        )


def _others(settings: Settings, data: Dataset) -> dict[OtherLogs, Dataset]:
    """The logs that models name, read and conditioned like the job's own ``data``.

    Raises ConfigError if they are at another sample time, and MissingColumnError if they lack a channel.
    """
    found: dict[OtherLogs, Dataset] = {}
    for model in settings.model:
        for key, files in named_logs(model.entries).items():
            if files not in found:
                parts = _one_clock([_read(f, settings) for f in _found(files, settings)], settings.data.rate)
                other = condition(_joined(parts), settings)
                found[files] = other.select(inputs=data.inputs, outputs=data.outputs)
            other = found[files]
            if not math.isclose(other.dt, data.dt, rel_tol=1e-6):
                raise ConfigError(
                    f"model {shown(model.name)}: {key} '{other.name}' is sampled every {other.dt:g} s, the job's log "
                    f"every {data.dt:g} s; expected one sample time: give [data] a rate that both are resampled to"
                )
    return found


def opened(test: Dataset, settings: Settings) -> tuple[Dataset | None, Dataset]:
    """The opening of a test record and the rest, which is judged on; none where the job asks for none.

    Raises ConfigError if nothing is left.
    """
    wanted = settings.data.opening
    if wanted is None:
        return None, test
    n = round(wanted / test.dt)
    if not 1 < n < test.n_samples - _FEWEST:
        raise ConfigError(
            f"[data] opening is {wanted:g} s of a test record of {test.duration:.4g} s; expected two samples or more, "
            "and some of the record left to judge on: give fewer seconds"
        )
    return test.rows(0, n), test.rows(n, test.n_samples)


def as_of_the_day(model: Model, opening: Dataset | None) -> Model:
    """The model with what differs between recordings as it is in this one, read from its opening.

    What it read stands in its ``fit_info.corrections``; a model without such parameters comes back as it is.
    """
    info = model.fit_info
    if opening is None or not isinstance(model, Parametrised) or info is None:
        return model
    names = tuple(dict.fromkeys(n.partition("[")[0] for n in info.names if n.endswith("]")))
    if not names or not _CAR <= set(model.parameter_names):
        return model
    own = settled(model, opening, opening.duration)
    read = ", ".join(f"{n} {number(model.value(n))} -> {number(own.value(n))} {model.si(n).unit}" for n in names)
    said = f"read from the first {opening.duration:.3g} s of '{opening.name}', which no score counts: {read}"
    return replace(own, fit_info=replace(info, corrections=(*info.corrections, said)))


def load_data(settings: Settings) -> Dataset:
    """All logs of a job as they are, in SI units."""
    first, second = _files(settings)
    return first if second is None else join(first, second, name=_together((first, second)))


def _files(settings: Settings) -> tuple[Dataset, Dataset | None]:
    """The log, and the separate test log where the job names one, on one time axis."""
    wanted = settings.data
    if wanted.set:
        data = public(wanted.set)
        return data.select(inputs=wanted.inputs or data.inputs, outputs=wanted.outputs or data.outputs), None
    apart = _found(wanted.test, settings)
    if wanted.opening is not None and len(apart) > 1:
        raise ConfigError(
            f"[data] has an opening and {len(apart)} test files; expected one, as each day has offsets of its own: "
            "give each a job"
        )
    own = [file for file in _found(wanted.file, settings) if file not in apart]
    if not own:
        raise ConfigError("[data] names no file that is not a test file; expected some to identify from: add one")
    parts = _one_clock([_read(file, settings) for file in (*own, *apart)], wanted.rate)
    first = _joined(parts[: len(own)])
    if not apart:
        return first, None
    return first, _laid_out([first, _joined(parts[len(own) :])])[1]


def _found(names: Sequence[str], settings: Settings) -> list[Path]:
    """Files by their names, relative to the job, each once; those that a pattern matches in the order of their names.

    Raises MissingFileError if a pattern matches none.
    """
    found: dict[Path, None] = {}
    for name in names:
        name, path = _slashed(name, settings.folder)
        if path.exists() or not any(letter in name for letter in "*?["):
            found[path] = None
            continue
        matches = [Path(p) for p in sorted(glob(str(path), recursive=True)) if Path(p).is_file()]
        if not matches:
            raise MissingFileError(
                f"no file matches {shown(name)} in '{settings.folder}'; expected at least one: correct the pattern"
            )
        found |= dict.fromkeys(matches)
    return list(found)


def _slashed(name: str, folder: Path) -> tuple[str, Path]:
    """A file as a job names it, and where it is; backslashes of a job from Windows part folders anywhere."""
    if "\\" in name and not (folder / name).exists():
        name = name.replace("\\", "/")
    return name, folder / name


def _read(file: Path, settings: Settings) -> Dataset:
    wanted = settings.data
    try:
        columns = {name: c.to_column() for name, c in wanted.columns.items()} or None
        time = wanted.time.to_column() if wanted.time is not None else None
    except ParameterError as error:
        raise ConfigError(f"[data.columns]: {error}") from None
    return read(
        file,
        columns=columns,
        beside=[_slashed(other, settings.folder)[1] for other in wanted.beside],
        time=time,
        dt=wanted.dt,
        inputs=wanted.inputs,
        outputs=wanted.outputs,
        nan=wanted.nan,
        jitter=wanted.jitter,
        filter=wanted.filter or None,
    )


def _one_clock(parts: Sequence[Dataset], rate: float | None) -> list[Dataset]:
    """Files at the sample time of the fastest: clocks of one logger differ a little, and a job's rate may ask for more.

    Raises ConfigError if they are further apart and the job gives no rate.
    """
    fastest, slowest = min(parts, key=lambda part: part.dt), max(parts, key=lambda part: part.dt)
    if rate is None and slowest.dt > _SAME_CLOCK * fastest.dt:
        raise ConfigError(
            f"'{fastest.name}' is sampled every {fastest.dt:g} s and '{slowest.name}' every {slowest.dt:g} s; expected "
            "one sample time: give [data] a rate that all files are resampled to"
        )
    return [p if math.isclose(p.dt, fastest.dt, rel_tol=1e-6) else p.resample(fastest.dt) for p in parts]


def _joined(parts: Sequence[Dataset]) -> Dataset:
    """Files as experiments of one data set; one file as it is."""
    return parts[0] if len(parts) == 1 else join(*_laid_out(parts), name=_together(parts))


def _laid_out(parts: Sequence[Dataset]) -> list[Dataset]:
    """The same on one time axis: each begins a second after the one before, and a note says when. [s]"""
    placed = [parts[0]]
    for part in parts[1:]:
        begin = float(placed[-1].t[-1]) + _APART
        times = tuple(t0 - part.start_times[0] + begin for t0 in part.start_times)
        moved = replace(part, start_times=times)
        placed.append(moved.with_note(f"'{part.name}' is at t = {begin:.6g} to {float(moved.t[-1]):.6g} s"))
    return placed


def _together(parts: Sequence[Dataset]) -> str:
    names = list(dict.fromkeys(part.name for part in parts))
    said = ", ".join(names)
    return said if len(said) <= _LONGEST_NAME else f"{names[0][:_LONGEST_NAME]} and {len(names) - 1} more"


def _without_crumbs(data: Dataset, filtered: bool) -> Dataset:
    """Without the samples that gaps leave here and there, from which no model can start, and a note of them.

    They are few, or a filter is to leave as many as it does.
    """
    least = max(_FEWEST, round(_CRUMB / data.dt))
    parts = data.experiments
    whole = [part for part in parts if part.n_samples >= least]
    kept = sum(part.n_samples for part in whole)
    if len(whole) == len(parts) or not whole or (kept < _MOST * data.n_samples and not filtered):
        return data
    many = f"{len(parts) - len(whole)} piece{'s' * (len(parts) - len(whole) > 1)} between gaps"
    note = f"{many} of less than {least * data.dt:.3g} s left out, {data.n_samples - kept} samples in all"
    return replace(join(*whole, name=data.name), notes=(*data.notes, note))


def condition(data: Dataset, settings: Settings) -> Dataset:
    """Despiked and resampled as asked; each step leaves a note.

    Raises ConfigError if the rate leaves too few samples, or makes too many.
    """
    rate = settings.data.rate
    if rate is not None and not math.isclose(rate * data.dt, 1.0, rel_tol=1e-9):
        longest = data.n_longest * data.dt
        cells = data.duration * rate * len(data.channels)
        if longest * rate < _FEWEST or cells > _CELLS:
            raise ConfigError(
                f"[data] rate is {rate:g} Hz for a record of {longest:.4g} s and {len(data.channels)} channels; "
                f"expected {_FEWEST / longest:.2g} to {_CELLS / (data.duration * len(data.channels)):.2g} Hz: it was "
                f"logged at {1 / data.dt:.4g} Hz"
            )
    return _conditioned(data, settings)


def _conditioned(data: Dataset, settings: Settings) -> Dataset:
    for channel in settings.data.despike:
        data, _ = despike(data, channel)
    rate, cutoff = settings.data.rate, settings.data.cutoff
    if rate is not None and not math.isclose(rate * data.dt, 1.0, rel_tol=1e-9):
        data = data.resample(1 / rate, cutoff=cutoff)
    elif cutoff is not None:
        data = data.resample(data.dt, cutoff=cutoff)
    data = _without_crumbs(data, bool(settings.data.filter))
    if "v_x" in data and "v_x_dot" not in data:
        data = with_speed_derivative(data)
    return data.hold_mean() if settings.data.hold == "mean" else data
