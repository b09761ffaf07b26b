"""Checks of training data that every estimator makes before it starts."""

from __future__ import annotations

import warnings

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.recordings import repeated
from slipangle.errors import ExcitationError, MissingColumnError, ModelWarning, TooShortError

CHUNK = 1 << 15  # samples whose copy stays in the cache
_NEARLY = 0.99  # correlation from which inputs are said to move alike
_APART = 1e-6  # least eigenvalue of correlations that are certainly of independent inputs
_ENOUGH = 1 << 14  # samples that tell how alike inputs move
_DUST = 1e-15  # a signal in SI units that reaches no further does not move


def require_identifiable(data: Dataset, n_parameters: int, *, scheduling: tuple[str, ...] | None = None) -> None:
    """Raise unless the data have inputs, outputs, movement and enough samples.

    Raises MissingColumnError, ExcitationError, TooShortError with the channel or the count at fault. Warns with
    ModelWarning where two experiments hold the same samples.

    There are ``n_parameters`` per output. ``scheduling`` is given for physics: inputs, such as v_x, that need not move,
    and one moving other input is enough. By default every input must move.
    """
    if not data.inputs or not data.outputs:
        missing = "inputs" if not data.inputs else "outputs"
        raise MissingColumnError(
            f"'{data.name}' names no {missing}; expected at least one: use data.select({missing}=[...]), "
            f"in a job {missing} = [...]"
        )
    if data.n_samples < 2 * n_parameters + 2:
        raise TooShortError(
            f"'{data.name}' has {data.n_samples} samples for {n_parameters} parameters; expected at least "
            f"{2 * n_parameters + 2}: record longer or choose a smaller model"
        )
    still = [name for name in (*data.inputs, *data.outputs) if is_constant(data[name])]
    if scheduling is not None:
        driving = [name for name in data.inputs if name not in scheduling] or list(data.inputs)
        if any(name not in still for name in driving):
            still = [name for name in still if name not in data.inputs]
    for name in still:
        role = "input" if name in data.inputs else "output"
        reach = float(np.ptp(data[name]))
        seen = f"is constant at {data[name][0]:g}"
        if reach > 1e-12 * float(np.abs(data[name]).max()):
            seen = f"moves by {reach:.3g} only, which rounding does too (in its right unit?),"
        raise ExcitationError(
            f"the {role} '{name}' of '{data.name}' {seen} over {data.n_samples} samples; "
            "expected a signal that moves: use a stretch of the log with excitation or leave the channel out"
        )
    copies = repeated(dict(enumerate(data.experiments, 1)), (*data.inputs, *data.outputs))
    if copies:
        first, again = copies[0]
        others = f", as do {len(copies) - 1} more pairs" if len(copies) > 1 else ""
        warnings.warn(
            f"experiments {first} and {again} of '{data.name}' hold the same samples, which then count twice{others}: "
            "intervals are too narrow; expected each once: leave one out",
            ModelWarning,
            stacklevel=4,
        )


def require_independent(data: Dataset, *, offset: bool = True, least: float = 1e-10) -> None:
    """Raise if an input is a linear combination of the others: no black box could tell their effects apart.

    Without an ``offset`` in the model, inputs that differ by a constant are not alike. ``least`` is the share of its
    variance that an input has to have of its own.

    Raises ExcitationError with the inputs that depend on those before them, and the two that correlate most.
    """
    if len(data.inputs) < 2:
        return
    if np.linalg.eigvalsh(_correlations(data, _ENOUGH, centred=offset))[0] > _APART:
        return  # what some samples tell apart, all do
    alike = _correlations(data, data.n_samples, centred=offset)
    kept: list[int] = []
    dependent = []
    for i in range(len(alike)):  # what is left of it beside those kept
        left = 1.0 - _explained(alike, i, kept)
        if left < least:
            dependent.append(i)
        else:
            kept.append(i)
    if dependent:
        i, j = max(((i, j) for i in dependent for j in kept), key=lambda pair: abs(alike[pair]))
        names = data.inputs
        raise ExcitationError(
            f"the inputs {', '.join(names[k] for k in dependent)} of '{data.name}' are linear combinations of "
            f"{', '.join(names[k] for k in kept)} (the correlation of {names[i]} and {names[j]} is "
            f"{alike[i, j]:+.4g}); expected independent ones: leave them out or record richer excitation"
        )


def nearly_dependent(data: Dataset, *, offset: bool = True) -> tuple[str, ...]:
    """A sentence if two inputs move alike so nearly that their effects are told apart badly, or one and several.

    That is from a correlation of 0.99 on: intervals are seven times as wide as with inputs that move apart, and what
    noise there is in one input passes for an effect of the other. Without an ``offset`` in the model, inputs whose
    means tell them apart are not alike.
    """
    if len(data.inputs) < 2:
        return ()
    alike, names = _correlations(data, _ENOUGH), data.inputs
    i, j = divmod(int(np.argmax(np.abs(np.triu(alike, 1)))), len(names))
    if not offset and abs(_correlations(data, _ENOUGH, centred=False)[i, j]) < _NEARLY:
        return ()
    if abs(alike[i, j]) > _NEARLY:
        said = f"the inputs {names[i]} and {names[j]} of '{data.name}' move alike (correlation {alike[i, j]:+.6g})"
        wide = 1 / np.sqrt(max(1 - alike[i, j] ** 2, 1e-12))
    else:
        shares = [_explained(alike, k, [n for n in range(len(names)) if n != k]) for k in range(len(names))]
        i = int(np.argmax(shares))
        if shares[i] < _NEARLY**2:
            return ()
        j = int(np.argmax(np.abs(alike[i] - np.eye(len(names))[i])))
        said = (
            f"the input {names[i]} of '{data.name}' is nearly a combination of the others (multiple correlation "
            f"{np.sqrt(shares[i]):.6g}; most alike is {names[j]}, {alike[i, j]:+.3g})"
        )
        wide = 1 / np.sqrt(max(1 - shares[i], 1e-12))
    return (
        f"{said}: what each does is known {wide:.2g} times worse than from inputs that move apart; leave one out, or "
        "record excitation that moves them apart",
    )


def _correlations(data: Dataset, most: int, *, centred: bool = True) -> np.ndarray:
    """Of the inputs, from about so many samples, spread over the record; about their means or about zero."""
    step = max(1, data.n_samples // most)
    names = data.inputs
    means = np.array([data[n][::step].mean() if centred else 0.0 for n in names])
    gram = np.zeros((len(names), len(names)))
    for a in range(0, data.n_samples, CHUNK * step):
        z = np.column_stack([data[n][a : a + CHUNK * step : step] for n in names]) - means
        gram += z.T @ z
    scale = np.sqrt(np.diag(gram))
    scale[scale == 0] = 1.0
    return gram / np.outer(scale, scale)


def _explained(alike: np.ndarray, i: int, others: list[int]) -> float:
    """Share of the variance of one signal that is a combination of others."""
    if not others:
        return 0.0
    known = alike[np.ix_(others, others)]
    return float(alike[i, others] @ np.linalg.lstsq(known, alike[others, i], rcond=1e-12)[0])


def is_constant(x: np.ndarray) -> bool:
    """Whether a signal, shape (n_samples,), moves by no more than rounding."""
    low, high = float(x.min()), float(x.max())  # a long record is not copied
    return high - low <= max(1e-12 * max(-low, high), _DUST)
