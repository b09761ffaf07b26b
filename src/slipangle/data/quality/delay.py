"""How long an output takes to follow an input: generalised cross-correlation, and a split into pure delay and lag."""

from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy import optimize

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError

_FASTEST = 10.0  # above this a vehicle's body hardly answers; kerbs and engines shake every sensor at once [Hz]
_FLOOR = 1e-8  # below this share of the strongest line, power is leakage from the others
_AGREE = 0.7  # of the coherent power must agree on one lag
_CHANCE = 0.005  # how often channels that have nothing to do with each other may look as if they had
_DRAWS = 999  # how often the signs of the windows are drawn for that
_WINDOWS = 8  # at least, over all experiments, and half as many again that overlap
STEERING = ("delta", "delta_sw", "delta_w")
MOTION = ("r", "v_y", "a_y", "beta", "psi")  # answers of the car's body, which have a lag of their own


@dataclass(frozen=True, kw_only=True)
class Delay:
    """Lag at which an output answers an input most strongly.

    ``seconds`` is positive when the output comes later. ``agreement`` is the share of the coherent, whitened power that
    agrees on this lag, -1 to 1, negative when the output answers with the opposite sign; ``coherent`` is the share of
    the frequencies at which the two are coherent (95 % significance), ``chance`` how often channels without any tie
    would look as tied as these. ``pure`` and ``lag`` are pure delay and time constant of ``gain exp(-s pure) / (1 + s
    lag)``, the best of its kind for the frequency response, with standard deviations. [s]
    """

    input: str
    output: str
    seconds: float
    agreement: float
    coherent: float
    chance: float = 1.0
    pure: float = float("nan")
    pure_std: float = float("inf")  # of pure [s]
    lag: float = float("nan")
    lag_std: float = float("inf")  # of lag [s]
    reason: str = ""  # why nothing could be estimated, if so

    @property
    def clear(self) -> bool:
        """Whether the lag can be told."""
        return abs(self.agreement) > _AGREE and self.chance <= _CHANCE

    @property
    def apart(self) -> bool:
        """Whether pure delay and first-order lag can be told apart, each to 15 ms or a quarter of their sum."""
        within = max(0.015, 0.25 * abs(self.seconds))
        return self.clear and 1.96 * max(self.pure_std, self.lag_std) < within

    @property
    def sentence(self) -> str:
        """The finding in words."""
        pair = f"no clear delay between {self.input} and {self.output}"
        if self.reason:
            return f"{pair}: {self.reason}"
        if self.chance > _CHANCE:
            return f"{pair}: what they have in common is no more than chance gives"
        if not self.clear:
            return f"{pair}: they move together, but their frequencies agree on no one lag"
        if self.seconds < 0:
            slow = ", or slow driving, where a_y is ahead" if self.output == "a_y" else ""
            return (
                f"{self.output} comes {-1000 * self.seconds:.0f} ms before {self.input}: swapped roles, feedback, or "
                f"clocks that disagree{slow}"
            )
        return f"{self.output} follows {self.input} by {1000 * self.seconds:.0f} ms: {self._parts()}"

    def _parts(self) -> str:
        split = ""
        if self.apart:  # else they may be no numbers
            times = (self.pure, self.pure_std), (self.lag, self.lag_std)
            pure, lag = (f"{round(1000 * v)} (±{np.ceil(1960 * s):.0f}) ms" for v, s in times)
            split = f"pure delay {pure} and a first-order lag of {lag}"
        if self.input in STEERING and self.output in MOTION:
            alike = f", in sum like {split}" if split else ""
            return f"delay, actuator and the car's own lag together{alike}; identify_car separates them with a model"
        return split or "how much of it is pure delay and how much lag, these data do not tell"


