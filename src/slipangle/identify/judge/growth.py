"""Whether a free run can follow at all: of a system that is unstable where it was driven, what is small grows."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning
from slipangle.identify.judge.initial import restarted
from slipangle.identify.judge.scores import score
from slipangle.models.model import Model, Trajectory

_GREW = 10.0  # times from the middle of a record to its end; what only drifts grows so by 2, its integral by 4
_SEEN = 2.0  # times that an error grows so, below which no start is its reason
_SHARE = 0.5  # of the squared error that a start a little beside explains, from which it is what the run errs by
_NUDGE = 1e-6  # of a state, by which the second run starts beside
_FEW = 20  # samples of a record that has a middle and an end


def growth_said(model: Model, data: Dataset, free: Trajectory) -> dict[str, str]:
    """For each output whose free-run error is that of a start a little beside, a sentence; none where all are stable.

    A second free run starts a millionth beside; what lies between the two grows as any error does. Where that is
    tenfold over the second half of the longest experiment, and explains half of an output's squared error by one
    factor for each experiment, so long a free run does not tell whether the model is right: runs that start anew
    whenever an error has grown tenfold do, and the sentence has their fit.
    """
    edges, first = (*free.starts, len(free.y)), model.memory
    errors = [free.error[a + first : b] for a, b in pairwise(edges)]
    if not max(map(_growth, errors), default=0.0) > _SEEN:
        return {}
    chosen = data.select(inputs=model.inputs, outputs=model.outputs)
    apart = [_apart(model, part, first) for part in chosen.experiments]
    longest = apart[int(np.argmax([len(gap) for gap in apart]))]
    times = _growth(longest)
    if not times > _GREW:
        return {}
    kept = [free.predicted[a + first : b] for a, b in pairwise(edges)]
    shares = {name: _share(errors, apart, kept, i) for i, name in enumerate(free.outputs)}
    tenfold = max(0.5 * len(longest) / float(np.log10(times)), 1.0) * data.dt
    with warnings.catch_warnings(action="ignore", category=ModelWarning):  # of the long run, which said it
        anew = model.simulate(restarted(chosen, tenfold, first))
    return {
        name: f"the model is unstable where it was driven: what its run begins off by grows {times:.2g}-fold from the "
        f"middle of the record to its end, {100 * share:.0f} % of the squared error of {name}; if the vehicle is "
        f"unstable there, too, that is no fault of the model: runs that start anew every {tenfold:.2g} s, in which an "
        f"error grows tenfold, fit {score(anew, name).fit:.1f} %"
        for name, share in shares.items()
        if share > _SHARE
    }


def _share(errors: list[np.ndarray], apart: list[np.ndarray], kept: list[np.ndarray], i: int) -> float:
    """Of an output's squared error that lies along what is between the two runs, by one factor for each experiment."""
    along, total = 0.0, 0.0
    for missed, gap, rows in zip(errors, apart, kept, strict=True):
        error, grown = missed[rows, i], gap[rows, i]
        total += float(error @ error)
        along += float(error @ grown) ** 2 / max(float(grown @ grown), 1e-300)
    return along / max(total, 1e-300)


def _apart(model: Model, part: Dataset, first: int) -> np.ndarray:
    """How far outputs of a run that starts a little beside lie from those of the run, shape (n - memory, n_outputs)."""
    x = np.asarray(model.initial_state(part.head(first)), dtype=float)
    beside = x + _NUDGE * (1.0 + np.abs(x))
    with np.errstate(over="ignore", invalid="ignore"):
        runs = [np.asarray(model.free_run(start, part.u[first - 1 :])) for start in (x, beside)]
        return np.nan_to_num(runs[1] - runs[0], nan=0.0, posinf=0.0, neginf=0.0)


def _growth(gap: np.ndarray) -> float:
    """Of the last tenth over the tenth at the middle, for the output where that is most."""
    if len(gap) < _FEW:
        return 0.0
    tenth = len(gap) // 10
    ends = [np.abs(gap[k - tenth : k]).max(axis=0) for k in (len(gap) // 2, len(gap))]
    return float(np.max(ends[1] / np.maximum(ends[0], 1e-300)))
