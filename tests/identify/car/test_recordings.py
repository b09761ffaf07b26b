"""Several recordings of one car: offsets and biases of each, what all share, and a recording that was not fitted to."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.data.recordings import RECORDING, recordings
from slipangle.errors import MissingColumnError, ParameterError, TooShortError
from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.identify_car import WholeCar, identify_car
from slipangle.identify.car.recordings import between
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, first_guess, fit
from slipangle.identify.car.uncertainty import covariance
from slipangle.models.model import FitInfo
from slipangle.models.storage import load, save
from slipangle.workflow.kinds import KINDS, check_entries
from tests.identify.car.test_identify_car import DT, KNOWN, STEERING, TRUE, drives, log, logs

# Offset of the steering, biases of r and v_y, and speeds; the third day is not fitted to.
DAYS = ((0.010, 0.020, 0.05), (-0.015, -0.010, -0.08), (0.004, 0.005, 0.0))
SPEEDS = ((10.0, 16.0, 22.0, 28.0), (12.0, 18.0, 24.0, 14.0), (13.0, 21.0, 26.0))
OWN = ("steering_offset", "bias_r", "bias_v_y")
ALL = ("v_y", "r", "a_y")
SLOPES = (0.03, -0.035, 0.015)  # of the road of each day [rad]
BIASES = (0.15, -0.2, 0.1)  # of a_y [m/s2]


def day(k, **how):
    """Drives of one day, with the zeros that its sensors had."""
    offset, bias_r, bias_v_y = DAYS[k]
    steering = STEERING | {"offset": offset}
    seeds = range(10 * k, 10 * k + len(SPEEDS[k]))
    data = join(*logs(SPEEDS[k], seeds, steering=steering, seconds=16.0, **how), name=f"day {k}").hold_mean()
    return data.with_channel("r", data["r"] + bias_r, "rad/s").with_channel("v_y", data["v_y"] + bias_v_y, "m/s")


def prompt(speed, seed, offset=0.0, **how):
    """A drive without noise, delay or lag, of little amplitude."""
    steering = dict(delay=0.0, lag=1e-9, gain=1.0, offset=offset)
    return log(speed, seed, noise=0.0, amplitude=0.01, steering=steering, seconds=5.0, **how).hold_mean()


def quiet(offsets, biases=(0.0, 0.0)):
    """Two such drives of each recording, at unlike speeds; offsets of the steering and biases of r by recording."""
    parts = []
    for k, (offset, bias) in enumerate(zip(offsets, biases, strict=True)):
        part = join(prompt(11.0 + k, 2 * k, offset), prompt(25.0 - k, 2 * k + 1, offset))
        numbered = part.with_channel(RECORDING, np.full(len(part), float(k)))
        parts.append(numbered.with_channel("r", part["r"] + bias, "rad/s"))
    return join(*parts)


@pytest.fixture(scope="module")
def car():
    return identify_car([day(0), day(1)], **KNOWN)


def guess():
    return first_guess(**KNOWN, dt=DT, outputs=("v_y", "r"), gain=1.0)


def fits(model, test):
    """Free-run fits in percent, the first second of each drive left out."""
    run = model.simulate(test)
    used = run.predicted & (np.arange(len(run.t)) % 800 > 50)
    spread = run.measured[used] - run.measured[used].mean(axis=0)
    return 100 * (1 - np.linalg.norm(run.error[used], axis=0) / np.linalg.norm(spread, axis=0))


def test_what_differs_is_found_for_each_and_the_rest_together():
    offsets, biases = (0.003, -0.005), (0.01, -0.03)
    data = quiet(offsets, biases)
    found = fit(guess(), STIFF, data, own=("steering_offset", "bias_r"))
    for k in range(2):
        assert found.values[f"steering_offset[{k}]"] == pytest.approx(offsets[k], abs=3e-4)
        assert found.values[f"bias_r[{k}]"] == pytest.approx(biases[k], abs=1e-3)
        assert found.model_of(k).value("steering_offset") == found.values[f"steering_offset[{k}]"]
    for name in STIFF:
        assert found.values[name] == pytest.approx(TRUE[name], rel=0.02)
    assert found.model.value("bias_r") == pytest.approx(np.mean(biases), abs=1e-3)
    assert found.model_of(7) is found.model


def test_slopes_of_the_road_and_biases_of_a_y_are_found_for_each():
    """By the accelerometer's reading alone a slope is a bias; what v_y does at several speeds tells them apart."""
    slopes, biases, parts = (0.03, -0.04), (0.2, -0.1), []
    for k in range(2):
        drives = (prompt(v, 2 * k + i, bank=slopes[k], outputs=ALL) for i, v in enumerate((11.0 + k, 25.0 - k)))
        part = join(*drives)
        numbered = part.with_channel(RECORDING, np.full(len(part), float(k)))
        parts.append(numbered.with_channel("a_y", part["a_y"] + biases[k], "m/s2"))
    start = first_guess(**KNOWN, dt=DT, outputs=ALL, gain=1.0).with_values(gain_a_y=1.08, lever_a_y=0.4)
    found = fit(start, STIFF, join(*parts), own=("cross_slope", "bias_a_y"))
    for k in range(2):
        assert found.values[f"cross_slope[{k}]"] == pytest.approx(slopes[k], abs=2e-3)
        assert found.values[f"bias_a_y[{k}]"] == pytest.approx(biases[k], abs=0.02)
    for name in STIFF:
        assert found.values[name] == pytest.approx(TRUE[name], rel=0.02)


