"""Spectral estimates against SciPy and the response of a known filter, their bands against how often they hold."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.data.signals.excitation import multisine
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.models.analysis.spectral_bands import gain_limits, phase_half

A, B, DT = 0.8, 0.3, 0.02


def log(n=6000, noise=0.0, seed=0, starts=(0,)):
    """A first-order lag of white noise, ``y(k) = A y(k-1) + B u(k-1)``."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = signal.lfilter([0.0, B], [1.0, -A], u) + noise * rng.standard_normal(n)
    data = sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT, units={"delta": "rad", "r": "rad/s"})
    if len(starts) == 1:
        return data
    edges = [*starts, n]
    return sa.join(*(data.rows(a, b) for a, b in pairwise(edges)), name="data")


def exact(f):
    z = np.exp(-2j * np.pi * f * DT)
    return B * z / (1 - A * z)


def test_it_is_scipys_estimate():
    data = log(noise=0.2)
    found = sa.frequency_response(data, resolution=0.25)
    n = 200
    about = {"fs": 1 / DT, "window": "hann", "nperseg": n, "noverlap": n // 2, "detrend": "linear"}
    f, s_uy = signal.csd(data["delta"], data["r"], **about)
    _, s_uu = signal.welch(data["delta"], **about)
    _, coherence = signal.coherence(data["delta"], data["r"], **about)
    assert found.frequency == pytest.approx(f[2:-1])
    assert found.value == pytest.approx((s_uy / s_uu)[2:-1], rel=1e-9)
    assert found.coherence == pytest.approx(coherence[2:-1], rel=1e-9)
    assert (found.output, found.input, found.unit) == ("r", "delta", "(rad/s)/rad")


def test_without_noise_it_is_the_filter():
    found = sa.frequency_response(log(n=20000), resolution=0.2)
    assert found.value == pytest.approx(exact(found.frequency), rel=0.03, abs=0.01)
    assert found.coherence.min() > 0.98


@pytest.mark.parametrize("starts", [(0,), (0, 1500, 4000)])
def test_bands_hold_as_often_as_they_say(starts):
    """Over 60 noises the 95 % bands of magnitude and phase hold the filter at 95 % of the lines, within 3 %."""
    inside = []
    for seed in range(60):
        found = sa.frequency_response(log(noise=0.5, seed=seed, starts=starts), resolution=0.5)
        true = exact(found.frequency)
        low, high = found.magnitude_band().T
        phase = np.abs(np.angle(found.value / true)) <= 1.959964 * found.phase_std
        inside.append([np.mean((low <= np.abs(true)) & (np.abs(true) <= high)), np.mean(phase)])
    assert np.mean(inside, axis=0) == pytest.approx([0.95, 0.95], abs=0.03)


def hidden(seed, b=(0.0, 1.0, 0.5), a=(1.0, -1.5, 0.7), dt=0.05):
    """A resonance in coloured noise, of which most hides what follows the input."""
    rng = np.random.default_rng(seed + 500)
    u = rng.standard_normal(4000)
    y = signal.lfilter(b, a, u) + 2 * signal.lfilter([1], [1, -0.5], rng.standard_normal(4000))
    found = sa.frequency_response(sa.Dataset.from_arrays({"u": u}, {"y": y}, dt), "y", "u")
    return found, signal.freqz(b, a, 2 * np.pi * found.frequency * dt)[1]


def test_bands_hold_at_any_coherence():
    """Over 150 sets, by the median coherence of the line: 95 % of gains and phases, no less where noise hides all."""
    gains, phases, coherences = [], [], []
    for seed in range(150):
        found, true = hidden(seed)
        low, high = found.magnitude_band().T
        gains.append((low <= abs(true)) & (abs(true) <= high))
        half = np.diff(found.phase_band())[:, 0] / 2
        phases.append(np.abs(np.angle(found.value / true)) <= half)
        coherences.append(found.coherence)
    usual = np.median(coherences, axis=0)
    for low, high in ((0, 0.05), (0.05, 0.1), (0.1, 0.2), (0.2, 0.4), (0.4, 1)):
        at = (usual >= low) & (usual < high)
        assert at.sum() > 5
        for held in (np.array(gains)[:, at].mean(), np.array(phases)[:, at].mean()):
            assert 0.935 < held < 0.99, (low, high)
    assert np.min(found.magnitude_band()[:, 0]) == 0
    assert np.abs(np.diff(found.phase_band())).max() == pytest.approx(2 * np.pi)
    assert len(found.plot().data) == 5


@pytest.mark.parametrize("freedom", [6.0, 14.0, 76.0])
@pytest.mark.parametrize("gain", [0.0, 0.5, 1.0, 2.0, 4.0, 10.0, 40.0])
def test_limits_of_a_gain_cover_it(freedom, gain):
    """A gain in normal noise of unit deviation, which is estimated: from none to far above the noise."""
    rng, n = np.random.default_rng(1), 20000
    seen = gain + rng.standard_normal(n) + 1j * rng.standard_normal(n)
    s = np.sqrt(rng.chisquare(freedom, n) / freedom) / np.abs(seen)
    low, high = gain_limits(s, freedom, 0.95).T * np.abs(seen)
    assert 0.94 < np.mean((low <= gain) & (gain <= high)) < 0.98
    assert (high >= np.abs(seen)).all()
    assert 0.94 < np.mean(np.abs(np.angle(seen)) <= phase_half(s, freedom, 0.95)) <= 1


def test_limits_of_a_clear_gain_are_students():
    s = np.array([0.0, 1e-6, 0.01, 0.0499, 0.0501])
    half = 2.2281388520 * s  # Student's t, ten degrees of freedom
    assert gain_limits(s, 10.0, 0.95) == pytest.approx(np.column_stack([1 - half, 1 + half]), abs=2e-3)
    assert phase_half(s, 10.0, 0.95) == pytest.approx(half, abs=3e-4)


def test_a_car_lies_within_the_band_of_its_own_log():
    """A bicycle is driven by filtered noise; its linear model is inside the 95 % band at most lines."""
    rng = np.random.default_rng(3)
    n = 8000
    car = sa.Bicycle(
        params=sa.BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5), dt=DT
    )
    delta = 0.02 * signal.lfilter(*signal.butter(2, 0.2), rng.standard_normal(n))
    still = sa.Dataset.from_arrays(
        {"delta": delta, "v_x": np.full(n, 20.0)}, {"r": np.zeros(n)}, DT, units={"v_x": "m/s", "delta": "rad"}
    )
    data = still.with_channel("r", car.simulate(still).y[:, 0] + 0.004 * rng.standard_normal(n), "rad/s")
    found = sa.frequency_response(data, resolution=0.25)
    model = sa.linearize(car, v_x=20.0).sampled(DT).bode("r", "delta", frequency=found.frequency)
    sure = found.coherence > 0.5
    low, high = found.magnitude_band()[sure].T
    held = np.mean((low <= model.magnitude[sure]) & (model.magnitude[sure] <= high))
    assert sure.sum() > 15
    assert held > 0.8
    drawn = found.plot(model)
    assert drawn.layout.yaxis3.title.text == "coherence"
    assert repr(found).startswith("<FrequencyResponse of 'data': delta to r")


