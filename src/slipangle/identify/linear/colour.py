"""What an ARX model's residual says of its coefficients: its colour, and what the model's free run tells of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from slipangle.data.dataset import Dataset, join
from slipangle.errors import SlipangleError
from slipangle.identify.linear.lags import Windows, triangle
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import Model
from slipangle.numerics.covariance import autoregression

_SEEN = 1 << 14  # samples that are looked at, from the start
_SHARE = 0.01  # of the residual's variance that its own past tells, from which it is called coloured
_RARE = 1e-3  # of residuals that only noise of the equation leaves are said to be told by a free run
_NOISE = 1e-6  # residual in parts of the output, below which it is rounding


def colour_said(model: ARXModel, data: Dataset) -> tuple[str, ...]:
    """A sentence for each output whose one-step-ahead residual its own past, or a free run of the model, predicts.

    Least squares is unbiased only if past outputs are independent of the residual, so only if it is white [1]_. The
    order of the residual's autoregression is that of least BIC, which a white one leaves at 0. Many lags make the
    residual white though noise on the output biases them. So what lagged outputs of a free run, which come from past
    inputs alone, add to the regression is tested too: nothing, where the noise is that of the equation. It is the test
    of instrumental variables against least squares in the form of an added regression [2]_.

    References
    ----------
    .. [1] L. Ljung, System Identification, 2nd ed., 1999, sec. 7.3, 7.6.
    .. [2] J. A. Hausman, Specification tests in econometrics, Econometrica 46, 1978, sec. 2.
    """
    seen = data.rows(0, min(_SEEN, data.n_samples)).experiments
    errors = [e for e in (_residual(model, part) for part in seen) if len(e) > 1]
    if not errors:
        return ()
    said, told_by_run = [], _told_by_free_run(model, seen)
    for i, output in enumerate(model.outputs):
        found = _colour([e[:, [i]] for e in errors], float(np.var(data[output])))
        if found is None:
            continue
        if found:
            said.append(
                f"the noise of {output} is coloured ({found}): it biases the coefficients of an ARX model, which their "
                "intervals do not count; expected a white residual: use OutputError, BoxJenkins or StateSpace, or more "
                "lags"
            )
        elif i in told_by_run:
            said.append(
                f"the residual of {output} looks white, but a free run of the model tells {100 * told_by_run[i]:.1f} % "
                "of it: noise on the output, or dynamics beyond the lags, biases the coefficients of an ARX model, "
                "which their intervals do not count; expected noise of the equation alone: use OutputError, BoxJenkins "
                "or StateSpace"
            )
    return tuple(said)


def shared_colour_said(model: Model, data: Dataset, more: str) -> tuple[str, ...]:
    """A sentence for each output whose one-step-ahead residual is coloured, of a model with poles that noise shares.

    Such poles are bent to the noise, where its order is too low for it ([1]_ of `colour_said`,
    sec. 8.5); ``more`` says what has more of it.
    """
    parts = data.rows(0, min(_SEEN, data.n_samples)).experiments
    try:
        runs = [model._predict(part) for part in parts if part.n_samples > model.memory + 1]
    except SlipangleError:
        return ()
    pieces = [run.error[run.predicted] for run in runs]
    said = []
    for i, output in enumerate(model.outputs):
        if pieces and (found := _colour([e[:, [i]] for e in pieces], float(np.var(data[output])))):
            said.append(
                f"the noise of {output} is coloured ({found}): the model has too low an order for it, which biases the "
                f"coefficients, and their intervals do not count that; expected a white residual: {more}"
            )
    return tuple(said)


def _colour(pieces: list[np.ndarray], variance: float) -> str | None:
    """How coloured residuals, shape (n, 1), are, empty if white; None where they are rounding of such an output."""
    total = float(np.mean(np.concatenate(pieces) ** 2))
    if not np.isfinite(total) or total <= _NOISE**2 * variance:
        return None
    coefficients, driving = autoregression(pieces)
    told = 1.0 - float(driving[0, 0]) / total
    if not len(coefficients) or told <= _SHARE:
        return ""
    lag = sum(float(p[1:, 0] @ p[:-1, 0]) for p in pieces) / sum(float(p[:, 0] @ p[:, 0]) for p in pieces)
    return f"{100 * told:.0f} % of the residual follow from its past, correlation {lag:+.2f} at one sample"


def _told_by_free_run(model: ARXModel, parts: Sequence[Dataset]) -> dict[int, float]:
    """Share of the residual that lagged outputs of a free run tell, by the outputs where that is no chance."""
    memory, ny = model.memory, len(model.outputs)
    long = [part for part in parts if part.n_samples > memory]
    try:
        free_runs = [model._simulate(part).y for part in long]
    except SlipangleError:  # a free run that leaves the finite numbers
        return {}
    if not long or not np.isfinite(np.vstack(free_runs)).all():
        return {}
    data, names = join(*long), (*model.outputs, *model.inputs, *(f"{name}, free run" for name in model.outputs))
    for name, column in zip(names[-ny:], np.vstack(free_runs).T, strict=True):
        data = data.with_channel(name, column)
    windows = Windows(data=data, names=names, lags=memory + 1)
    at = (memory - np.arange(memory + 1)) * len(names)  # of each lag in a window
    inputs = [at[lag] + ny + j for lag, b in enumerate(model.B, model.nk) for j in np.flatnonzero(b.any(axis=0))]
    past = [at[i] + j for i in range(1, model.na + 1) for j in range(ny)]
    run = [k + len(names) - ny for k in past]
    constant = bool(model.c.any())
    p, more = len(past) + len(inputs) + constant, len(run)
    free = windows.count - p - more
    if free <= ny:
        return {}
    columns = [*past, *inputs, *run, *range(at[0], at[0] + ny)]
    left = triangle(windows, columns, constant=constant, scale=np.ones(len(columns) + constant))[:, -ny:]
    before, after = (np.sum(left[k:] ** 2, axis=0) for k in (p, p + more))  # of what the columns up to there leave
    with np.errstate(divide="ignore", invalid="ignore"):
        rare = scipy.stats.f.sf((before - after) / more / (after / free), more, free) < _RARE / ny
    return {int(i): float(1 - after[i] / before[i]) for i in np.flatnonzero(rare)}


def _residual(model: ARXModel, part: Dataset) -> np.ndarray:
    """One-step-ahead errors of an experiment, shape (n, n_outputs); none where it is shorter than the lags."""
    y, u, n = part.columns(model.outputs), part.columns(model.inputs), part.n_samples
    first = max(len(model.A), model.nk + len(model.B) - 1)
    if n <= first:
        return np.zeros((0, len(model.outputs)))
    e = y[first:] - model.c
    for lag, a in enumerate(model.A, 1):
        e += y[first - lag : n - lag] @ a.T
    for lag, b in enumerate(model.B, model.nk):
        e -= u[first - lag : n - lag] @ b.T
    return e