def test_a_channel_that_only_one_log_has_is_asked_for():
    with pytest.raises(MissingColumnError, match=r"has an output a_y and .* has none; expected all logs to have it"):
        identify_car([log(14.0, 0, outputs=ALL, seconds=1.0), log(18.0, 1, seconds=1.0)], **KNOWN)
    level = log(14.0, 0, seconds=1.0)
    sloped = Dataset.from_arrays(
        {n: level[n] for n in ("delta", "v_x")} | {"bank": 0.01 * np.ones(len(level))},
        {n: level[n] for n in ("v_y", "r")},
        DT,
    )
    with pytest.raises(MissingColumnError, match=r"has an input bank and .* none: add it, 0 where there was none"):
        identify_car([level, sloped], **KNOWN)


def test_masses_are_found_beside_the_first_which_was_given(monkeypatch):
    light = prompt(14.0, 0)
    monkeypatch.setitem(TRUE, "mass", 1.3 * TRUE["mass"])
    found = fit(guess(), STIFF, join(light, prompt(22.0, 1)), own=("mass", "bias_v_y"))
    assert found.values["mass[0]"] == pytest.approx(KNOWN["mass"], rel=1e-4)
    assert found.values["mass[1]"] == pytest.approx(1.3 * KNOWN["mass"], rel=0.02)
    assert found.model.value("mass") == found.values["mass[0]"]
    spread, _ = covariance(found)  # each recording is one stretch: without it, nothing tells its bias
    assert spread.shape == (7, 7)
    assert np.isfinite(spread).all()


def test_a_recording_with_a_gap_is_one_and_experiments_of_one_data_set_are_several():
    a, b = drives(seconds=16.0).experiments[:2]
    gap = join(a.rows(0, 300), a.rows(400, 800))
    numbered = [part.with_channel(RECORDING, np.full(len(part), float(k))) for k, part in enumerate((gap, b))]
    assert recordings(join(*numbered)) == (0, 0, 1)
    assert recordings(join(gap, b)) == (0, 1, 2)
    pieces = stretches(join(*numbered), 2.0).all
    assert {k: recordings(pieces).count(k) for k in (0, 1)} == {0: 4, 1: 4}
    assert set(recordings(stretches(join(gap, b), 2.0).all)) == {0, 1, 2}


def again(data, times):
    """The same drive so many times in a row."""
    inputs, outputs = ({n: np.tile(data[n], times) for n in names} for names in (data.inputs, data.outputs))
    return Dataset.from_arrays(inputs, outputs, data.dt)


@pytest.mark.parametrize(("seconds", "tried"), [(45.0, True), (25.0, False)])
def test_offsets_are_tried_where_recordings_last_as_long_as_sessions(seconds, tried):
    shorter = logs((14.0, 15.0, 16.0), range(3), seconds=seconds / 5, noise=0.0)
    parts = [again(part, 5) for part in shorter]
    listed = corrections(stretches(join(*parts), 2.0).train, KNOWN["wheelbase"], None)
    assert any(c.own == ("steering_offset",) for c in listed) == tried
    assert not any(c.own for c in corrections(parts[0], KNOWN["wheelbase"], None))


def test_another_recording_is_expected_where_those_of_the_fit_were():
    """By hand: one value of what is ordinary beside two, and a third drawn from what they came from."""
    found = fit(guess(), STIFF, quiet((0.012, -0.02)), own=("steering_offset",))
    info = replace(identified_info(found), names=found.names, values=np.array(list(found.values.values())))
    ((name, (mean, width, relative)),) = between(replace(found.model, fit_info=info)).items()
    a, b = (found.values[f"steering_offset[{k}]"] for k in range(2))
    assert (name, relative) == ("steering_offset", False)
    assert mean == pytest.approx((a + b) / 2)
    assert width == pytest.approx(np.sqrt((0.02**2 + (a - b) ** 2 / 2) / 2 * 1.5))


