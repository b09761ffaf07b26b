"""Checks of training data that every estimator makes before it starts."""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, MissingColumnError, TooShortError

CHUNK = 1 << 15  # samples whose copy stays in the cache
_DUST = 1e-15  # a signal in SI units that reaches no further does not move


def require_identifiable(data: Dataset, n_parameters: int, *, scheduling: tuple[str, ...] | None = None) -> None:
    """Raise unless the data have inputs, outputs, movement and enough samples.

    Raises MissingColumnError, ExcitationError, TooShortError with the channel or the count at fault.

    There are ``n_parameters`` per output. ``scheduling`` is given for physics: inputs, such as v_x, that need not move,
    and one moving other input is enough. By default every input must move.
    """
    if not data.inputs or not data.outputs:
        missing = "inputs" if not data.inputs else "outputs"
        raise MissingColumnError(
            f"'{data.name}' names no {missing}; expected at least one: use data.select({missing}=[...])"
        )
    if data.n_samples < 2 * n_parameters + 2:
        raise TooShortError(
            f"'{data.name}' has {data.n_samples} samples for {n_parameters} parameters; expected at least "
            f"{2 * n_parameters + 2}: record longer or choose a smaller model"
        )
    still = [name for name in (*data.inputs, *data.outputs) if _is_constant(data[name])]
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


def require_independent(data: Dataset) -> None:
    """Raise if an input is a linear combination of the others: no black box could tell their effects apart.

    Estimators that are least squares find this by themselves, and for every lag.

    Raises ExcitationError with the inputs that depend on those before them.
    """
    means = np.array([data[name].mean() for name in data.inputs])
    gram = np.zeros((len(means), len(means)))
    for a in range(0, data.n_samples, CHUNK):
        z = np.column_stack([data[name][a : a + CHUNK] for name in data.inputs]) - means
        gram += z.T @ z
    scale = np.sqrt(np.diag(gram))
    alike = gram / np.outer(scale, scale)
    kept: list[int] = []
    dependent = []
    for i, name in enumerate(data.inputs):  # what is left of it beside those kept
        others = alike[np.ix_(kept, kept)]
        left = 1.0 - (alike[i, kept] @ np.linalg.solve(others, alike[kept, i]) if kept else 0.0)
        if left < 1e-10:
            dependent.append(name)
        else:
            kept.append(i)
    if dependent:
        raise ExcitationError(
            f"the inputs {', '.join(dependent)} of '{data.name}' are linear combinations of "
            f"{', '.join(data.inputs[i] for i in kept)}; expected independent ones: leave them out or record richer "
            "excitation"
        )


def _is_constant(x: np.ndarray) -> bool:
    low, high = float(x.min()), float(x.max())  # a long record is not copied
    return high - low <= max(1e-12 * max(-low, high), _DUST)
