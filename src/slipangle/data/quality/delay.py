"""How long an output takes to follow an input: generalised cross-correlation with coherence weights."""

from dataclasses import dataclass

import numpy as np
from scipy import signal

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError

_FASTEST = 10.0  # above this a vehicle's body hardly answers; kerbs and engines shake every sensor at once [Hz]
_FLOOR = 1e-8  # below this share of the strongest line, power is leakage from the others
_AGREE = 0.7  # of the coherent power must agree on one lag


@dataclass(frozen=True, kw_only=True)
class Delay:
    """Lag at which an output answers an input most strongly.

    ``seconds`` is positive when the output comes later. ``agreement`` is the share of the coherent, whitened power that
    agrees on this lag, -1 to 1, negative when the output answers with the opposite sign; ``coherent`` is the share of
    the frequencies at which the two are coherent (95 % significance).
    """

    input: str
    output: str
    seconds: float
    agreement: float
    coherent: float

    @property
    def clear(self) -> bool:
        """Whether the lag can be told."""
        return abs(self.agreement) > _AGREE and self.coherent > 0.2

    @property
    def sentence(self) -> str:
        """The finding in words."""
        if not self.clear:
            return f"no clear delay between {self.input} and {self.output}"
        if self.seconds < 0:
            return (
                f"{self.output} comes {-1000 * self.seconds:.0f} ms before {self.input}: swapped roles, feedback, or "
                "clocks that disagree"
            )
        return (
            f"{self.output} follows {self.input} by {1000 * self.seconds:.0f} ms (sensors, actuator and the vehicle's "
            "own lag together)"
        )


def _spectra(
    data: Dataset, input: str, output: str, n: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, int]:
    """Frequencies, whether there is power at them, cross spectrum, coherence, number of segments of ``n`` samples."""
    weights, cross, power_u, power_y = [], [], [], []
    f = np.fft.rfftfreq(n, data.dt)
    for part in data.experiments:
        if len(part) < n:
            continue
        how = {"fs": 1 / data.dt, "nperseg": n, "detrend": "linear"}
        weights.append(len(part) / n)
        cross.append(signal.csd(part[input], part[output], **how)[1])
        power_u.append(signal.welch(part[input], **how)[1])
        power_y.append(signal.welch(part[output], **how)[1])
    share = np.array(weights)[:, None] / sum(weights)
    s_uy, s_uu, s_yy = ((np.array(x) * share).sum(axis=0) for x in (cross, power_u, power_y))
    product = s_uu * s_yy
    coherence = np.where(product > 0, np.abs(s_uy) ** 2 / np.where(product > 0, product, 1.0), 0.0)
    powered = (s_uu > _FLOOR * s_uu.max()) & (s_yy > _FLOOR * s_yy.max())
    return f, powered, s_uy, coherence, max(int(sum(weights)), 2)


def estimate_delay(data: Dataset, input: str, output: str, *, longest: float = 1.0, f_max: float = _FASTEST) -> Delay:
    """Estimate how long ``output`` takes to follow ``input``.

    The cross spectrum is whitened and weighted by ``coherence / (1 - coherence)``, so frequencies
    count as much as they tell; its inverse transform, evaluated between the samples too, peaks at the
    lag sought. What comes out is the pure delay plus the lag of the dynamics, not the pure delay alone.

    Raises MissingColumnError or ParameterError if a channel does not exist, or ``longest`` or ``f_max`` is not
    positive, and ExcitationError or TooShortError if a channel is constant, or no stretch lasts ``32 longest``.

    Source: C. Knapp, G. Carter, "The generalized correlation method for estimation of time delay", IEEE Trans.
    Acoustics, Speech, and Signal Processing 24(4), 1976, 320-327 (Hannan-Thomson processor).

    Parameters
    ----------
    data, input, output
        The recording, its spikes repaired, and two of its channels.
    longest : float
        Lags up to this size are searched, in both directions. [s]
    f_max : float
        Frequencies above are left out. [Hz]

    Returns
    -------
    Delay
        Look at `Delay.clear` before using it.
    """
    if not (longest > 0 and f_max > 0):
        raise ParameterError(f"longest is {longest} s and f_max is {f_max} Hz; expected positive numbers")
    for name in (input, output):
        if np.ptp(data[name]) <= 1e-12 * max(1.0, float(np.abs(data[name]).max())):
            raise ExcitationError(
                f"channel '{name}' is constant, so no delay can be told; expected it to move: drive a manoeuvre"
            )
    available = max(len(p) for p in data.experiments)
    n = min(round(10 * longest / data.dt), available // 8)
    if n * data.dt < 4 * longest or n < 16:
        raise TooShortError(
            f"the longest stretch of '{data.name}' lasts {available * data.dt:.3g} s; expected at least "
            f"{32 * longest:g} s to tell a delay of up to {longest:g} s: record longer or search a shorter delay"
        )
    f, powered, cross, coherence, segments = _spectra(data, input, output, n)
    band = powered & (f > 0) & (f <= f_max) & (f < 0.49 / data.dt)
    significant = band & (coherence > 1 - 0.05 ** (1 / (segments - 1)))
    if not significant.any():
        return Delay(input=input, output=output, seconds=0.0, agreement=0.0, coherent=0.0)
    c = np.minimum(coherence[significant], 0.9999)
    weight = c / (1 - c) * np.exp(1j * np.angle(cross[significant]))
    lags = np.linspace(-longest, longest, 2001)
    curve = np.real(np.exp(2j * np.pi * np.outer(lags, f[significant])) @ weight) / np.abs(weight).sum()
    best = int(np.argmax(np.abs(curve)))
    share, agreement = float(significant.sum() / max(band.sum(), 1)), float(curve[best])
    return Delay(input=input, output=output, seconds=float(lags[best]), agreement=agreement, coherent=share)
