"""Which samples a model was fitted to, known again by their content: renamed, cut up or moved in time."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset

WINDOW = 12  # samples in a row that are compared as one
MARKS = 256  # windows kept of a record, more where it has very many experiments
LIVELY = 8  # distinct values that make a window one of a kind; the others count at their own time only
ENOUGH = 4  # windows in a row that must be found again, or all where fewer lie in what is shared
_TRIED = 64  # shifts in time between both records that are looked at, the likeliest first


@dataclass(frozen=True, kw_only=True)
class Fingerprint:
    """Windows of the training outputs, spread over the record, each as one number.

    Inputs are left out, so that replaying one input gives new data and preparing an input otherwise does not.
    Values count to single precision: a conversion of units that differs in the last bit changes nothing.
    """

    outputs: tuple[str, ...]  # channels that the windows are of
    dt: float  # s
    starts: tuple[int, ...]  # first row of each experiment
    start_times: tuple[float, ...]  # of its first sample [s]
    n_samples: int  # rows of all experiments together
    rows: np.ndarray  # where each window starts, shape (n_marks,)
    marks: np.ndarray  # its number
    lively: np.ndarray  # whether it is unlikely to occur twice, unlike a stretch at rest
    low: np.ndarray  # smallest value of each output
    high: np.ndarray  # largest
    changes: "Fingerprint | None" = field(default=None, metadata={"may be missing in a file": True})  # between samples


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Samples of a record that were used before."""

    rows: np.ndarray  # which they are, shape (n_samples,)
    earlier: float  # time that the first of them had then [s]


def provenance(data: Dataset, outputs: Sequence[str] | None = None) -> dict[str, Any]:
    """What a `FitInfo` keeps of the training data, as keywords, of all outputs or the model's."""
    ends = [t0 + (b - a - 1) * data.dt for t0, a, b in zip(data.start_times, data.starts, data.stops, strict=True)]
    return {
        "train_name": data.name,
        "train_span": (min(data.start_times), max(ends)),
        "fingerprint": fingerprint(data, data.outputs if outputs is None else outputs),
    }


def fingerprint(data: Dataset, outputs: Sequence[str]) -> Fingerprint:
    """`Fingerprint` of the outputs of a record, and of their changes, in which an offset is not."""
    y = data.columns(tuple(outputs))
    place: dict[str, Any] = {
        "outputs": tuple(outputs),
        "dt": data.dt,
        "starts": data.starts,
        "start_times": tuple(map(float, data.start_times)),
        "n_samples": data.n_samples,
    }
    changed = _marked(y, data, 1)
    lively = changed["lively"]
    changes = Fingerprint(**place, **changed | {key: changed[key][lively] for key in ("rows", "marks", "lively")})
    return Fingerprint(**place, **_marked(y, data, 0), changes=changes)


def content(data: Dataset) -> str:
    """A sum over all samples of a record, its channels and experiments: equal for equal data, whatever their name."""
    named = [c.name for c in data.channels], data.inputs, data.outputs, data.starts, data.dt
    return hashlib.sha256(repr(named).encode() + np.ascontiguousarray(data.values).tobytes()).hexdigest()


def _marked(y: np.ndarray, data: Dataset, steps: int) -> dict[str, Any]:
    """What a `Fingerprint` keeps of the outputs' values, or of what they change in one step, fewer of these."""
    marks = MARKS // 4 if steps else MARKS
    samples = [_chosen(y, a, b, marks, steps) for a, b in zip(data.starts, data.stops, strict=True)]
    rows = np.concatenate([rows for rows, _ in samples])
    return {
        "rows": rows,
        "marks": _folded(_row_numbers(_windows(y, rows, steps)).T),
        "lively": np.concatenate([lively for _, lively in samples]),
        "low": y.min(axis=0, initial=np.inf),
        "high": y.max(axis=0, initial=-np.inf),
    }


def _windows(y: np.ndarray, rows: np.ndarray, steps: int) -> np.ndarray:
    """Values from each row on, or what they change in one step, shape (n_rows, WINDOW, n_outputs)."""
    return np.diff(y[rows[:, None] + np.arange(WINDOW + steps)], n=steps, axis=1)


