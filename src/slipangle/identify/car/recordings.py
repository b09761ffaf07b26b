"""What differs between recordings of a car, such as a steering's offset, read from the first seconds of another one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.car.stretches import driven
from slipangle.identify.car.structures import SLOWEST, Prior, fit, ordinary
from slipangle.numerics.blas import one_blas_thread

_LEAST = 0.1  # share of the seconds that a car has to move
_GUESSED = 1.0  # recordings that what is ordinary counts for in the scatter between recordings


def settled(model: Any, data: Dataset, seconds: float) -> Any:
    """See `IdentifiedCar.for_recording`; of any car of named parameters that was fitted ``per_experiment``."""
    if not seconds > 0:
        raise ParameterError(f"seconds is {seconds:g} s; expected a positive time")
    prior = between(model)
    if not prior:
        return model
    begun = _first(data.select(inputs=model.inputs, outputs=model.outputs), seconds, model.value("wheelbase"))
    with one_blas_thread():
        found = fit(replace(model, fit_info=None), tuple(prior), begun, prior=prior)
    return replace(model.with_values(**found.values), fit_info=model.fit_info)


def between(model: Any) -> Prior:
    """Mean over the recordings that a model was fitted to, and scatter of another one, of what differs between them.

    That scatter is the recordings' own, with what is ordinary for a car as one recording more [1]_; few say little.

    References
    ----------
    .. [1] A. Gelman et al., Bayesian Data Analysis, 3rd ed., 2013, sec. 2.6, scaled inverse chi-squared prior.
    """
    info, each = model.fit_info, dict[str, list[float]]()
    for name, value in zip(info.names, info.values, strict=True) if info is not None else ():
        if name.endswith("]"):
            each.setdefault(name.split("[")[0], []).append(float(value))
    found, usual = {}, ordinary(model, tuple(each))
    for name, values in each.items():
        count, mean = len(values), float(np.mean(values))
        centre, width, relative = usual.get(name, (0.0, float(np.sqrt(np.mean(np.square(values)))), False))
        guess = _GUESSED * (width * centre if relative else width) ** 2
        scatter = (guess + float(np.sum((np.array(values) - mean) ** 2))) / (_GUESSED + count - 1)
        found[name] = (mean, float(np.sqrt(max(scatter * (1 + 1 / count), 1e-300))), False)
    return found


def _first(data: Dataset, seconds: float, wheelbase: float) -> Dataset:
    """The first so many seconds of driving."""
    wanted, least, kept = round(seconds / data.dt), max(8, round(_LEAST * seconds / data.dt)), list[Any]()
    for run in driven(data, wheelbase, least):
        room = wanted - sum(piece.n_samples for piece in kept)
        if room >= least or (room > 0 and not kept):
            kept.append(run.rows(0, min(room, run.n_samples)))
    if not kept:
        raise TooShortError(
            f"'{data.name}' has no stretch of {least * data.dt:.3g} s above {SLOWEST * wheelbase:.2g} m/s; expected "
            "some to read offsets from: record longer, or give fewer seconds"
        )
    return join(*kept)