@dataclass(frozen=True, kw_only=True)
class _Spectra:
    """Windows of two channels: ``products`` (n_windows, n_lines) of their lines at ``f`` [Hz], and pooled powers."""

    f: np.ndarray
    products: np.ndarray
    s_uu: np.ndarray
    s_yy: np.ndarray
    powered: np.ndarray  # whether there is power at a line
    windows: int  # that do not overlap

    def coherence(self, cross: np.ndarray) -> np.ndarray:
        power = self.s_uu * self.s_yy
        return np.where(power > 0, np.abs(cross) ** 2 / np.where(power > 0, power, 1.0), 0.0)

    def chance(self) -> float:
        """How often windows are as coherent with signs drawn at random; of strangers, either is as likely."""
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (_DRAWS, len(self.products)))
        every = np.vstack([np.ones(len(self.products)), signs]) @ self.products[:, self.powered]
        power = (self.s_uu * self.s_yy)[self.powered] * len(self.products) ** 2
        tied = -np.log1p(-np.minimum(np.abs(every) ** 2 / power, 1 - 1e-9)).sum(axis=1)
        return float((tied >= tied[0] * (1 - 1e-9)).mean())


def _lines(x: np.ndarray, n: int, keep: np.ndarray) -> np.ndarray:
    """Spectra of half-overlapping windows, each without its own trend. (n_windows, n_lines)"""
    rows = np.lib.stride_tricks.sliding_window_view(x, n)[:: n // 2]
    return np.fft.rfft(scipy.signal.detrend(rows) * scipy.signal.get_window("hann", n))[:, keep]


def _spectra(data: Dataset, input: str, output: str, n: int, f_max: float) -> _Spectra:
    """Pooled over all experiments, in windows of ``n`` samples."""
    f = np.fft.rfftfreq(n, data.dt)
    keep = (f > 1.5 / (n * data.dt)) & (f <= f_max) & (f < 0.49 / data.dt)
    parts = [part for part in data.experiments if len(part) >= n]
    u, y = (np.concatenate([_lines(part[name], n, keep) for part in parts]) for name in (input, output))
    s_uu, s_yy = ((np.abs(x) ** 2).mean(axis=0) for x in (u, y))
    return _Spectra(
        f=f[keep],
        products=u.conj() * y,
        s_uu=s_uu,
        s_yy=s_yy,
        powered=(s_uu > _FLOOR * s_uu.max(initial=0.0)) & (s_yy > _FLOOR * s_yy.max(initial=0.0)),
        windows=sum(len(part) // n for part in parts),
    )


def _window(data: Dataset, longest: float) -> int:
    """Samples of a window: the longest up to ``10 longest`` of which all experiments together hold enough."""
    lengths = np.array([len(p) for p in data.experiments])
    least = max(16, int(np.ceil(4 * longest / data.dt - 1e-9)))
    most = min(round(10 * longest / data.dt), int(lengths.sum()) // _WINDOWS)  # longer ones are too few
    for n in range(most, least - 1, -1):
        overlapping = np.where(lengths < n, 0, (lengths - n) // (n // 2) + 1).sum()
        if (lengths // n).sum() >= _WINDOWS and overlapping >= 1.5 * _WINDOWS:
            return n
    whole = float((lengths[lengths >= least] // least * least).sum() * data.dt)
    raise TooShortError(
        f"stretches of '{data.name}' of {4 * longest:g} s and more add up to {whole:.3g} s (the longest lasts "
        f"{lengths.max() * data.dt:.3g} s); expected at least {32 * longest:g} s to tell a delay of up to {longest:g} "
        "s: record longer or search a shorter delay"
    )


def estimate_delay(data: Dataset, input: str, output: str, *, longest: float = 1.0, f_max: float = _FASTEST) -> Delay:
    """Estimate how long ``output`` takes to follow ``input``, over all experiments together.

    The cross spectrum is whitened and weighted by ``coherence / (1 - coherence)``, so frequencies count as much as they
    tell; its inverse transform, evaluated between the samples too, peaks at the lag sought [1]_. What comes out is the
    pure delay plus the lag of the dynamics. A fit of gain, pure delay and first-order lag to the frequency response
    splits it, where phase and amplitude tell them apart; it holds for a sensor or an actuator. A car's body has more
    dynamics than that, so between steering and yaw rate only a model separates what the car does from what is late.

    Raises MissingColumnError or ParameterError if a channel does not exist, or ``longest`` or ``f_max`` is not
    positive, and ExcitationError or TooShortError if a channel is constant, or the stretches that last ``4 longest``
    do not add up to ``32 longest``.

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
        Look at `Delay.clear` before using it, and at `Delay.apart` before using ``pure`` and ``lag``.

    References
    ----------
    .. [1] C. Knapp, G. Carter, "The generalized correlation method for estimation of time delay", IEEE Trans.
       Acoustics, Speech, and Signal Processing 24(4), 1976, 320-327 (Hannan-Thomson processor).
    """
    if not (longest > 0 and f_max > 0):
        raise ParameterError(f"longest is {longest} s and f_max is {f_max} Hz; expected positive numbers")
    for name in (input, output):
        if np.ptp(data[name]) <= 1e-12 * max(1.0, float(np.abs(data[name]).max())):
            raise ExcitationError(
                f"channel '{name}' is constant, so no delay can be told; expected it to move: drive a manoeuvre"
            )
    s = _spectra(data, input, output, _window(data, longest), f_max)
    cross = s.products.mean(axis=0)
    coherence = s.coherence(cross)
    significant = s.powered & (coherence > 1 - 0.05 ** (1 / (s.windows - 1)))
    if not significant.any():
        return Delay(input=input, output=output, seconds=0.0, agreement=0.0, coherent=0.0)
    c = np.minimum(coherence[significant], 0.9999)
    weight = c / (1 - c) * np.exp(1j * np.angle(cross[significant]))
    lags = np.linspace(-longest, longest, 2001)
    curve = np.real(np.exp(2j * np.pi * np.outer(lags, s.f[significant])) @ weight) / np.abs(weight).sum()
    best = int(np.argmax(np.abs(curve)))
    found = Delay(
        input=input,
        output=output,
        seconds=float(lags[best]),
        agreement=float(curve[best]),
        coherent=float(significant.sum() / max(s.powered.sum(), 1)),
        chance=s.chance(),
    )
    if not found.clear or found.seconds < 0:
        return found
    response = cross[significant] / s.s_uu[significant] * np.sign(found.agreement)
    return _split(found, s.f[significant], response, c, s.windows)


def _split(found: Delay, f: np.ndarray, response: np.ndarray, coherence: np.ndarray, windows: int) -> Delay:
    """Pure delay and first-order lag of a frequency response, by weighted least squares on its logarithm."""
    if len(f) < 6:
        return found
    s = 2j * np.pi * f
    width = np.sqrt((1 - coherence) / (2 * windows * coherence))  # of its logarithm, real and imaginary part alike
    level = np.log(np.abs(response))

    def misfit(p: np.ndarray) -> np.ndarray:
        model = np.exp(p[0] - s * p[1]) / (1 + s * p[2])
        ratio = response / model
        return np.concatenate([np.log(np.abs(ratio)), np.angle(ratio)]) / np.tile(width, 2)

    top, total = max(found.seconds, 1e-3), found.seconds
    tries = []
    for share in (0.0, 0.5, 1.0):
        start = [float(np.average(level, weights=width**-2)), (1 - share) * total, share * top]
        scale = [1.0, 0.01, 0.01]
        bounds = ([-np.inf, -top - 0.1, 0.0], [np.inf, 2 * top + 0.1, 5 * top + 0.1])
        tries.append(optimize.least_squares(misfit, start, bounds=bounds, x_scale=scale, loss="soft_l1"))
    fit = min(tries, key=lambda t: t.cost)
    spread = max(1.0, float(np.mean(misfit(fit.x) ** 2))) * 1.5  # neighbouring lines of a Hann window tell the same
    pure, lag = float(fit.x[1]), float(fit.x[2])
    for least in (0.0, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1):  # a short lag shows in the amplitude by its square alone
        near = max(lag, least)
        turn = 2 * np.pi * f / (1 + (2 * np.pi * f * near) ** 2)
        slopes = np.zeros((2 * len(f), 3))
        slopes[: len(f), 0] = 1.0
        slopes[: len(f), 2] = -2 * np.pi * f * near * turn
        slopes[len(f) :, 1], slopes[len(f) :, 2] = 2 * np.pi * f, turn
        slopes /= np.tile(width, 2)[:, None]
        information = slopes.T @ slopes
        if np.linalg.cond(information) < 1e14:
            std = np.sqrt(np.diag(np.linalg.inv(information)) * spread)
            if std[2] <= near:
                return replace(found, pure=pure, pure_std=float(std[1]), lag=lag, lag_std=float(std[2]))
    return found
