"""Signals that excite a vehicle or a model: PRBS, multisine, swept sine, sine with dwell, step, ramp, staircase.

Every function takes the number of samples ``n`` and, where time matters, the sample time ``dt`` [s], and returns an
array of shape ``(n,)`` in the unit of ``amplitude`` (of ``levels``, of ``limit``); positive is positive, so a steering
signal starts to the left. Every one raises ParameterError for a number out of its range, and TooShortError where ``n``
is below 1 or too small for the signal.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy

from slipangle.errors import ParameterError, TooShortError

Phases = Literal["schroeder", "random"]
Sweep = Literal["linear", "logarithmic"]
_FEWEST_BITS, _MOST_BITS = 2, 24


def _check(n: int, dt: float = 1.0) -> None:
    if n < 1:
        raise TooShortError(f"the signal has {n} samples; expected at least 1: make it longer")
    if not dt > 0:
        raise ParameterError(f"the sample time is {dt} s; expected a positive number, such as 0.01")


def _below_nyquist(frequency: float, dt: float, what: str) -> None:
    if not 0 < frequency <= 0.5 / dt * (1 + 1e-9):
        raise ParameterError(
            f"{what} is {frequency} Hz; expected between 0 and half the sample rate, {0.5 / dt:g} Hz: lower it or "
            "sample faster"
        )


def time(n: int, dt: float) -> np.ndarray:
    """Instants 0, dt, 2 dt, ..., shape (n,). [s]"""
    return dt * np.arange(n)


def prbs(n: int, *, amplitude: float = 1.0, hold: int = 1, order: int | None = None, seed: int = 0) -> np.ndarray:
    """Pseudo-random binary sequence: ``+amplitude`` and ``-amplitude``, a maximum-length shift register.

    Source: L. Ljung, System Identification: Theory for the User, 2nd ed., Prentice Hall, 1999, sec. 13.3.

    Parameters
    ----------
    n, amplitude
        Samples; half the distance between the levels.
    hold : int
        Samples for which each bit is held; most power lies below ``0.44 / (hold dt)`` Hz.
    order : int, optional
        Bits of the register; the sequence repeats after ``hold (2**order - 1)`` samples. By default the
        smallest that does not repeat within ``n``.
    seed : int
        Chooses the register's first state, that is where in its period the sequence starts.

    >>> prbs(6, order=3, seed=1).tolist() == prbs(13, order=3, seed=1)[7:].tolist()
    True
    """
    _check(n)
    if hold < 1:
        raise ParameterError(f"hold is {hold} samples; expected at least 1: each bit lasts that long")
    bits = -(-n // hold)
    if order is None:
        order = int(np.clip(bits.bit_length(), _FEWEST_BITS, _MOST_BITS))
    if not _FEWEST_BITS <= order <= _MOST_BITS:
        raise ParameterError(f"order is {order}; expected {_FEWEST_BITS} to {_MOST_BITS} bits of shift register")
    state = np.zeros(order, dtype=np.int8)
    while not state.any():
        rng = np.random.default_rng(seed)
        state = rng.integers(0, 2, order, dtype=np.int8)
        seed += 1
    sequence, _ = scipy.signal.max_len_seq(order, state=state, length=bits)
    return amplitude * np.repeat(2.0 * sequence - 1.0, hold)[:n]


def multisine(
    n: int,
    dt: float,
    *,
    f_min: float,
    f_max: float,
    amplitude: float = 1.0,
    phases: Phases = "schroeder",
    seed: int = 0,
) -> np.ndarray:
    """Sum of equally strong sines at every multiple of ``1 / (n dt)`` between two frequencies.

    One period is ``n`` samples: repeat it with `numpy.tile`, drop the transient, and its spectrum has
    lines at exactly these frequencies and nowhere else.

    Source: M. R. Schroeder, "Synthesis of low-peak-factor signals and binary sequences with low autocorrelation", IEEE
    Trans. Information Theory 16(1), 1970, 85-89.

    Parameters
    ----------
    n, dt, amplitude
        Samples of one period, their distance [s], largest absolute value. The mean is zero.
    f_min, f_max : float
        Lowest and highest frequency, at most half the sample rate. [Hz]
    phases : {"schroeder", "random"}
        Schroeder's phases keep the peak low for the power; random ones use ``seed``.
    """
    _check(n, dt)
    _below_nyquist(f_max, dt, "f_max")
    resolution = 1 / (n * dt)
    lines = np.arange(max(1, int(np.ceil(f_min / resolution - 1e-9))), int(f_max / resolution + 1e-9) + 1)
    lines = lines[lines < n / 2]
    if len(lines) == 0:
        raise ParameterError(
            f"no multiple of {resolution:.4g} Hz lies between f_min = {f_min} and f_max = {f_max} Hz; expected at "
            "least one: widen the band or lengthen the period"
        )
    k = np.arange(1, len(lines) + 1)
    phase = -np.pi * k * (k - 1) / len(lines)
    if phases == "random":
        phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(lines))
    elif phases != "schroeder":
        raise ParameterError(f"phases is {phases!r}; expected 'schroeder' or 'random': choose one")
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    spectrum[lines] = np.exp(1j * phase)
    wave = np.fft.irfft(spectrum, n)
    return amplitude * wave / np.abs(wave).max()


def swept_sine(
    n: int, dt: float, *, f_start: float, f_stop: float, amplitude: float = 1.0, method: Sweep = "logarithmic"
) -> np.ndarray:
    """Sine whose frequency runs from ``f_start`` to ``f_stop``; it starts at zero, rising.

    Source: ISO 7401:2011, Road vehicles - Lateral transient response test methods, continuous sinusoidal input.

    Parameters
    ----------
    n, dt, amplitude
        Samples, their distance [s], peak value.
    f_start, f_stop : float
        First and last frequency, at most half the sample rate. [Hz]
    method : {"linear", "logarithmic"}
        Constant hertz, or constant octaves, per second.
    """
    _check(n, dt)
    for what, frequency in (("f_start", f_start), ("f_stop", f_stop)):
        _below_nyquist(frequency, dt, what)
    if method not in ("linear", "logarithmic"):
        raise ParameterError(f"method is {method!r}; expected 'linear' or 'logarithmic': choose one")
    return amplitude * scipy.signal.chirp(
        time(n, dt), f0=f_start, f1=f_stop, t1=max((n - 1) * dt, dt), method=method, phi=-90
    )


def sine_with_dwell(
    n: int, dt: float, *, amplitude: float, frequency: float = 0.7, dwell: float = 0.5, start: float = 1.0
) -> np.ndarray:
    """One period of a sine that waits at its second peak: the stability test of FMVSS 126 and ISO 19365.

    Parameters
    ----------
    n, dt, amplitude
        Samples, their distance [s], peak value; positive steers to the left first.
    frequency : float
        Of the sine. [Hz]
    dwell, start : float
        Pause at three quarters of the period, zeros before the manoeuvre, which lasts
        ``start + 1 / frequency + dwell``. [s]

    References
    ----------
    .. [1] 49 CFR 571.126, S7.9.
    .. [2] ISO 19365:2016, Passenger cars - Validation of vehicle dynamic simulation - Sine with dwell
       stability control testing.

    >>> float(sine_with_dwell(450, 0.01, amplitude=1.0)[round((1.0 + 0.75 / 0.7) / 0.01) + 25])
    -1.0
    """
    _check(n, dt)
    _below_nyquist(frequency, dt, "the sine's frequency")
    if dwell < 0 or start < 0:
        raise ParameterError(f"dwell is {dwell} s and start is {start} s; expected no negative time")
    needed = start + 1 / frequency + dwell
    if (n - 1) * dt < needed - dt:
        raise TooShortError(
            f"the signal lasts {(n - 1) * dt:.4g} s, the manoeuvre ends at {needed:.4g} s; expected room for it: take "
            f"at least {int(np.ceil(needed / dt)) + 1} samples"
        )
    t = time(n, dt) - start
    peak = 0.75 / frequency
    running = np.where(t < peak, t, np.maximum(t - dwell, peak))
    inside = (running > 0) & (running < 1 / frequency)
    return amplitude * np.where(inside, np.sin(2 * np.pi * frequency * running), 0.0)


def step(n: int, dt: float, *, amplitude: float = 1.0, start: float = 1.0, rise: float = 0.0) -> np.ndarray:
    """Zero, then a straight rise of ``rise`` [s] from ``start`` [s] on, then ``amplitude``.

    >>> step(5, 0.1, start=0.2).tolist()
    [0.0, 0.0, 1.0, 1.0, 1.0]
    """
    return staircase(n, dt, levels=(0.0, amplitude), starts=(start,), rise=rise)


def ramp(n: int, dt: float, *, rate: float, start: float = 1.0, limit: float | None = None) -> np.ndarray:
    """Zero, then rising by ``rate`` per second from ``start`` [s] on, up to ``limit`` in absolute value.

    The slowly increasing steer of FMVSS 126 is ``rate`` = 13.5 deg/s at the steering wheel.
    """
    _check(n, dt)
    if limit is not None and limit < 0:
        raise ParameterError(f"the ramp's limit is {limit}; expected an absolute value, not below 0")
    wave = rate * np.maximum(time(n, dt) - start, 0.0)
    return wave if limit is None else np.clip(wave, -limit, limit)


def staircase(
    n: int,
    dt: float,
    *,
    levels: Sequence[float],
    duration: float | None = None,
    starts: Sequence[float] | None = None,
    rise: float = 0.0,
) -> np.ndarray:
    """Levels one after another, each reached by a straight rise.

    Parameters
    ----------
    n, dt
        Samples and their distance. [s]
    levels : sequence of float
        The first holds from time 0 on, the last to the end.
    duration : float, optional
        Time from one level to the next; by default they share the signal evenly. [s]
    starts : sequence of float, optional
        When each level after the first begins, instead of ``duration``. [s]
    rise : float
        Time from one level to the next one's full height. [s]

    >>> staircase(6, 0.1, levels=(1.0, 3.0, 2.0)).tolist()
    [1.0, 1.0, 3.0, 3.0, 2.0, 2.0]
    """
    _check(n, dt)
    if len(levels) == 0:
        raise ParameterError("the staircase has no level; expected at least one: give levels=")
    if starts is None:
        each = n * dt / len(levels) if duration is None else duration
        starts = [each * k for k in range(1, len(levels))]
    if len(starts) != len(levels) - 1:
        raise ParameterError(f"{len(levels)} levels but {len(starts)} starts; expected one start after the first level")
    if rise < 0 or any(b - a < rise for a, b in pairwise(starts)):
        raise ParameterError(
            f"the levels start at {list(starts)[:8]} s and take {rise} s to reach; expected rising times at least that "
            "far apart: shorten the rise"
        )
    t = time(n, dt) + 1e-9 * dt
    wave = np.full(n, float(levels[0]))
    for begin, before, after in zip(starts, levels, levels[1:], strict=False):
        share = np.clip((t - begin) / rise, 0.0, 1.0) if rise > 0 else (t >= begin).astype(float)
        wave += share * (after - before)
    return wave