def identified_info(found):
    n = len(found.names)
    return FitInfo(names=(), values=np.zeros(n), covariance=np.eye(n), noise_std=found.sigma, n_samples=1)


@pytest.mark.parametrize(
    ("own", "said"),
    [
        (("C_f",), "per_experiment names 'C_f'; expected each once, of steering_offset, bias_r"),
        (("mass", "mass"), "per_experiment names a parameter twice"),
    ],
)
def test_what_cannot_differ_is_refused(own, said):
    with pytest.raises(ParameterError, match=said):
        WholeCar(**KNOWN, per_experiment=own)


def test_a_bias_of_what_is_not_measured_is_refused_and_a_job_takes_the_names():
    with pytest.raises(MissingColumnError, match="has no output v_y"):
        identify_car(drives(outputs=("r",)), **KNOWN, per_experiment=("bias_v_y",))
    entries = check_entries("car", KNOWN | {"per_experiment": ["steering_offset", "bias_r"]}, "model 'car'")
    assert KINDS["car"](**entries).per_experiment == ("steering_offset", "bias_r")


@pytest.mark.slow
def test_offsets_of_two_days_are_found_without_being_asked_for(car):
    info = car.model.fit_info
    assert {f"{name}[{k}]" for name in OWN for k in (0, 1)} <= set(info.names)
    for k in (0, 1):
        for name, true in zip(OWN, DAYS[k], strict=True):
            low, high = car.interval(f"{name}[{k}]")
            assert low <= true <= high
            assert high - low < 0.2 * abs(DAYS[0][OWN.index(name)] - DAYS[1][OWN.index(name)])
    for name in STIFF:
        low, high = car.interval(name)
        assert low <= TRUE[name] <= high
        assert car.separated[name]
    assert any(s.startswith("steering_offset differs between the recordings: 0.01") for s in info.warnings)


@pytest.mark.slow
def test_one_offset_for_both_days_takes_the_stiffness_with_it(car):
    shared = identify_car([day(0), day(1)], **KNOWN, per_experiment=())
    assert abs(shared.model.value("C_f") / TRUE["C_f"] - 1) > 0.1
    assert abs(car.model.value("C_f") / TRUE["C_f"] - 1) < 0.05
    for k in (0, 1):
        own = car.model.for_experiment(k)
        assert (fits(own, day(k)) > fits(shared.model, day(k)) + 10).all()


@pytest.mark.slow
def test_a_third_day_is_read_from_its_first_seconds(car, tmp_path):
    test = day(2)
    rest = test.rows(1600, test.n_samples)
    own = car.for_recording(test, seconds=30.0)
    assert own.value("C_f") == car.model.value("C_f")
    assert own.value("steering_offset") == pytest.approx(DAYS[2][0], abs=0.002)
    assert (fits(own, rest) > fits(car.model, rest) + 20).all()
    assert (fits(own, rest) > [70, 90]).all()
    again = load(save(car.model, tmp_path / "car.json"))
    assert replace(car, model=again).for_recording(test, seconds=30.0) == own
    with pytest.raises(TooShortError, match="day 2' has no stretch of"):
        car.for_recording(test.with_channel("v_x", 0.1 * np.ones(len(test)), "m/s"))
    with pytest.raises(ParameterError, match="seconds is 0 s"):
        car.for_recording(test, seconds=0.0)


def sloped(k):
    """A day on a road of a slope of its own, with an accelerometer."""
    data = day(k, bank=SLOPES[k], outputs=ALL)
    return data.with_channel("a_y", data["a_y"] + BIASES[k], "m/s2")


@pytest.mark.slow
def test_days_on_roads_of_other_slopes():
    own = ("cross_slope", "steering_offset", "bias_r", "bias_v_y", "bias_a_y")
    car = identify_car([sloped(0), sloped(1)], **KNOWN, per_experiment=own)
    for k in (0, 1):
        low, high = car.interval(f"cross_slope[{k}]")
        assert low <= SLOPES[k] <= high
        assert high - low < 0.05  # the car crabs on a slope as a v_y sensor reads that is turned, which is open too
        low, high = car.interval(f"bias_a_y[{k}]")
        assert low <= BIASES[k] <= high
    for name in STIFF:
        low, high = car.interval(name)
        assert low <= TRUE[name] <= high
        assert high - low < 0.2 * TRUE[name]
    third = sloped(2)
    today = car.for_recording(third, seconds=30.0)
    assert today.value("cross_slope") == pytest.approx(SLOPES[2], abs=0.008)
    rest = third.rows(1600, third.n_samples)
    assert (fits(today, rest) > [70, 90, 85]).all()
