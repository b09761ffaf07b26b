"""Excitation signals: levels, spectra, timing, bad arguments."""

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.signals import excitation as excite

# ---- PRBS --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [3, 5, 8, 11])
def test_prbs_is_a_maximum_length_sequence(order):
    period = 2**order - 1
    u = excite.prbs(2 * period, order=order, amplitude=0.3)
    assert set(u) == {0.3, -0.3}
    one = u[:period]
    np.testing.assert_array_equal(one, u[period:])
    assert (one > 0).sum() == 2 ** (order - 1)
    circular = np.fft.ifft(np.abs(np.fft.fft(one / 0.3)) ** 2).real
    np.testing.assert_allclose(circular[1:], -1.0, atol=1e-9)
    assert circular[0] == pytest.approx(period)


def test_prbs_holds_each_bit():
    u = excite.prbs(1000, hold=7, seed=3)
    edges = np.flatnonzero(np.diff(u)) + 1
    assert (edges % 7 == 0).all()
    assert len(u) == 1000


def test_prbs_seeds():
    a, b = excite.prbs(500, seed=1), excite.prbs(500, seed=2)
    np.testing.assert_array_equal(a, excite.prbs(500, seed=1))
    assert (a != b).any()


# ---- multisine ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phases", ["schroeder", "random"])
@pytest.mark.parametrize(("n", "f_min", "f_max"), [(1000, 0.1, 4.0), (2000, 0.5, 10.0), (999, 0.2, 50.0)])
def test_multisine_has_its_lines_and_no_others(phases, n, f_min, f_max):
    u = excite.multisine(n, 0.01, f_min=f_min, f_max=f_max, amplitude=0.05, phases=phases)
    power = np.abs(np.fft.rfft(u))
    f = np.fft.rfftfreq(n, 0.01)
    inside = (f >= f_min - 1e-9) & (f <= f_max + 1e-9) & (np.arange(len(f)) < n / 2)
    assert np.ptp(power[inside]) < 1e-9 * power.max()
    assert power[~inside].max() < 1e-9 * power.max()
    assert np.abs(u).max() == pytest.approx(0.05)


def test_schroeder_phases_keep_the_crest_low():
    def crest(u):
        return np.abs(u).max() / u.std()

    kept = {"n": 4000, "dt": 0.01, "f_min": 0.1, "f_max": 5.0}
    schroeder = crest(excite.multisine(**kept))
    assert schroeder < 2.0
    assert all(crest(excite.multisine(**kept, phases="random", seed=s)) > schroeder + 0.5 for s in range(5))


# ---- swept sine --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["linear", "logarithmic"])
def test_sweep_runs_through_its_frequencies(method):
    n, dt = 20000, 0.005
    u = excite.swept_sine(n, dt, f_start=0.2, f_stop=4.0, amplitude=2.0, method=method)
    rising = np.flatnonzero((u[:-1] < 0) & (u[1:] >= 0)) * dt
    local = 1 / np.diff(rising)
    middle = (rising[1:] + rising[:-1]) / 2 / (n * dt)
    expected = 0.2 + 3.8 * middle if method == "linear" else 0.2 * 20**middle
    np.testing.assert_allclose(local, expected, rtol=0.05)
    assert u[0] == pytest.approx(0, abs=1e-12)
    assert u[1] > 0
    assert np.abs(u).max() == pytest.approx(2.0, rel=1e-3)


# ---- sine with dwell ---------------------------------------------------------------------------------------------


def test_sine_with_dwell_follows_the_regulation():
    dt = 0.001
    u = excite.sine_with_dwell(5000, dt, amplitude=100.0)
    t = dt * np.arange(5000)
    period = 1 / 0.7
    assert (u[t <= 1.0] == 0).all()
    assert (u[t >= 1.0 + period + 0.5] == 0).all()
    assert t[np.argmax(u)] == pytest.approx(1 + period / 4, abs=dt)
    assert t[np.argmin(u)] == pytest.approx(1 + 0.75 * period, abs=dt)
    dwelling = (t > 1 + 0.75 * period) & (t < 1.5 + 0.75 * period)
    assert (u[dwelling] == -100.0).all()
    assert dwelling.sum() * dt == pytest.approx(0.5, abs=2 * dt)
    moving = (t > 1) & (t < 1 + 0.75 * period)
    np.testing.assert_allclose(u[moving], 100 * np.sin(2 * np.pi * 0.7 * (t[moving] - 1)), atol=1e-9)
    assert np.abs(np.diff(u)).max() <= 100 * 2 * np.pi * 0.7 * dt * 1.001