def _chosen(y: np.ndarray, first: int, stop: int, marks: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows at which the windows of one experiment start, and which of those are lively."""
    last = stop - WINDOW - steps
    if last < first:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
    wanted = max(2, round(marks * (stop - first) / len(y)))
    rows, distinct = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=int)
    for count in (4 * wanted, 128 * wanted):  # a closer look where most of the record is at rest
        rows = np.unique(np.linspace(first, last, min(count, last - first + 1)).round().astype(np.int64))
        ordered = np.sort(_windows(y, rows, steps).astype(np.float32), axis=1)
        distinct = 1 + (np.diff(ordered, axis=1) != 0).sum(axis=1).max(axis=1, initial=0)
        if np.sum(distinct >= LIVELY) >= min(wanted, len(rows)):
            break
    kept = distinct >= LIVELY if np.any(distinct >= LIVELY) else distinct > 1
    rows, distinct = rows[kept], distinct[kept]
    thinned = np.unique(np.linspace(0, len(rows) - 1, min(wanted, len(rows))).round().astype(int))
    return rows[thinned], distinct[thinned] >= LIVELY


def _row_numbers(y: np.ndarray) -> np.ndarray:
    """One number for every sample, which mixes all bits of all channels."""
    with np.errstate(over="ignore"):
        bits = (y.astype(np.float32) + np.float32(0.0)).view(np.uint32).astype(np.uint64)  # -0 becomes 0
    mixed = np.zeros(y.shape[:-1], dtype=np.uint64)
    for channel in np.moveaxis(bits, -1, 0):
        mixed = (mixed ^ channel) * np.uint64(0xBF58476D1CE4E5B9)
        mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(31)
    return mixed


# ---- finding them again --------------------------------------------------------------------------------------------


def overlap(seen: Fingerprint, data: Dataset) -> Overlap | None:
    """Samples of a record that are in another one's fingerprint; None where there are none.

    The record may have any name and time, and other offsets. Overlaps shorter than a window, or than the distance of
    two windows inside a long record, may go unseen.
    """
    if any(o not in data for o in seen.outputs):
        return None
    found = _shared(seen, data, 0)
    return _shared(seen.changes, data, 1) if found is None and seen.changes is not None else found


def _shared(seen: Fingerprint, data: Dataset, steps: int) -> Overlap | None:
    """`overlap` by the values, or by what they change in one step."""
    if not len(seen.marks):
        return None
    order = np.argsort(seen.marks, kind="stable")
    used, earlier = np.zeros(data.n_samples, dtype=bool), np.inf
    y = data.columns(seen.outputs)
    for a, b, t0 in zip(data.starts, data.stops, data.start_times, strict=True):
        if b - a - steps < WINDOW:
            continue
        numbers = _rolling(np.diff(y[a:b], n=steps, axis=0))
        for own, then in _again(seen, order, numbers, b - a - steps, float(t0)):
            used[a:b][own.start : own.stop + steps] = True
            earlier = min(earlier, then)
    return Overlap(rows=used, earlier=earlier) if used.any() else None


def _rolling(y: np.ndarray) -> np.ndarray:
    """One number for the window that starts at each row."""
    rows, n = _row_numbers(y), max(0, len(y) - WINDOW + 1)
    return _folded(rows[j : j + n] for j in range(WINDOW))


def _folded(samples: Iterable[np.ndarray]) -> np.ndarray:
    """One number for each window from the numbers of its samples, the first of all windows first."""
    total = np.zeros(1, dtype=np.uint64)
    for sample in samples:
        total = total * np.uint64(0x9E3779B97F4A7C15) + sample
    return (total >> np.uint64(1)).astype(np.int64)


def _again(seen: Fingerprint, order: np.ndarray, numbers: np.ndarray, n: int, t0: float) -> list[tuple[slice, float]]:
    """Rows of one experiment that the fingerprint knows, and the time that the first of each had then."""
    ranked = seen.marks[order]
    place = np.minimum(np.searchsorted(ranked, numbers), len(ranked) - 1)
    here = np.flatnonzero(ranked[place] == numbers)
    if not len(here):
        return []
    shifts = here - seen.rows[order[place[here]]]
    repeats = []
    values, counts = np.unique(shifts, return_counts=True)
    stops = (*seen.starts[1:], seen.n_samples)
    for shift in values[np.argsort(-counts, kind="stable")][:_TRIED]:
        for first, stop, then in zip(seen.starts, stops, seen.start_times, strict=True):
            low, high = max(0, first + shift), min(n, stop + shift)
            at = seen.rows + shift
            inside = np.flatnonzero((seen.rows >= first) & (seen.rows < stop) & (at >= low) & (at <= high - WINDOW))
            if not len(inside):
                continue
            same = numbers[at[inside]] == seen.marks[inside]
            a, b = _longest(same)
            lively = bool(seen.lively[inside].any())
            if b - a < (min(ENOUGH, len(inside)) if lively else len(inside)):
                continue
            when = then + (low - shift - first) * seen.dt
            if not lively and abs(when - (t0 + low * seen.dt)) > 0.5 * seen.dt:
                continue
            if b - a < len(inside):  # only a part of what both could share
                low, high = int(at[inside[a]]), int(at[inside[b - 1]]) + WINDOW
            repeats.append((slice(low, high), then + (low - shift - first) * seen.dt))
    return repeats


def _longest(flags: np.ndarray) -> tuple[int, int]:
    """First and one past the last of the longest run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return 0, 0
    a, b = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return int(a), int(b)
