"""What a fit says of a model that runs away, and of numbers that broke down on the way to it."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ModelWarning, SimulationError, SlipangleError
from slipangle.models.plausible import growth, tenfold

SETTLED = 1 + 1e-5  # largest pole whose errors take 230 000 samples to grow tenfold

_LATER = (
    "the model is slightly unstable: it has a pole of modulus {size:.6g}, so an error of its free run grows tenfold "
    "every {steps:.3g} samples, longer than the training data last; expected a stable model, unless the system is not: "
    "drifts and offsets make such poles, so remove the means, or ask for offsets='both' or max_radius=1"
)
_AT = 1e-6  # of the limit, within which a pole is at it
_HELD = (
    "a pole ends at the limit of {limit:g}: the system is slower, integrates, or is unstable and held back, and no "
    "interval counts that; expected poles inside: raise max_radius, up to 1, or take ARX or ARMAX, whose poles are free"
)


def noted(model: Any, *sentences: str) -> Any:
    """The model with more warnings in its ``fit_info``; empty ones are left out."""
    more = tuple(s for s in sentences if s)
    info = model.fit_info
    return replace(model, fit_info=replace(info, warnings=(*info.warnings, *more))) if more and info else model


def judged(model: Any, data: Dataset) -> Any:
    """The model, with a warning in its ``fit_info`` if a free run over the longest training experiment would blow up.

    It is linear: it has ``poles``.
    """
    return noted(model, growth(model.poles, data.n_longest))


def later(poles: np.ndarray, data: Dataset) -> str:
    """Sentence about the largest pole where errors grow too slowly for the training data to show; else empty."""
    size = float(np.abs(poles).max())
    if size <= SETTLED or growth(poles, data.n_longest):
        return ""
    return _LATER.format(size=size, steps=tenfold(size))


def held(poles: np.ndarray, limit: float | None) -> str:
    """Sentence about a pole that ends at the limit of the search; empty where none does."""
    size = float(np.abs(poles).max(initial=0.0))
    return _HELD.format(limit=limit) if limit is not None and size > (1 - _AT) * limit else ""


def announced(model: Any) -> Any:
    """The model, its fit's warnings given to whoever called ``fit``."""
    for sentence in model.fit_info.warnings if model.fit_info else ():
        kind = ModelWarning if "unstable" in sentence or "astray" in sentence else IdentifiabilityWarning
        warnings.warn(sentence, kind, stacklevel=3)
    return model


@contextmanager
def breakdown_said(what: str, data: Dataset) -> Iterator[None]:
    """Turn what linear algebra raises on numbers that are no longer finite into one sentence.

    Raises SimulationError if the fit diverged.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a trial step may make a free run overflow
            yield
    except SlipangleError:
        raise
    except (np.linalg.LinAlgError, FloatingPointError, ZeroDivisionError, OverflowError) as error:
        raise _diverged(what, data) from error
    except ValueError as error:
        if "infs or NaNs" not in str(error) and "not finite" not in str(error):
            raise
        raise _diverged(what, data) from error


def _diverged(what: str, data: Dataset) -> SimulationError:
    return SimulationError(
        f"the fit of {what} to '{data.name}' diverged; expected numbers that stay finite: choose a smaller model or a "
        "stable one (max_radius=1), or check the scale and the excitation of the data"
    )
