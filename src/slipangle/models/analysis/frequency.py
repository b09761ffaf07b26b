"""`frequency_response`: what a log itself says of gain and phase, with coherence and bands, to lay models over."""

from __future__ import annotations

import numpy as np
import scipy

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError, nearest
from slipangle.models.analysis.responses import FrequencyResponse
from slipangle.models.analysis.spectral_bands import student

_AVERAGES = 8  # segments that the usual resolution leaves
_LEAST = 4  # segments below which coherence says nothing
_SHORTEST = 16  # samples of a segment
_OVERLAP = 1 / 36  # correlation of the periodograms of neighbouring Hann windows that overlap by half
_CHANCE = 5.0  # deviations of a correlation of white signals, above which a delay is looked for
_PROMPT = 0.02  # of a segment, by which an output may come late without being moved
_AS_GOOD = 0.95  # of the largest correlation, for which the shortest delay is taken
_EXCITED, _ABOVE = 1e-4, 10.0  # of the largest line's power, and of its noise, above which a line was driven on purpose
_POWERED = 1e-6  # of the largest power of the input, below which a line is left out


def frequency_response(
    data: Dataset,
    output: str | None = None,
    input: str | None = None,
    *,
    resolution: float | None = None,
    period: float | None = None,
    settled: int = 1,
) -> FrequencyResponse:
    """Frequency response from an input to an output of a log: Welch's spectra, coherence, bands.

    The spectra are means over half-overlapping segments with a Hann window, of every experiment, each segment without
    its trend; the response is the cross spectrum over the input's (H1), which noise on the output does not bias. Bands
    come of the coherence and the number of segments, which the noise is estimated from ([1]_ sec. 9.2); they hold at
    any coherence, of a system whose answer is over within a segment: ringing that lasts longer leaks. An output that
    comes late is first moved to where it correlates most with the input, as segments of the two would else show less
    and less of each other ([1]_ sec. 8.5), and the phase of that delay is given back.

    Left out are lines where the input has hardly any power, and the lowest, which the trend is taken from. What other
    inputs do is noise to this estimate: drive at one speed.

    Where the input repeats itself, as a multisine does, ``period`` says so: spectra of whole periods have no leakage
    ([3]_ sec. 2.5), the mean over the periods is the estimate, and their scatter is the noise, on the input too. The
    lines are then all that the input excites. Bands count how few periods there were (Student's t).

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
    period : float, optional
        Of an input that repeats itself, a whole number of samples; instead of ``resolution``. [s]
    settled : int
        Periods at the start of every experiment that are left out, while the car comes to repeat itself too.

    For example ``sa.frequency_response(data, "r", "delta").plot(sa.linearize(model, v_x=20.0).bode("r", "delta"))``.

    References
    ----------
    .. [1] J. S. Bendat, A. G. Piersol, Random Data, 4th ed., 2010, sec. 9.2.
    .. [2] P. D. Welch, IEEE Trans. Audio and Electroacoustics 15(2), 1967.
    .. [3] R. Pintelon, J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., 2012.
    """
    y_name, u_name = chosen(data, output, "output"), chosen(data, input, "input")
    if period is not None:
        if resolution is not None:
            raise ParameterError("there is a period and a resolution; expected one: the lines are 1 / period apart")
        return _periodic(data, y_name, u_name, period, settled)
    n = _segment(data, resolution)
    parts = [part for part in data.experiments if len(part) >= n]
    count = sum(1 + (len(part) - n) // (n // 2) for part in parts)
    if count < _LEAST:
        raise TooShortError(
            f"'{data.name}' has {count} segments of {n * data.dt:.3g} s; expected at least {_LEAST}: take a coarser "
            "resolution or record longer"
        )
    late = _delay(parts, u_name, y_name, n)
    u = np.concatenate([_spectra(part[u_name][: len(part) - late], n) for part in parts])
    y = np.concatenate([_spectra(part[y_name][late:], n) for part in parts])
    count = len(u)
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
        freedom = 2 * (independent - 1)
        std = student(freedom) * np.sqrt((1 - coherence) / (freedom * coherence))
    return FrequencyResponse(
        frequency=f[kept],
        value=(s_uy / s_uu * np.exp(-2j * np.pi * f * (late * data.dt)))[kept],
        magnitude_std=std,
        phase_std=std,
        output=y_name,
        input=u_name,
        unit=per(data.unit(y_name), data.unit(u_name)),
        name=data.name,
        coherence=coherence,
        freedom=freedom,
    )


def _periodic(data: Dataset, y_name: str, u_name: str, period: float, settled: int) -> FrequencyResponse:
    """Mean over whole periods, and its scatter. [3]_ of `frequency_response`, eqs. 2-31 to 2-40"""
    n = round(period / data.dt) if np.isfinite(period) else 0
    if n < _SHORTEST // 2 or abs(n * data.dt - period) > 1e-6 * period or settled < 0:
        raise ParameterError(
            f"period is {period:g} s and settled {settled}; expected a whole number of samples of {data.dt:g} s, at "
            f"least {_SHORTEST // 2}, and no periods below 0"
        )
    whole = [(part, len(part) // n) for part in data.experiments]
    count = sum(max(0, k - settled) for _, k in whole)
    if count < _LEAST:
        raise TooShortError(
            f"'{data.name}' has {count} whole periods of {period:.3g} s after the first {settled} of each experiment; "
            f"expected at least {_LEAST}: record more of them"
        )
    u, y = (
        np.concatenate(
            [np.fft.rfft(part[name][settled * n : k * n].reshape(-1, n)) for part, k in whole if k > settled]
        )
        for name in (u_name, y_name)
    )
    mean_u, mean_y = u.mean(axis=0), y.mean(axis=0)
    off_u, off_y = u - mean_u, y - mean_y
    var_u, var_y = (np.sum(np.abs(d) ** 2, axis=0) / (count - 1) for d in (off_u, off_y))
    both = np.sum(off_y * off_u.conj(), axis=0) / (count - 1)
    f, power = np.fft.rfftfreq(n, data.dt), np.abs(mean_u) ** 2
    inner = (f > 0) & (f < 0.5 / data.dt * (1 - 1e-9))
    most = np.max(power, where=inner, initial=0.0)
    kept = inner & (power > _EXCITED * most) & (power > _ABOVE * var_u / count) & (mean_y != 0)
    if most == 0 or not kept.any():
        raise ExcitationError(
            f"'{u_name}' does not repeat itself every {period:g} s in '{data.name}'; expected the period of the input"
        )
    above, below = mean_y[kept], mean_u[kept]
    cross = np.real(both[kept] / (above * below.conj()))
    relative = var_y[kept] / np.abs(above) ** 2 + var_u[kept] / np.abs(below) ** 2 - 2 * cross
    freedom = 2.0 * (count - 1)
    std = student(freedom) * np.sqrt(np.maximum(relative, 0.0) / (2 * count))
    return FrequencyResponse(
        frequency=f[kept],
        value=above / below,
        magnitude_std=std,
        phase_std=std,
        output=y_name,
        input=u_name,
        unit=per(data.unit(y_name), data.unit(u_name)),
        name=data.name,
        coherence=np.abs(above) ** 2 / (np.abs(above) ** 2 + var_y[kept]),
        freedom=freedom,
    )


def chosen(data: Dataset, name: str | None, role: str) -> str:
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
        n = int(min(2 * data.n_samples / (_AVERAGES + 1), data.n_longest, 10.0 / data.dt))
        return max(_SHORTEST, n // 2 * 2)
    finest, coarsest = 1 / (data.n_samples * data.dt), 1 / (_SHORTEST * data.dt)
    if not finest <= resolution <= coarsest:
        raise ParameterError(
            f"resolution is {resolution:g} Hz; expected {finest:.3g} to {coarsest:.3g} Hz, from the whole log to "
            f"{_SHORTEST} samples"
        )
    return max(_SHORTEST, round(1 / (resolution * data.dt)) // 2 * 2)


def _delay(parts: list[Dataset], u_name: str, y_name: str, n: int) -> int:
    """Samples by which the output comes later than the input, where they correlate most; 0 where that is chance.

    Of several about as good, as of a wave, the shortest; no more than leaves 4 segments of ``n`` samples in each part.
    """
    most = min(len(part) for part in parts) - n * (_LEAST + 1) // 2
    if most < 1:
        return 0
    total, power, length = np.zeros(most + 1), np.zeros(2), 0
    for part in parts:
        u, y = (scipy.signal.detrend(part[name]) for name in (u_name, y_name))
        total += scipy.signal.correlate(y, u, mode="full", method="fft")[len(u) - 1 : len(u) + most]
        power += np.array([u @ u, y @ y])
        length += len(u)
    size = np.abs(total) / max(float(np.sqrt(np.prod(power))), 1e-300)
    if not size.max() > _CHANCE / np.sqrt(length):
        return 0
    late = int(np.argmax(size >= _AS_GOOD * size.max()))
    return late if late > _PROMPT * n else 0


def _spectra(x: np.ndarray, n: int) -> np.ndarray:
    """Spectra of half-overlapping windows, shape (n_segments, n // 2 + 1)."""
    rows = np.lib.stride_tricks.sliding_window_view(x, n)[:: n // 2]
    return np.fft.rfft(scipy.signal.detrend(rows) * scipy.signal.get_window("hann", n))


def per(above: str, below: str) -> str:
    """Unit of one channel over another."""
    if above == below:
        return "-"
    over, under = (f"({u})" if "/" in u or " " in u else u for u in ("1" if above == "-" else above, below))
    return above if below == "-" else f"{over}/{under}"
