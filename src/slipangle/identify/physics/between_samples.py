"""What a free-run fit hangs on how inputs move between their samples, which no log says."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipangle.data.dataset import HELD, MEANS, Dataset
from slipangle.data.holds import moving
from slipangle.identify.physics.simulation_error import FreeRunProblem, Minimum
from slipangle.numerics.covariance import inverse_information

_DECIDED = 12.0  # difference of the squared errors, in noise variances, from which the outputs tell it: 400 to 1
_TOLD = 1.0  # standard deviations that a parameter moves, from which an interval no longer holds and a word is said


class BetweenSamples(NamedTuple):
    """How the free parameters, in their scaled units, move if inputs go the other way between their samples."""

    shift: np.ndarray  # (n_p,), to first order
    to_lines: bool  # whether the other way is straight lines, in place of steps
    told: bool  # whether the outputs tell that it is the true one
    chance: float  # that it is, before the data say or their user did as likely as not
    faster: bool = False  # whether the data were interpolated between their samples, so that these are the lines


def between_samples(problem: FreeRunProblem, found: Minimum, known: np.ndarray) -> BetweenSamples | None:
    """What straight lines in place of steps, or the reverse, would change at a minimum; None where none can be run.

    A model holds its inputs for a sample. If the true ones went on moving, it is half a sample late, and parameters
    that make up for it, such as a delay or an inertia, move by what one Gauss-Newton step says; of means over each
    sample, as `Dataset.hold_mean` makes them for inputs that go on, the reverse. ``known`` is the scaled covariance of
    the parameters, shape (n_p, n_p): noise that widens it makes the outputs tell less, too.
    """
    notes, data = problem.data.notes, problem.data
    to_lines = MEANS not in notes
    if found.diverged or not np.isfinite(known).all() or (not to_lines and notes[-1] != MEANS):
        return None
    others = [(data.hold_mean() if to_lines else _before_means(data), to_lines, False)]
    others += [(_held(data), False, True)] if to_lines and data.dt_recorded > data.dt else []
    tried = [(*_step(problem, found, known, other), *how) for other, *how in others]
    shift, gain, to_lines, faster = max(tried, key=lambda one: one[1])
    if not np.isfinite(gain):
        return None
    chance = 1.0 / (1.0 + np.exp(-0.5 * np.clip(gain, -200, 200))) if not {MEANS, HELD} & {*notes} else 0.0
    return BetweenSamples(shift, to_lines, gain > _DECIDED, 1.0 if gain > _DECIDED else chance, faster)


def _step(problem: FreeRunProblem, found: Minimum, known: np.ndarray, other: Dataset) -> tuple[np.ndarray, float]:
    """How the parameters move with these inputs, shape (n_p,), and by how much less error, in noise variances."""
    rows = [problem.model.drive_rows(part) for part in other.experiments]
    error = np.concatenate(list(problem.errors(found.z, rows))).ravel()
    if not np.isfinite(error).all():
        return np.zeros(problem.n_p), -np.inf
    inverse, square = inverse_information(found.jacobian), float(found.error @ found.error)
    shift = -inverse @ (found.jacobian.T @ (error - found.error))  # a fit that stopped early moves by itself, too
    white = np.diag(inverse)[: problem.n_p] * square / len(error)
    sure = white > 0
    colour = max(1.0, float(np.median(np.diag(known)[sure] / white[sure]))) if sure.any() else 1.0
    left = error + found.jacobian @ shift
    gain = (square - float(left @ left)) / max(colour * square / len(error), 1e-300)
    return shift[: problem.n_p], gain


def _held(data: Dataset) -> Dataset:
    """Inputs that stay at each sample of the record until its next, where there are lines between them now."""
    table, own = data.values.copy(), data.dt_recorded / data.dt
    for a, b in zip(data.starts, data.stops, strict=True):
        rows = np.arange(b - a)
        samples = own * np.floor(rows / own + 1e-6)
        for i in map(data.index, data.inputs):
            table[a:b, i] = np.interp(samples, rows, data.values[a:b, i])
    return replace(data, values=table)


def _before_means(data: Dataset) -> Dataset:
    """The samples of inputs of which the data's are the means over each, see `moving`."""
    table = data.values.copy()
    for a, b in zip(data.starts, data.stops, strict=True):
        for i in map(data.index, data.inputs):
            table[a:b, i] = moving(table[a : b - 1, i])
    return replace(data, values=table)


def hold_said(moved: BetweenSamples, problem: FreeRunProblem, values: np.ndarray, std: np.ndarray) -> list[str]:
    """A sentence where the outputs tell that inputs go the other way and parameters would leave their intervals."""
    shift = moved.shift * problem.scale[: problem.n_p]
    far = [i for i in range(problem.n_p) if abs(shift[i]) > _TOLD * std[i]]
    if not moved.told or not far:
        return []
    units = [problem.model.si(n).unit for n in problem.base_names]
    each = ", ".join(_moved(problem.names[i], values[i], values[i] + shift[i], units[i]) for i in far)
    way = (
        "inputs that go on in straight lines between their samples rather than inputs that are held for a sample"
        if moved.to_lines
        else "inputs that are held for a sample rather than inputs that go on between their samples"
    )
    fix = (
        "their means over each sample: fit to data.hold_mean() (hold = 'mean' in a job)"
        if moved.to_lines
        else "the rate of the log, which shows what was held: fit to the data before resample() (no rate in a job)"
        if moved.faster
        else "inputs as they were held: fit to the data without hold_mean() (hold = 'sample' in a job)"
    )
    return [f"the outputs follow {way}: {each}; the intervals take in both; expected {fix}"]


def _moved(name: str, now: float, then: float, unit: str) -> str:
    return f"{name} {now:.4g} would be about {then:.4g}{'' if unit in ('-', '') else ' ' + unit}"
