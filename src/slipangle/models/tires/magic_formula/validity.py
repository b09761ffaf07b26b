"""`ValidRange`: the range of operating conditions that the coefficients of a tire are valid for."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Range = tuple[float, float]
_OPEN: Range = (-math.inf, math.inf)


@dataclass(frozen=True, kw_only=True)
class ValidRange:
    """Lowest and highest valid value of each input, in the axes of the coefficients.

    >>> ValidRange(load=(100.0, 9000.0)).violations({"load": 50.0})
    ['load is 50 N; expected 100 to 9000 N (FZMIN, FZMAX)']
    """

    load: Range = (0.0, math.inf)  # N; FZMIN, FZMAX
    slip_ratio: Range = _OPEN  # -; KPUMIN, KPUMAX
    slip_angle: Range = _OPEN  # rad; ALPMIN, ALPMAX
    camber: Range = _OPEN  # rad; CAMMIN, CAMMAX
    pressure: Range = _OPEN  # Pa; PRESMIN, PRESMAX

    def violations(self, inputs: Mapping[str, Any]) -> list[str]:
        """One sentence part per input that leaves its range or is not finite; inputs as the equations name them."""
        sentences: list[str] = []
        for key, label, unit, (lower, upper), names in (
            ("load", "load", "N", self.load, "FZMIN, FZMAX"),
            ("kappa", "slip ratio kappa", "", self.slip_ratio, "KPUMIN, KPUMAX"),
            ("alpha", "slip_angle", "rad", self.slip_angle, "ALPMIN, ALPMAX, in the axes of the coefficients"),
            ("camber", "camber", "rad", self.camber, "CAMMIN, CAMMAX, in the axes of the coefficients"),
            ("pressure", "pressure", "Pa", self.pressure, "PRESMIN, PRESMAX"),
        ):
            value = inputs.get(key)
            if value is None or np.size(value) == 0:
                continue
            low, high = float(np.min(value)), float(np.max(value))
            # a comparison with NaN is false, so NaN counts as outside
            if low >= lower and high <= upper and math.isfinite(low) and math.isfinite(high):
                continue
            worst = high if low >= lower else low
            range_ = f"{lower:g} to {upper:g}" if math.isfinite(lower) or math.isfinite(upper) else "a finite number"
            unit = f" {unit}" if unit else ""
            sentences.append(f"{label} is {worst:g}{unit}; expected {range_}{unit} ({names})")
        return sentences