def test_lines_without_power_are_left_out():
    t = DT * np.arange(4000)
    u = np.sin(2 * np.pi * 1.0 * t)
    data = sa.Dataset.from_arrays({"u": u}, {"y": 2 * u}, DT)
    found = sa.frequency_response(data, resolution=0.25)
    assert np.abs(found.frequency - 1.0).max() < 4.0
    assert found.value[np.argmin(np.abs(found.frequency - 1.0))] == pytest.approx(2.0, rel=1e-9)
    assert found.unit == "-"


@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"output": "rr"}, ParameterError, "no channel 'rr'; nearest are 'r'"),
        ({"resolution": 50.0}, ParameterError, "resolution is 50 Hz; expected 0.00833 to 3.12 Hz"),
        ({"resolution": 0.01}, TooShortError, "has 1 segments of 100 s; expected at least 4"),
    ],
)
def test_bad_input_gets_a_sentence(given, error, said):
    with pytest.raises(error, match=said):
        sa.frequency_response(log(), **given)


def test_an_input_that_does_not_move_is_refused():
    still = log().with_channel("delta", np.ones(6000), "rad")
    with pytest.raises(ExcitationError, match="'delta' does not move"):
        sa.frequency_response(still)
    with pytest.raises(ParameterError, match="names no input"):
        sa.frequency_response(log().select(inputs=()))


