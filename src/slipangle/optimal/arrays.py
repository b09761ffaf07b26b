"""Arrays of numbers from whatever a caller gives, in the shape that is wanted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipangle.errors import ParameterError

DOUBLE = np.dtype(np.float64)


def vector(given: Any, names: Sequence[str], what: str) -> np.ndarray:
    """One number for each name.

    Raises
    ------
    ParameterError
        If it is no vector of numbers of that length.
    """
    n = len(names)
    if type(given) is np.ndarray and given.dtype == np.float64 and given.shape == (n,):
        return given
    return array(given, (n,), names, what)


def array(given: Any, shape: tuple[int, ...], names: Sequence[str], what: str) -> np.ndarray:
    """Numbers of a shape, whose last axis has these names.

    Raises
    ------
    ParameterError
        If they are no real numbers, or of another shape.
    """
    if type(given) is np.ndarray and given.dtype == np.float64 and given.shape == shape:
        return given
    try:
        if np.iscomplexobj(given):
            raise TypeError
        numbers = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise ParameterError(
            f"{what} is {short(given)}; expected real numbers of shape {shape}: {list(names)}"
        ) from None
    if len(shape) == numbers.ndim == 1 and numbers.shape != shape:
        raise ParameterError(f"{what} has {len(numbers)} entries; expected {shape[0]}: {list(names)}")
    if numbers.shape != shape:
        raise ParameterError(f"{what} has shape {numbers.shape}; expected {shape}: {list(names)}")
    return numbers


def applied_input(given: Any, controls: Sequence[str]) -> np.ndarray:
    """The input applied before; a plain number will do for one control.

    Raises
    ------
    ParameterError
        If it is no vector of numbers of that length.
    """
    if type(given) is np.ndarray and given.dtype == np.float64 and given.shape == (len(controls),):
        return given
    if len(controls) == 1 and np.ndim(given) == 0 and isinstance(given, int | float | np.floating | np.ndarray):
        given = np.atleast_1d(np.asarray(given, dtype=float))
    return vector(given, controls, "applied")


def short(given: Any) -> str:
    """A value in a few words."""
    said = repr(given)
    return said if len(said) <= 60 else f"a {type(given).__name__}"
