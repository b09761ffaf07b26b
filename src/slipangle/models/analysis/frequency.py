"""`frequency_response`: what a log itself says of gain and phase, with coherence and bands, to lay models over."""

from __future__ import annotations

import numpy as np
from scipy import signal

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError, nearest
from slipangle.models.analysis.responses import FrequencyResponse

_AVERAGES = 8  # segments that the usual resolution leaves
_LEAST = 4  # segments below which coherence says nothing
_SHORTEST = 16  # samples of a segment
_OVERLAP = 1 / 36  # correlation of the periodograms of neighbouring Hann windows that overlap by half
_POWERED = 1e-6  # of the largest power of the input, below which a line is left out


def frequency_response(
    data: Dataset,
    output: str | None = None,
    input: str | None = None,
    *,
    resolution: float | None = None,
) -> FrequencyResponse:
    """Frequency response from an input to an output of a log: Welch's spectra, coherence, bands.

    The spectra are means over half-overlapping segments with a Hann window, of every experiment, each segment without
    its trend; the response is the cross spectrum over the input's (H1), which noise on the output does not bias. Bands
    are those of Bendat and Piersol, from the coherence and the number of segments. Left out are lines where the input
    has hardly any power, and the lowest, which the trend is taken from. What other inputs do is noise to this estimate:
    drive at one speed.

    Raises ParameterError if a channel or the resolution is none, TooShortError if the log has fewer than 4 segments of
    it, and ExcitationError if the input does not move.

    Parameters
    ----------
    data : Dataset
        The log; samples of the input are taken as they are, see `Dataset.hold_mean`.
    output, input : str, optional
        Channels; by default the first output and the first input.
    resolution : float, optional
        Distance of the lines: finer ones are less sure. By default as fine as 8 segments allow, at most 10 s each. [Hz]

    For example ``sa.frequency_response(data, "r", "delta").plot(sa.linearize(model, v_x=20.0).bode("r", "delta"))``.

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., 2010, sec. 9.2.
    .. [2] P. D. Welch, IEEE Trans. Audio and Electroacoustics 15(2), 1967.
    """
    y_name, u_name = _chosen(data, output, "output"), _chosen(data, input, "input")
    n = _segment(data, resolution)
    parts = [part for part in data.experiments if len(part) >= n]
    count = sum(1 + (len(part) - n) // (n // 2) for part in parts)
    if count < _LEAST:
        raise TooShortError(
            f"'{data.name}' has {count} segments of {n * data.dt:.3g} s; expected at least {_LEAST}: take a coarser "
            "resolution or record longer"
        )
    u, y = (np.concatenate([_spectra(part[name], n) for part in parts]) for name in (u_name, y_name))
    s_uu, s_yy = (np.mean(np.abs(x) ** 2, axis=0) for x in (u, y))
    s_uy = np.mean(u.conj() * y, axis=0)
    f = np.fft.rfftfreq(n, data.dt)
    flat = all(np.ptp(part[u_name]) == 0 for part in parts)
    kept = (f > 1.5 / (n * data.dt)) & (s_uu > _POWERED * s_uu.max()) & (f < 0.5 / data.dt * (1 - 1e-9))
    if flat or not kept.any():
        raise ExcitationError(f"'{u_name}' does not move in '{data.name}'; expected an input that excites the car")
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.where(s_yy > 0, np.abs(s_uy) ** 2 / (s_uu * s_yy), 0.0)[kept].clip(0.0, 1.0)
        independent = count / (1 + 2 * _OVERLAP * (count - 1) / count)
        std = np.sqrt((1 - coherence) / (2 * independent * coherence))
    return FrequencyResponse(
        frequency=f[kept],
        value=(s_uy / s_uu)[kept],
        magnitude_std=std,
        phase_std=std,
        output=y_name,
        input=u_name,
        unit=_per(data.unit(y_name), data.unit(u_name)),
        name=data.name,
        coherence=coherence,
    )


def _chosen(data: Dataset, name: str | None, role: str) -> str:
    """A channel as named, else the first input or output."""
    own = data.outputs if role == "output" else data.inputs
    if name is None:
        if not own:
            raise ParameterError(f"'{data.name}' names no {role}; expected one: {role}='r' or another of its channels")
        return own[0]
    if name not in data:
        raise ParameterError(f"'{data.name}' has no channel '{name}'; {nearest(name, data.names)}")
    return name


def _segment(data: Dataset, resolution: float | None) -> int:
    """Samples of a segment, even."""
    if resolution is None:
        longest = max(len(part) for part in data.experiments)
        n = int(min(2 * data.n_samples / (_AVERAGES + 1), longest, 10.0 / data.dt))
        return max(_SHORTEST, n // 2 * 2)
    finest, coarsest = 1 / (data.n_samples * data.dt), 1 / (_SHORTEST * data.dt)
    if not finest <= resolution <= coarsest:
        raise ParameterError(
            f"resolution is {resolution:g} Hz; expected {finest:.3g} to {coarsest:.3g} Hz, from the whole log to "
            f"{_SHORTEST} samples"
        )
    return max(_SHORTEST, round(1 / (resolution * data.dt)) // 2 * 2)


def _spectra(x: np.ndarray, n: int) -> np.ndarray:
    """Spectra of half-overlapping windows, shape (n_segments, n // 2 + 1)."""
    rows = np.lib.stride_tricks.sliding_window_view(x, n)[:: n // 2]
    return np.fft.rfft(signal.detrend(rows) * signal.get_window("hann", n))


def _per(above: str, below: str) -> str:
    """Unit of one channel over another."""
    if above == below:
        return "-"
    over, under = (f"({u})" if "/" in u or " " in u else u for u in ("1" if above == "-" else above, below))
    return above if below == "-" else f"{over}/{under}"
