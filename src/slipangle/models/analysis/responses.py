"""What a linear model answers: over frequency and over time, each with its confidence band."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Literal

import numpy as np

from slipangle.errors import ParameterError, shown
from slipangle.models.analysis.spectral_bands import gain_limits, phase_half, student
from slipangle.numerics.critical import quantile


@dataclass(frozen=True)
class Estimate:
    """A number and how sure it is: standard deviation, NaN where that is not known, and unit."""

    value: float  # in its unit
    std: float = float("nan")  # in the same unit
    unit: str = "-"

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval from the normal distribution."""
        half = quantile(level) * self.std
        return self.value - half, self.value + half

    def __str__(self) -> str:
        sure = f" ± {quantile(0.95) * self.std:.2g}" if np.isfinite(self.std) else ""
        return f"{self.value:.4g}{sure} {self.unit}".removesuffix(" -")


@dataclass(frozen=True, kw_only=True)
class FrequencyResponse:
    """How one input moves one output over frequency, of a model or of data.

    Parameters
    ----------
    frequency : array, shape (n,)
        [Hz]
    value : array of complex, shape (n,)
        Output over input, in their units.
    magnitude_std, phase_std : array, shape (n,)
        Standard deviations of the logarithm of the magnitude [-] and of the phase [rad]; NaN where not known. Of data
        they are times Student's quantile over the normal one, and hold where they are small.
    coherence : array, shape (n,), optional
        Of data: share of the output's power that follows the input, 0 to 1.
    freedom : float, optional
        Of data: degrees of freedom that the noise is estimated with. [-]
    """

    frequency: np.ndarray
    value: np.ndarray
    magnitude_std: np.ndarray
    phase_std: np.ndarray
    output: str
    input: str
    unit: str = "-"
    name: str = "model"
    coherence: np.ndarray | None = None
    freedom: float | None = None

    @property
    def magnitude(self) -> np.ndarray:
        """Gain, shape (n,), in `unit`."""
        return np.abs(self.value)

    @property
    def phase(self) -> np.ndarray:
        """Phase without jumps, shape (n,); negative lags. [rad]"""
        return np.unwrap(np.angle(self.value))

    @property
    def delay(self) -> np.ndarray:
        """Time by which the output lags at each frequency, ``-phase / (2 pi f)``, shape (n,). [s]"""
        return -self.phase / (2 * np.pi * self.frequency)

    def magnitude_band(self, level: float = 0.95) -> np.ndarray:
        """Confidence band of the magnitude, shape (n, 2).

        Of a model it is even on a logarithmic scale. Of data it holds at any coherence, and begins at zero where the
        gain is not told from none.
        """
        if self.freedom is not None:
            limits = gain_limits(self.magnitude_std / student(self.freedom), self.freedom, level)
            return self.magnitude[:, None] * limits
        factor = np.exp(quantile(level) * self.magnitude_std)
        return np.column_stack([self.magnitude / factor, self.magnitude * factor])

    def phase_band(self, level: float = 0.95) -> np.ndarray:
        """Confidence band of the phase, shape (n, 2). [rad]

        Of data it is half a turn to either side where the gain is not told from none.
        """
        if self.freedom is not None:
            half = phase_half(self.phase_std / student(self.freedom), self.freedom, level)
        else:
            half = quantile(level) * self.phase_std
        return np.column_stack([self.phase - half, self.phase + half])

    def plot(self, *others: FrequencyResponse, kind: Literal["bode", "nyquist"] = "bode") -> Any:
        """Bode diagram or Nyquist curve, other responses laid over; a Plotly figure that shows in a notebook.

        Raises ParameterError if the kind is another one.
        """
        if kind not in ("bode", "nyquist"):
            raise ParameterError(f"the kind is {shown(kind)}; expected 'bode' or 'nyquist'")
        figures = import_module("slipangle.report.linear")  # a room above this one
        return (figures.bode if kind == "bode" else figures.nyquist)((self, *others))

    def __repr__(self) -> str:
        span = f"{self.frequency[0]:.3g} to {self.frequency[-1]:.3g} Hz"
        return f"<FrequencyResponse of '{self.name}': {self.input} to {self.output} [{self.unit}], {span}>"


@dataclass(frozen=True, kw_only=True)
class TimeResponse:
    """What one output does after a step or an impulse of one input, beside the operating point.

    Parameters
    ----------
    t, y, std : array, shape (n,)
        Time [s], response per unit of the input (an impulse has area 1), its standard deviation (NaN: not known).
    """

    t: np.ndarray
    y: np.ndarray
    std: np.ndarray
    output: str
    input: str
    kind: Literal["step", "impulse"]
    unit: str = "-"
    name: str = "model"
    final: float = field(default=float("nan"))  # steady state, in the output's unit; infinite of an unstable model

    def band(self, level: float = 0.95) -> np.ndarray:
        """Confidence band, shape (n, 2)."""
        half = quantile(level) * self.std
        return np.column_stack([self.y - half, self.y + half])

    @property
    def rise_time(self) -> float:
        """Response time of ISO 7401: from the step to 90 % of the steady state. [s]"""
        return self._crossing(0.9)

    @property
    def peak_time(self) -> float:
        """Peak response time of ISO 7401: from the step to the largest value; NaN where nothing overshoots. [s]"""
        return self._peak()[0]

    @property
    def overshoot(self) -> float:
        """How far the peak is beyond the steady state, as a share of that; 0 where nothing overshoots. [-]"""
        peak = self._peak()[1]
        return max(0.0, peak / self.final - 1.0) if np.isfinite(self.final) and self.final else float("nan")

    def _crossing(self, share: float) -> float:
        if not np.isfinite(self.final) or self.final == 0:
            return float("nan")
        over = self.y / self.final >= share
        if not over.any():
            return float("nan")
        k = int(np.argmax(over))
        if k == 0:
            return float(self.t[0])
        return float(np.interp(share, self.y[k - 1 : k + 1] / self.final, self.t[k - 1 : k + 1]))

    def _peak(self) -> tuple[float, float]:
        """Time and value of the largest sample, by a parabola through it and its neighbours."""
        if not np.isfinite(self.final) or self.final == 0:
            return float("nan"), float("nan")
        y = self.y / self.final
        k = int(np.argmax(y))
        if y[k] <= 1 + 1e-6 or k in (0, len(y) - 1):
            return float("nan"), float(self.final)
        a, b, c = y[k - 1], y[k], y[k + 1]
        shift = 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c < 0 else 0.0
        return float(self.t[k] + shift * (self.t[1] - self.t[0])), float(self.final * (b - 0.25 * (a - c) * shift))

    def plot(self, *others: TimeResponse) -> Any:
        """The response with its band, others laid over; a Plotly figure that shows in a notebook."""
        return import_module("slipangle.report.linear").time_responses((self, *others))  # a room above this one

    def __repr__(self) -> str:
        size = f"to {self.final:.4g} {self.unit}" if self.kind == "step" else f"{self.t[-1]:.3g} s"
        return f"<{self.kind} response of '{self.name}': {self.input} to {self.output}, {size}>"
