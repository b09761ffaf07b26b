"""Whether v_y, a_y or v_x is logged later than the yaw rate, or earlier, and delta later than the wheels turn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.identify.car.corrections import LOADS, SPEED
from slipangle.identify.car.left_over import HOLD, searched
from slipangle.identify.car.structures import Fitted, Others, change, errors, free_runs, settling, worth

_LEAST, _MOST = 0.05, 0.5  # s, that roll and the hold between samples may make up, and beyond which nothing is sought
_FIRST = 0.5  # of that, from which a search goes on: lag and place of the sensor stood in for the rest
_LEAST_AHEAD = 0.02  # s, or a sample, by which a car is ahead of its steering at least; roll makes none
_SEEN = {"delta comes": "delta is logged late", "v_x comes": "v_x comes"}  # what a fit says, and a look at the log
_NO_DELAY = 1e-4  # s, of the steering, up to which it has none: its bound but for rounding


def with_lateness(final: Fitted, others: Others, data: Dataset) -> tuple[Others, list[str]]:
    """Structures as good as a final fit, one with v_y, a_y or v_x as late as the motion says among them, and sentences.

    Where one is late, by more than chance and by more than is worth a parameter, a speed of another scale, which
    explains a part of that, is none of the structures.
    """
    said = []
    for name in ("v_y", "a_y", "v_x", "delta"):
        found = late(final, data, name)
        if found is None:
            continue
        seconds, on_time = found
        behind, before = (name, "r") if seconds > 0 else ("r", name)
        taken = " by that, and by what the steering itself takes" if name == "delta" else ""
        said.append(
            f"{behind} comes {abs(seconds):.2g} s behind {before}, as the motion of the car tells: it is logged late"
            f"{taken}; shift it, or take another sensor; {HOLD}"
        )
        others = [*(other for other in others if not {*SPEED} <= {*other[0].free}), (on_time, 1.0)]
    return others, said


def beside(found: Sequence[str], doubts: Sequence[str]) -> tuple[str, ...]:
    """The doubts about a log without those on a channel of which a fit says better how late it is."""
    told = [seen for fitted, seen in _SEEN.items() if any(sentence.startswith(fitted) for sentence in found)]
    return tuple(sentence for sentence in doubts if not any(seen in sentence for seen in told))


def late(final: Fitted, data: Dataset, name: str = "v_y") -> tuple[float, Fitted] | None:
    """How late a channel is, negative if early [s], and the fit to it on time; None where it is not, or not there.

    A speed is asked where braking was found to shift loads: else its being late would stand in for that. A steering may
    be late, not early, which is its delay; beside a lag of its own, which can be as long, by more than that.
    """
    if not _asked(final, name):
        return None
    least = max(_LEAST_AHEAD, final.model.dt) if name == "delta" else _LEAST
    change_of = _of_the_output if name in final.model.outputs else _of_the_input
    searching = searched(
        final,
        final.free,
        lambda fitted, _: change_of(fitted, name)[:, :, None],
        lambda seconds: earlier(data, float(seconds[0]), name=name),
        (_FIRST * least, _MOST),
    )
    if searching is None:
        return None
    seconds, found = float(searching[0][0]), searching[1]
    if (seconds - found.values.get("steering_lag", 0.0) if name == "delta" else abs(seconds)) < least:
        return None
    shifted = ((f, earlier(data, s, abs(seconds), name)) for f, s in ((final, 0.0), (found, seconds)))
    moved, scatter = change(*(errors(f, d) for f, d in shifted))
    return (seconds, found) if worth(final, found, 1) > 0 and moved < -2.0 * scatter else None


def _asked(final: Fitted, name: str) -> bool:
    """Whether a channel may be late, as far as what was found before tells."""
    if name == "delta":
        return "delay_delta" not in final.own and final.values.get("delay_delta", 0.0) < _NO_DELAY
    return {*LOADS} <= {*final.free} if name == "v_x" else name in final.model.outputs


def _of_the_output(fitted: Fitted, name: str) -> np.ndarray:
    """Change of the errors with an output that is so much earlier, shape (n, n_outputs). [1/s]"""
    problem, dt = fitted.problem, fitted.model.dt
    column, rates = fitted.model.outputs.index(name), []
    for i, y in enumerate(problem.measured):
        run = problem.simulate(i, fitted.z)[:, column, 0]
        rates.append(np.gradient(run, dt)[1:][settling(len(y) - 1, dt) :])
    change = np.zeros_like(fitted.error)
    change[:, column] = -np.concatenate(rates) / problem.sigma[column]
    return change


def _of_the_input(fitted: Fitted, name: str) -> np.ndarray:
    """The same of an input, over a time in which it changes by more than its noise."""
    problem, h = fitted.problem, 0.5 * _LEAST
    shifted = (free_runs(fitted, earlier(problem.data, seconds, 0.0, name)) for seconds in (h, -h))
    ahead, behind = (np.concatenate([run for run, _ in runs]) for runs in shifted)
    return (ahead - behind) / (2 * h * problem.sigma)


def earlier(data: Dataset, seconds: float, cut: float | None = None, name: str = "v_y") -> Dataset:
    """Every stretch with a channel as it was so much later, less ``cut`` seconds, by default as many, at both ends."""
    samples = int(np.ceil(round(abs(seconds if cut is None else cut) / data.dt, 6)))
    parts = []
    for part in data.experiments:
        t = np.arange(part.n_samples) * part.dt
        moved = part.with_channel(name, np.interp(t + seconds, t, part[name]), part.unit(name))
        parts.append(moved.rows(samples, part.n_samples - samples))
    return join(*parts)
