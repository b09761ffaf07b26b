"""Whether the steering's zero moved in mid log, as of a column that slips or a sensor that is zeroed anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.data.recordings import recordings
from slipangle.identify.car.stretches import Stretches
from slipangle.identify.car.structures import Fitted, change, errors, fit, free_runs, worth

_LEAST = 0.004  # rad of the road wheels; a road's cross slope makes a quarter of it
_LEAST_MORE = 0.001  # the same where it moved before, of which a poorer car left a part
_MOST, _SAME = 3, 5.0  # searches of a car anew, and s, within which it is the same move
_SUSPECT, _SURE = 3.0, 6.0  # standard deviations, at the best of all moments: before, and after it was put back
_SEARCHES = 3  # refits, each from where the last one says
_SIDE = 2  # stretches before and after it, at least
_FEW = 6  # stretches, fewer of which do not tell how far they scatter
_MOMENTS = 40  # that are looked at in the stretches about it


@dataclass(frozen=True)
class MovedZero:
    """By how much the logged angle of straight driving rose [rad], and when: recording and time [s]."""

    by: float
    recording: int
    t: float
    alone: bool  # whether later recordings have offsets of their own
    first: bool  # whether it is where the recording begins

    def without(self, data: Dataset) -> Dataset:
        """The log as it would have been read with the zero of before."""
        parts, of = [], recordings(data)
        for part, k in zip(data.experiments, of, strict=True):
            later = np.full(part.n_samples, k > self.recording and not self.alone)
            if k == self.recording:
                later = part.t >= self.t - 1e-9
            parts.append(part["delta"] - self.by * later)
        return data.with_channel("delta", np.concatenate(parts), data.unit("delta"))

    @property
    def sentence(self) -> str:
        """When and by how much, in words."""
        when = f"from recording {self.recording + 1} on" if self.first else f"at t = {self.t:.3g} s"
        if self.recording and not self.first:
            when += f" of recording {self.recording + 1}"
        return (
            f"the steering's zero moves by {np.rad2deg(self.by):+.2g} deg of delta {when}, as of a column that slips "
            "or a sensor that is zeroed anew, and is put back in the fit: see what delta reads on a straight before "
            "and after"
        )


Found = TypeVar("Found", bound=tuple[Fitted, Any, Any])


def with_zeros(search: Callable[[Stretches], Found], whole: Stretches) -> tuple[Found, Stretches, list[MovedZero]]:
    """What a search finds in a log put back, that log, and when its zero moved: found with what is found of the car."""
    found, zeros = search(whole), list[MovedZero]()
    for _ in range(_MOST):
        zero = moved_zero(found[0], whole.all, _LEAST_MORE if zeros else _LEAST)
        if zero is None:
            break
        same = [one for one in zeros if one.recording == zero.recording and abs(one.t - zero.t) < _SAME]
        more = replace(same[0], by=same[0].by + zero.by) if same else zero
        zero = replace(more, by=zero.by)
        zeros = [*(one for one in zeros if one not in same), more]
        whole = replace(whole, train=zero.without(whole.train), held_out=zero.without(whole.held_out))
        found = search(whole)
    return found, whole, zeros


def put_back(data: Dataset, zeros: Sequence[MovedZero]) -> Dataset:
    """A log as it would have been read with its first zero."""
    return reduce(lambda log, zero: zero.without(log), zeros, data)


def moved_zero(final: Fitted, data: Dataset, least: float = _LEAST) -> MovedZero | None:
    """Where the zero of the steering moved, by what stretches of the fit's ``data`` ask for; None where it stays.

    The stretches before and the stretches after agree among themselves, the log put back is worth its parameters, and
    the road wheels' angle moves by at least so much [rad].
    """
    columns = [i for i, name in enumerate(final.problem.base_names) if name == "steering_offset"]
    parts, of, alone = data.experiments, recordings(data), "steering_offset" in final.own
    begins = [float(part.t[0]) for part in parts]
    whole = sorted(range(len(parts)), key=lambda k: (of[k], begins[k]))
    again = (of[a] == of[b] and begins[b] < float(parts[a].t[-1]) for a, b in pairwise(whole))
    if not columns or any(again):  # experiments of a recording with clocks of their own
        return None
    offset, weight = _of_stretches(final, columns)
    best, order, at = 0.0, whole, 0
    for some in [[k for k in whole if of[k] == one] for one in sorted(set(of))] if alone else [whole]:
        sure, where = _best_split(offset[some], weight[some])
        if sure > best:
            best, order, at = sure, some, where
    if best < _SUSPECT:
        return None
    last, k = order[at - 1], order[at]
    found = MovedZero(_rise(offset[order], weight[order], at)[0], of[k], begins[k], alone, of[k] != of[last])
    mended, without, error = data, final, np.inf
    for _ in range(_SEARCHES):  # what was taken for other parameters comes back
        mended = found.without(data)
        without = fit(final.model, final.free, mended, final, own=final.own)
        offset, weight = _of_stretches(without, columns)
        more, error = _rise(offset[order], weight[order], at)
        found = replace(found, by=found.by + more)
        if not found.first:
            found = _moment(without, found, join(parts[last], parts[k]))
        if abs(more) < error:
            break
    if abs(found.by) < max(_SURE * error, least / abs(final.model.value("steering_gain"))):
        return None
    moved, scatter = change(errors(final, data), errors(without, mended))
    return found if worth(final, without, 2) > 0 and moved < -2.0 * scatter else None


def _of_stretches(final: Fitted, columns: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """By how much each stretch wants the steering's offset larger than all of them do [rad], and how surely. (n,)"""
    slope = final.jacobian[:, :, columns].sum(axis=2) / final.problem.scale[columns[0]]
    of = [final.stretch == k for k in range(int(final.stretch[-1]) + 1)]
    weight = np.array([np.sum(slope[rows] ** 2) for rows in of])
    return -np.array([np.sum((slope * final.error)[rows]) for rows in of]) / np.maximum(weight, 1e-300), weight


def _best_split(x: np.ndarray, weight: np.ndarray) -> tuple[float, int]:
    """Rise of later over earlier values over its standard error, where that is largest, and where that is."""
    best, at, n = 0.0, 0, len(x)
    for k in range(_SIDE, n - _SIDE + 1) if n >= _FEW else ():
        rise, error = _rise(x, weight, k)
        if abs(rise) > best * error:
            best, at = abs(rise) / error, k
    return best, at


def _rise(x: np.ndarray, weight: np.ndarray, k: int) -> tuple[float, float]:
    """By how much the values from ``k`` on are larger than those before, and the standard error, by their scatter."""
    sides = [slice(0, k), slice(k, len(x))]
    means = [float(np.average(x[s], weights=weight[s])) for s in sides]
    left = sum(np.sum(weight[s] * (x[s] - m) ** 2) for s, m in zip(sides, means, strict=True)) / (len(x) - 2)
    error = np.sqrt(max(left, 1e-300) * sum(1 / max(float(np.sum(weight[s])), 1e-300) for s in sides))
    return means[1] - means[0], float(error)


def _moment(fitted: Fitted, found: MovedZero, about: Dataset) -> MovedZero:
    """The same at the moment that explains the two stretches about it best, by a fit to the log put back."""
    times = np.concatenate([part.t for part in about.experiments])
    moments = [replace(found, t=float(t)) for t in np.linspace(times.min(), times.max(), _MOMENTS)]

    def left(one: MovedZero) -> float:
        runs = free_runs(fitted, one.without(about))
        return float(sum(np.sum(((run - y) / fitted.problem.sigma) ** 2) for run, y in runs))

    return min(moments, key=left)
