"""Whether the steering's ratio changes with its angle, as that of many racks does."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.car.corrections import LOCKED, Correction
from slipangle.identify.car.effects import others_as_good
from slipangle.identify.car.left_over import HOLD, searched
from slipangle.identify.car.structures import Fitted, Others, change, errors, free_runs, worth

_LEAST, _MOST = 0.05, 0.6  # share by which the wheels turn more than straight ahead, less than which no one minds
_NODES = np.array([1.0, 2.0, 3.0]) / 3.0  # of the largest angle used, between which that share is linear
_TOP = 0.999  # quantile of the steering that was used, beyond which are few samples
_STEP = 0.02  # of a share, over which errors change in proportion


def with_rack(final: Fitted, others: Others, dropped: list[Correction], data: Dataset) -> tuple[Others, list[str]]:
    """Structures as good as a final fit, with them those of a ratio that changes if it does, and a sentence.

    ``dropped`` are corrections that did not help.
    """
    found = changing(final, data)
    if found is None:
        return others, []
    shares, straight = found
    most = int(np.argmax(np.abs(shares)))
    at = float(np.rad2deg(_NODES[most] * _largest(final, data)))
    mended, like = "as a rack whose ratio changes does: give delta at the road wheels, by the rack's table", ""
    if not final.model.ode.small_angles:
        like = "wheels that are turned far look like where both turn alike and scrub"
    if {*LOCKED} <= {*final.free}:
        like = "rear wheels that turn as one look like when they slip"
    if like:
        mended = (
            f"as a rack whose ratio changes does, and as {like}: if it is the rack, give delta at the road wheels, "
        )
        mended += "by its table"
    said = (
        f"the steering turns the wheels {100 * abs(shares[most]):.2g} % {'more' if shares[most] > 0 else 'less'} at "
        f"{at:.2g} deg of delta than in proportion to what it does straight ahead, {mended}; {HOLD}"
    )
    with_it = others_as_good(straight, dropped, turned(final, data, shares))
    return [*others, (straight, 1.0), *with_it], [said]


def changing(final: Fitted, data: Dataset) -> tuple[np.ndarray, Fitted] | None:
    """By what shares the wheels turn more at `_NODES`, and the fit to such steering; None if they do not.

    Asked where v_y or a_y is fitted: tires that are told by the yaw rate alone bend as such a rack does.
    """
    if not {"v_y", "a_y"} & {*final.model.outputs}:
        return None
    free = tuple(dict.fromkeys(n for n in (*final.free, "steering_gain") if n not in final.own))
    searching = searched(
        final,
        free,
        lambda fitted, shares: _of_the_shares(fitted, final, data, shares),
        lambda shares: turned(final, data, shares),
        (_LEAST, _MOST),
        count=len(_NODES),
    )
    if searching is None:
        return None
    shares, found = searching
    moved, scatter = change(errors(final, data), errors(found, turned(final, data, shares)))
    return (shares, found) if worth(final, found, 1 + len(_NODES)) > 0 and moved < -2.0 * scatter else None


def turned(final: Fitted, data: Dataset, shares: np.ndarray) -> Dataset:
    """The log with the steering that a rack of constant ratio, that straight ahead, would have had."""
    at, top = final.model.value("steering_offset"), _largest(final, data)
    angle = data["delta"] - at
    more = np.interp(np.abs(angle) / top, [0.0, *_NODES], [0.0, *shares])
    return data.with_channel("delta", at + angle * (1.0 + more), data.unit("delta"))


def _largest(final: Fitted, data: Dataset) -> float:
    return max(float(np.quantile(np.abs(data["delta"] - final.model.value("steering_offset")), _TOP)), 1e-9)


def _of_the_shares(found: Fitted, final: Fitted, data: Dataset, shares: np.ndarray) -> np.ndarray:
    """Change of the errors with each share, shape (n, n_outputs, n_shares)."""
    by = []
    for step in _STEP * np.eye(len(shares)):
        runs = (free_runs(found, turned(final, data, shares + s)) for s in (step, -step))
        more, less = (np.concatenate([run for run, _ in parts]) for parts in runs)
        by.append((more - less) / (2 * _STEP * found.problem.sigma))
    return np.stack(by, axis=2)