def test_negative_amplitude_mirrors():
    left = excite.sine_with_dwell(400, 0.01, amplitude=1.0)
    np.testing.assert_array_equal(excite.sine_with_dwell(400, 0.01, amplitude=-1.0), -left)


# ---- step, ramp, staircase ---------------------------------------------------------------------------------------


def test_step_with_a_rise():
    u = excite.step(500, 0.01, amplitude=0.4, start=1.0, rise=0.2)
    np.testing.assert_allclose(u[[0, 100, 110, 120, 499]], [0, 0, 0.2, 0.4, 0.4], atol=1e-9)


def test_ramp_stops_at_its_limit():
    u = excite.ramp(1000, 0.01, rate=-0.1, start=2.0, limit=0.5)
    np.testing.assert_allclose(u[[0, 200, 300, 700, 999]], [0, 0, -0.1, -0.5, -0.5], atol=1e-12)
    assert excite.ramp(1000, 0.01, rate=1.0)[-1] == pytest.approx(8.99)


def test_staircase_levels_and_times():
    u = excite.staircase(400, 0.01, levels=(0.0, 1.0, -1.0), duration=1.0)
    np.testing.assert_array_equal(u[[0, 99, 100, 199, 200, 399]], [0, 0, 1, 1, -1, -1])


# ---- bad arguments -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "parts"),
    [
        (lambda: excite.prbs(0), ["0 samples", "at least 1"]),
        (lambda: excite.prbs(10, hold=0), ["hold is 0", "at least 1"]),
        (lambda: excite.prbs(10, order=1), ["order is 1", "2 to 24"]),
        (lambda: excite.multisine(100, 0.0, f_min=0.1, f_max=1), ["0.0 s", "positive"]),
        (lambda: excite.multisine(100, 0.01, f_min=0.1, f_max=51), ["f_max is 51", "50 Hz", "sample faster"]),
        (lambda: excite.multisine(100, 0.01, f_min=0.1, f_max=0.9), ["multiple of 1 Hz", "widen"]),
        (lambda: excite.multisine(100, 0.01, f_min=1, f_max=9, phases="flat"), ["'flat'", "'schroeder'"]),
        (lambda: excite.swept_sine(100, 0.01, f_start=0, f_stop=1), ["f_start is 0"]),
        (lambda: excite.swept_sine(100, 0.01, f_start=1, f_stop=60), ["f_stop is 60"]),
        (lambda: excite.swept_sine(100, 0.01, f_start=1, f_stop=6, method="cubic"), ["'cubic'"]),
        (lambda: excite.sine_with_dwell(100, 0.01, amplitude=1), ["2.929 s", "294 samples"]),
        (lambda: excite.sine_with_dwell(500, 0.01, amplitude=1, dwell=-1), ["-1 s", "negative"]),
        (lambda: excite.ramp(10, 0.1, rate=1, limit=-1), ["limit is -1"]),
        (lambda: excite.staircase(10, 0.1, levels=()), ["no level"]),
        (lambda: excite.staircase(10, 0.1, levels=(0, 1), starts=()), ["2 levels but 0 starts"]),
        (lambda: excite.staircase(10, 0.1, levels=(0, 1, 2), starts=(0.5, 0.4)), ["[0.5, 0.4]", "rising"]),
        (lambda: excite.step(10, 0.1, rise=-0.1), ["-0.1 s", "shorten"]),
    ],
)
def test_bad_arguments(call, parts):
    with pytest.raises(errors.SlipangleError) as caught:
        call()
    for part in (*parts, "expected"):
        assert part in str(caught.value)
