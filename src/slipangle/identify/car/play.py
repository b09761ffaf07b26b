"""Whether the steering has play: the wheels stay when it goes back, until that is as far as the play is wide."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.recordings import recordings
from slipangle.identify.car.left_over import SURE, left_over
from slipangle.identify.car.structures import Fitted, change, errors, fit, fit_error, free_runs, worth

_WIDTHS = (0.02, 0.04, 0.08, 0.16, 0.32)  # of the largest angle used, at which play is tried
_STEP = 0.01  # of it, either way of the first of these, over which errors change in proportion
_TOP = 0.99  # quantile of the steering that was used, beyond which are few samples
_BETTER = 0.1  # fall of the squared error's logarithm, at least


def in_words(final: Fitted, data: Dataset) -> list[str]:
    """A sentence on play of the steering, by a last fit to ``data``, where there is some."""
    width = play(final, data)
    if not width:
        return []
    return [
        f"the steering has play: delta goes back by {np.rad2deg(width):.2g} deg before the wheels follow, which a fit "
        "takes for delay, lag and other tires: no interval holds; mend it, or log the angle behind it"
    ]


def play(final: Fitted, data: Dataset) -> float:
    """How wide the steering's play is by a fit to ``data`` without any; 0 where none shows. [rad]

    It is looked for where errors are smaller with a little of it, as all that was fitted is free to move, and is there
    where the fit to the log without it is worth a parameter, and better on nearly every stretch.
    """
    angle = data["delta"] - np.median(data["delta"])
    top = float(np.quantile(np.abs(angle), _TOP))
    at = (_WIDTHS[0] + np.array([_STEP, -_STEP])) * top
    more, less = (np.concatenate([run for run, _ in free_runs(final, taken_up(data, w))]) for w in at)
    slope = (more - less) / (2 * _STEP * top * final.problem.sigma)
    (found,), (error,) = left_over(final, slope[:, :, None])
    if not found > max(SURE * error, 0.5 * _WIDTHS[0] * top):
        return 0.0
    width, without = _best(final, data, top * np.array(_WIDTHS))
    moved, scatter = change(errors(final, data), errors(without, taken_up(data, width)))
    return width if worth(final, without, 1) > 0 and moved < -max(_BETTER, 2.0 * scatter) else 0.0


def taken_up(data: Dataset, width: float) -> Dataset:
    """The log with the angle that wheels follow behind play so wide. [rad]

    At the head of an experiment that does not go on where another of its recording ends they are in the middle of it.
    """
    parts, of, ends = data.experiments, recordings(data), dict[tuple[int, int], float]()
    found: list[np.ndarray] = [np.empty(0)] * len(parts)
    for k in sorted(range(len(parts)), key=lambda k: (of[k], parts[k].t[0])):
        head, tail = (round(float(t) / data.dt) for t in (parts[k].t[0], parts[k].t[-1] + data.dt))
        delta = parts[k]["delta"]
        found[k] = _behind(delta, 0.5 * width, ends.get((of[k], head), float(delta[0])))
        ends[of[k], tail] = float(found[k][-1])
    return data.with_channel("delta", np.concatenate(found), data.unit("delta"))


def _behind(delta: np.ndarray, half: float, at: float) -> np.ndarray:
    found = np.empty(len(delta))
    for k, angle in enumerate(delta.tolist()):
        at = min(max(at, angle - half), angle + half)
        found[k] = at
    return found


def _best(final: Fitted, data: Dataset, widths: np.ndarray) -> tuple[float, Fitted]:
    """The best width of play, by a parabola about the best of some, rising, and the fit to the log without it."""

    def without(width: float) -> Fitted:
        return fit(final.model, final.free, taken_up(data, width), final, own=final.own)

    fits, costs = list[Fitted](), list[float]()
    for width in widths:
        fits.append(without(float(width)))
        costs.append(fit_error(fits[-1]))
        if costs[-1] > min(costs):
            break
    k = int(np.argmin(costs))
    if not 0 < k < len(costs) - 1:
        return float(widths[k]), fits[k]
    a, b, _ = np.polyfit(np.log(widths[k - 1 : k + 2]), costs[k - 1 : k + 2], 2)
    width = float(np.exp(np.clip(-b / (2 * a), *np.log(widths[[k - 1, k + 1]]))))
    found = without(width)
    return (width, found) if fit_error(found) < costs[k] else (float(widths[k]), fits[k])
