"""Checks on (slip, friction) samples before a curve is fitted to them, and the range that they cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipangle.data.tire_data import TireData
from slipangle.errors import ExcitationError, NotFiniteError, ParameterError, TooShortError, UnitError
from slipangle.models.tires.magic_formula.validity import ValidRange
from slipangle.models.tires.neural import CurveInput

Beside = np.ndarray | None  # samples of what a curve may depend on besides slip


def checked_samples(
    slip: np.ndarray, friction: np.ndarray, load: Beside, camber: Beside, *, n_parameters: int
) -> tuple[np.ndarray, np.ndarray, tuple[CurveInput, ...]]:
    """Samples (n, n_inputs), target (n, 1) and names, or a sentence on what is wrong with them."""
    given: Sequence[tuple[CurveInput, np.ndarray | None]] = (("slip", slip), ("load", load), ("camber", camber))
    columns = {name: np.asarray(values, dtype=float).ravel() for name, values in given if values is not None}
    y = np.asarray(friction, dtype=float).ravel()
    for name, values in columns.items():
        if len(values) != len(y):
            raise ParameterError(f"{len(values)} samples of {name} and {len(y)} of friction; expected as many")
    if len(y) <= n_parameters:
        raise TooShortError(
            f"{len(y)} samples cannot determine {n_parameters} parameters; expected more samples than parameters"
        )
    for name, values in (*columns.items(), ("friction", y)):
        if not np.isfinite(values).all():
            raise NotFiniteError(
                f"{name} holds NaN or infinity, first in sample {int(np.argmin(np.isfinite(values)))}; expected finite "
                "numbers: leave those samples out"
            )
    x = columns["slip"]
    require_both_signs(x)
    if np.max(np.abs(x)) > np.pi:
        raise UnitError(
            f"slip reaches {np.max(np.abs(x)):g}; expected a ratio or radians, at most 3.14: convert percent or "
            "degrees with units.to_si"
        )
    if np.max(np.abs(y)) > 20:
        raise UnitError(
            f"friction reaches {np.max(np.abs(y)):g}; expected force over load, at most 20: divide the force by the "
            "load, both in newtons"
        )
    for name in ("load", "camber"):
        if name in columns and np.ptp(columns[name]) == 0:
            raise ExcitationError(f"{name} is {columns[name][0]:g} throughout; expected it to vary: leave it out")
    names: tuple[CurveInput, ...] = tuple(name for name, values in given if values is not None)
    return np.column_stack(list(columns.values())), y[:, None], names


def require_both_signs(slip: np.ndarray, what: str = "slip") -> None:
    """Raise if a sweep runs on one side of zero only.

    Raises ExcitationError with its range.
    """
    low, high = float(np.min(slip)), float(np.max(slip))
    if low >= -0.05 * high or high <= -0.05 * low:
        raise ExcitationError(
            f"{what} runs from {low:.4g} to {high:.4g}, on one side of zero only; expected both signs, since shifts "
            "and shape cannot be told apart otherwise: add the other side, or mirror the data"
        )


def limits_of(data: TireData) -> ValidRange:
    """Range of the data, in the axes of the coefficients (ISO-W), rounded outwards a little."""

    def around(values: np.ndarray) -> tuple[float, float]:
        low, high = float(values.min()), float(values.max())
        margin = 0.02 * max(high - low, 1e-6)
        return low - margin, high + margin

    low, high = around(data.load)
    reach = float(np.max(np.abs(data.slip_angle))) * 1.02 + 1e-3
    kappa = around(
        np.where(data.slip_ratio > 0, data.slip_ratio / (1 - np.minimum(data.slip_ratio, 0.99)), data.slip_ratio)
    )
    return ValidRange(
        load=(max(0.0, low), high),
        slip_angle=(-reach, reach),
        slip_ratio=(min(kappa[0], -0.05), max(kappa[1], 0.05)),
        camber=around(np.append(data.gamma, 0.0)),
        pressure=(-np.inf, np.inf) if data.pressure is None else around(data.pressure),
    )


def varying(data: TireData, nominal_pressure: float) -> str:
    """What differs among the samples: letters of force (f), camber (c) and, where the tire has it, pressure (p)."""
    name = ""
    if np.std(data.load) > 0.05 * np.mean(data.load):
        name += "f"
    if np.ptp(np.quantile(data.gamma, (0.02, 0.98))) > np.deg2rad(0.5):
        name += "c"
    if nominal_pressure > 0 and data.pressure is not None and np.std(data.pressure) > 0.02 * np.mean(data.pressure):
        name += "p"
    return name