def repeated(seed, *, periods=8, noise=0.1, input_noise=0.0, n=200, dt=0.05):
    rng = np.random.default_rng(seed)
    wave = multisine(n, dt, f_min=0.1, f_max=4.0, phases="random", seed=5)
    u = np.tile(wave, periods)
    y = signal.lfilter([0.0, 0.4, 0.1], [1.0, -1.4, 0.6], u) + noise * rng.standard_normal(len(u))
    return sa.Dataset.from_arrays({"u": u + input_noise * rng.standard_normal(len(u))}, {"y": y}, dt)


def test_whole_periods_have_no_leakage():
    found = sa.frequency_response(repeated(0, noise=0.0), period=10.0, settled=2)
    _, exact = signal.freqz([0.0, 0.4, 0.1], [1.0, -1.4, 0.6], 2 * np.pi * 0.05 * found.frequency)
    assert found.value == pytest.approx(exact, rel=1e-9)
    assert found.frequency == pytest.approx(np.arange(1, 41) / 10.0)


@pytest.mark.parametrize(("periods", "input_noise"), [(6, 0.0), (6, 0.02), (12, 0.05)])
def test_bands_of_periods_cover(periods, input_noise):
    inside = []
    for seed in range(40):
        found = sa.frequency_response(repeated(seed, periods=periods, input_noise=input_noise), period=10.0)
        _, exact = signal.freqz([0.0, 0.4, 0.1], [1.0, -1.4, 0.6], 2 * np.pi * 0.05 * found.frequency)
        band, phase = found.magnitude_band(), found.phase - np.unwrap(np.angle(exact))
        inside += [*((band[:, 0] <= np.abs(exact)) & (np.abs(exact) <= band[:, 1]))]
        inside += [*(np.abs(np.angle(np.exp(1j * phase))) <= 1.96 * found.phase_std)]
    assert 0.93 <= np.mean(inside) <= 0.97


def test_a_period_that_is_none_is_said():
    data = repeated(0)
    with pytest.raises(ParameterError, match="whole number of samples"):
        sa.frequency_response(data, period=10.01)
    with pytest.raises(TooShortError, match="whole periods"):
        sa.frequency_response(data, period=30.0)
    with pytest.raises(ParameterError, match="expected one"):
        sa.frequency_response(data, period=10.0, resolution=0.1)


@pytest.mark.parametrize("seconds", [1.0, 3.0])
def test_a_delay_neither_lowers_the_gain_nor_lies_beside_the_bands(seconds):
    """White input, noise of a fifth: without moving the output, a delay of 3 s showed half of the gain."""
    inside, delay = [], round(seconds / 0.05)
    for seed in range(12):
        rng = np.random.default_rng(seed)
        u = rng.standard_normal(4500)
        y = signal.lfilter([0.5], [1, -0.5], np.concatenate([np.zeros(delay), u])[:4500])
        y += 0.2 * y.std() * rng.standard_normal(4500)
        found = sa.frequency_response(sa.Dataset.from_arrays({"u": u[500:]}, {"y": y[500:]}, 0.05))
        z = np.exp(2j * np.pi * found.frequency * 0.05)
        true = 0.5 / (1 - 0.5 / z) * z**-delay
        low, high = found.magnitude_band().T
        inside.append((low <= np.abs(true)) & (np.abs(true) <= high))
        assert np.median(np.abs(np.angle(found.value / true))) < 0.05
    assert 0.92 < np.mean(inside) < 0.98
