"""The public logs: loaded in SI units with the facts that are known of them."""

import re

import numpy as np
import pytest

from slipangle import errors
from slipangle.data.public.sets import LOADERS, ferrari_250lm, public
from slipangle.data.quality.inspect import estimate_delay, find_jumps, inspect

pytestmark = pytest.mark.usefixtures("real_data")

SPIKES = {207.27: 0.136, 503.49: 0.149, 524.85: 0.220, 671.67: 0.526}
JUMPS = [191.67, 272.30, 299.35, 469.23, 496.75, 515.64, 527.43, 527.68, 646.32]


@pytest.fixture(scope="module")
def run(real_data):
    return public("ferrari-250lm")


@pytest.fixture(scope="module")
def slow(real_data):
    return ferrari_250lm()


def agree(a, b):
    """Slope and correlation of b over a."""
    return np.polyfit(a, b, 1)[0], np.corrcoef(a, b)[0, 1]


# ---- Ferrari -----------------------------------------------------------------------------------------------------


def test_ferrari_run_is_what_it_is(run):
    assert (run.n_samples, run.dt, run.starts, run.start_times) == (55001, 0.01, (0,), (149.99,))
    assert run.inputs == ("delta", "v_x")
    assert run.outputs == ("r",)
    assert run.unit("r") == "rad/s"
    np.testing.assert_allclose(run["beta"], np.arctan2(run["v_y"], run["v_x"]), atol=1e-8)
    np.testing.assert_allclose(run["delta"], (run["delta_fl"] + run["delta_fr"]) / 2, atol=1e-8)
    assert 16 < run["v_x"].min() < run["v_x"].max() < 62
    assert np.abs(run["r"]).max() == pytest.approx(0.596, abs=1e-3)


def test_ferrari_signs_are_iso(run):
    slope, correlation = agree(run["v_x"] * run["r"], run["a_y"])
    assert slope == pytest.approx(1.0, abs=0.05)
    assert correlation > 0.95
    assert agree(run["delta"], run["r"])[1] > 0.9


def test_ferrari_only_the_filtered_yaw_rate_is_in_degrees(run, real_data):
    filtered = np.loadtxt(real_data("revs_250lm/run_20140222_01_01/yawRateFilt.txt"))
    slope, correlation = agree(np.radians(filtered), run["r"])
    assert slope == pytest.approx(1.0, abs=1e-3)
    assert correlation > 0.9999


def test_ferrari_dead_reckoning_closes_its_laps(run):
    turns = (run["psi"][-1] - run["psi"][0]) / (2 * np.pi)
    assert turns == pytest.approx(-5.5, abs=0.1)
    speed = np.hypot(np.gradient(run["X"], run.dt), np.gradient(run["Y"], run.dt))
    np.testing.assert_allclose(speed[5:-5], np.hypot(run["v_x"], run["v_y"])[5:-5], atol=0.1)


def test_ferrari_spikes_and_jumps_are_reported(run):
    report = inspect(run)
    spikes = [s for s in report.spikes if s.channel == "delta"]
    assert {round(s.t, 2): round(s.size, 3) for s in spikes} == pytest.approx(SPIKES, abs=2e-3)
    assert all(s.samples == 1 for s in spikes)
    assert [round(j.t, 2) for j in report.jumps if j.channel == "v_y"] == JUMPS
    assert not [s for s in report.spikes if not s.channel.startswith("delta")]
    assert report.gaps == ()
    for t in SPIKES:
        spike = next(s for s in spikes if round(s.t, 2) == t)
        assert round(spike.size, 3) == round(SPIKES[t], 3)
        told = f"delta has a spike of {np.degrees(spike.size):+.3g} deg at t = {t:.2f} s"
        assert any(told in s for s in report.sentences)


@pytest.mark.parametrize("rate", [20.0, 25.0, 50.0, 100.0])
def test_ferrari_yaw_rate_follows_steering_at_any_rate(rate):
    found = estimate_delay(ferrari_250lm(rate), "delta", "r")
    assert found.clear
    assert 0.075 < found.seconds < 0.095


def test_ferrari_drives_straight_with_a_small_steering_offset(run):
    (offset,) = [o for o in inspect(run).offsets if o.channel == "delta"]
    assert abs(np.degrees(offset.value)) < 0.1
    assert offset.samples > 3000


def test_ferrari_for_identification(run, slow):
    assert (slow.n_samples, slow.dt) == (11001, 0.05)
    assert slow.t[-1] == pytest.approx(run.t[-1], abs=0.011)
    for t, size in SPIKES.items():
        k = round((t - slow.start_times[0]) / 0.05)
        assert np.ptp(slow["delta"][k - 4 : k + 5]) < 0.2 * size + 0.01
        told = [n for n in slow.notes if f"t = {t:.2f} s" in n]
        assert any(abs(np.radians(float(m)) - size) < 1.5e-3 for n in told for m in re.findall(r"([+-][\d.]+) deg", n))
    assert any("v_y jumps in one sample at t = 191.67, 272.30" in n and "left as recorded" in n for n in slow.notes)
    assert any("low-pass at 8 Hz" in n for n in slow.notes)
    assert np.abs(slow["r"] - np.interp(slow.t, run.t, run["r"])).std() < 0.01
    assert {"X", "Y", "psi", "v_y", "a_x", "a_y", "beta"} <= set(slow.names)


