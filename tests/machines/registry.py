"""Fits whose numbers must not depend on the machine; modules named ``fits_*`` here add theirs with `fit`."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

Errors = dict[str, float]


@dataclass(frozen=True)
class Fit:
    """A function that fits and returns errors and other numbers, some of them bounded.

    Keys are ``train`` and ``validation``, or these and a name, such as ``train RBF {1}``.
    """

    run: Callable[[], Errors]
    most: dict[str, float] = field(default_factory=dict)
    least: dict[str, float] = field(default_factory=dict)
    noise: float = 0.0

    def broken(self, errors: Errors) -> list[str]:
        """Bounds that these numbers do not keep."""
        high = [f"{k} {errors[k]:.4g} > {b:g}" for k, b in self.most.items() if not errors[k] <= b]
        return high + [f"{k} {errors[k]:.4g} < {b:g}" for k, b in self.least.items() if not errors[k] >= b]


FITS: dict[str, Fit] = {}


def fit(
    name: str, *, most: dict[str, float] | None = None, least: dict[str, float] | None = None, noise: float = 0.0
) -> Callable:
    """Add a function to the matrix.

    Parameters
    ----------
    name : str
        Of the row, such as ``"Lure, robot arm"``.
    most, least : dict, optional
        Bounds on what the function returns, by key.
    noise : float
        Error below which a number says nothing, such as rounding on exact data; spreads are relative to at least that.
    """

    def add(function: Callable[[], Errors]) -> Callable[[], Errors]:
        FITS[name] = Fit(function, most or {}, least or {}, noise)
        return function

    return add


def load() -> dict[str, Fit]:
    """All fits."""
    for module in sorted(m.name for m in pkgutil.iter_modules([str(Path(__file__).parent)])):
        if module.startswith("fits_"):
            importlib.import_module(f"tests.machines.{module}")
    return FITS