def test_ferrari_despiking_changes_four_samples_only(run):
    full = ferrari_250lm(100.0)
    assert full.n_samples == run.n_samples
    changed = np.flatnonzero(full["delta"] != run["delta"])
    assert [round(t, 2) for t in run.t[changed]] == list(SPIKES)
    np.testing.assert_array_equal(full["v_y"], run["v_y"])
    assert len(find_jumps(full, "v_y")) == 9


@pytest.mark.parametrize("rate", [0.0, -1.0, 101.0])
def test_ferrari_at_an_impossible_rate(rate):
    with pytest.raises(errors.SampleTimeError, match="at most 100 Hz"):
        ferrari_250lm(rate)


def test_session_is_the_same_car():
    data = public("ferrari-250lm-session")
    assert data.dt == 0.05
    assert data.n_samples == 4158
    assert data.starts == (0, 2)
    assert data.start_times[1] - data.start_times[0] == pytest.approx(0.2, abs=1e-6)
    main = data.experiments[1]
    slope, correlation = agree(main["r"], np.gradient(main["psi"], 0.05))
    assert slope == pytest.approx(1.0, abs=0.01)
    assert correlation > 0.99
    np.testing.assert_allclose(data["delta_sw"] / data["delta"], 13.97, rtol=1e-12)
    kinematic = agree(data["delta"], 2.4 * data["r"] / data["v_x"])
    assert kinematic[1] > 0.98
    assert data["v_x"].min() > 10


# ---- the others --------------------------------------------------------------------------------------------------


def test_robot_arm(real_data):
    data = public("robot-arm")
    table = np.loadtxt(real_data("daisy_robot_arm/robot_arm.dat"))
    np.testing.assert_array_equal(data.values, table)
    assert data.n_samples == 1024
    assert (data.inputs, data.outputs) == (("u",), ("y",))


@pytest.mark.parametrize("name", ["emps", "emps-pulses"])
def test_emps(name):
    data = public(name)
    assert (data.n_samples, data.dt) == (24841, 0.001)
    np.testing.assert_allclose(data["force"], 35.1506519 * data["voltage"], rtol=1e-8)
    assert np.abs(data["q"] - data["q_ref"]).max() < 0.01
    assert data.unit("q") == "m"
    assert ("force_pulses" in data) == (name == "emps-pulses")


def test_iac_putnam():
    data = public("iac-putnam")
    assert (data.n_samples, data.dt, data.start_times) == (11900, 0.04, (0.0,))
    assert data["throttle"].max() == pytest.approx(0.4246, abs=1e-4)
    assert data["brake"].max() == pytest.approx(1.8e6, rel=1e-5)
    assert -1.001 < data["pedal"].min() < data["pedal"].max() < 1
    fast = data["v_x"] > 5
    wheels = np.mean([data[n] for n in ("v_fl", "v_fr", "v_rl", "v_rr")], axis=0)
    assert agree(data["v_x"][fast], wheels[fast])[0] == pytest.approx(1.0, abs=0.03)
    assert agree(data["delta"][fast], (data["r"] / data["v_x"])[fast])[1] > 0.95
    assert np.abs(np.diff(data["psi"])).max() < np.pi


def test_dart():
    data = public("dart")
    assert data.dt == 0.01
    assert len(data.starts) == 2
    for part in data:
        assert agree(part["v_encoder"], part["v_x"])[1] > 0.99
        slope, correlation = agree(part["r_imu"], part["r"])
        assert slope == pytest.approx(1.0, abs=0.1)
        assert correlation > 0.95
        assert agree(part["steering"], part["r"])[1] > 0.95
        assert np.abs(part["v_y"]).max() < 0.5
        speed = np.hypot(part["v_x"], part["v_y"])
        assert speed.max() < 3.5
    assert any("interpolated linearly" in n for n in data.notes)
    assert any("psi wraps" in n for n in data.notes)
    assert not any("spikes of psi" in n for n in data.notes)  # where it wraps, as logged it steps by 0.05 at most
    assert max(np.abs(np.diff(part["psi"])).max() for part in data) < 0.05


def test_dart_steps():
    data = public("dart-steps")
    assert data.dt == 0.1
    assert len(data.starts) == 8
    for part in data:
        assert part["throttle"].max() > 0.2
        assert part["v_x"].max() > 0.5


@pytest.mark.parametrize("name", LOADERS)
def test_every_log_can_be_inspected(name):
    data = public(name)
    assert np.isfinite(data.values).all()
    assert data.inputs
    assert data.outputs
    report = inspect(data)
    assert len(report.excitations) == len(data.inputs)
    assert all(s.strip() for s in report.sentences)


def test_names_that_are_no_logs():
    with pytest.raises(errors.ParameterError, match=r"'tir' is not a log; expected one of .*fetch\('tir'\)"):
        public("tir")
    with pytest.raises(errors.ParameterError, match="no public data set 'ferrari'; nearest are 'ferrari-250lm'"):
        public("ferrari")
