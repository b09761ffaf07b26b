"""A car from a log of it: the truth is known, the log is simulated by equations of its own."""

# Long: what is asked of one and the same fitted car, and the drives that all of the car's tests share.

import re
from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import (
    ConfigError,
    IdentifiabilityWarning,
    MissingColumnError,
    ParameterError,
    SampleTimeError,
    TooShortError,
)
from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.identify_car import WholeCar, identify_car
from slipangle.identify.car.sentences import _unexplained, bounds, changes, friction_reached, impossible
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, Stage, first_guess, fit
from slipangle.models.storage import load as read
from slipangle.models.storage import save
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.workflow.kinds import KINDS, check_entries, fitted
from tests.oracles import vehicles

TRUE = dict(mass=1300.0, inertia_z=1900.0, wheelbase=2.6, l_f=1.2, C_f=9e4, C_r=1.2e5, mu_f=0.9, mu_r=1.0, shape=1.4)
KNOWN = {n: TRUE[n] for n in ("mass", "wheelbase", "l_f")}
STEERING = dict(delay=0.04, lag=0.06, gain=0.93, offset=0.01)
DT, FINE = 0.02, 10
SECONDS = 8.0  # of a drive
OUTPUTS = ("v_y", "r")
DRIVES = {}  # those that have been made


def multisine(rng, t):
    """Of 39 frequencies up to 2.3 Hz with phases of their own, at most one."""
    f = np.arange(1, 40) * 0.06
    wave = sum(np.cos(2 * np.pi * (k * t + p)) for k, p in zip(f, rng.uniform(0, 1, len(f)), strict=True))
    return wave / np.abs(wave).max()


def log(speed, seed, **how):
    """A drive at a speed, see `logs`."""
    return logs([speed], [seed], **how)[0]


def logs(
    speeds,
    seeds,
    *,
    amplitude=0.08,
    seconds=SECONDS,
    noise=1.0,
    scale=1.0,
    outputs=OUTPUTS,
    steering=STEERING,
    bank=0,
    true=TRUE,
    far=False,
):
    """Drives of a ``true`` car with multisine steering, by the oracle's equations at 2 ms; lengths times ``scale``.

    The road's left edge is higher by an angle of ``bank``; a_y is that of the tires, as an accelerometer reads it.
    The wheels are turned as ``far`` as they are, else by small angles. All are driven at once, as arrays.
    """
    rngs, speed = [np.random.default_rng(seed) for seed in seeds], np.array(speeds, dtype=float)
    h = DT / FINE
    t = np.arange(round(seconds / h)) * h
    logged = np.array([amplitude / v * 12.0 * multisine(rng, t) for v, rng in zip(speeds, rngs, strict=True)])
    late = np.array([np.interp(t - steering["delay"], t, angle) for angle in logged])
    wheel, v_y, r, rows = logged[:, 0] - steering["offset"], 0.0 * speed, 0.0 * speed, []
    for k in range(len(t)):
        target = steering["gain"] * (late[:, k] - steering["offset"])
        wheel = wheel + (target - wheel) * -np.expm1(-h / steering["lag"])
        slip = vehicles.small_slip(true, v_y, r, wheel, speed)
        turned = {"turned": wheel} if far else {}
        if far:
            slip = vehicles.wheel_slip(speed, v_y + true["l_f"] * r, wheel), slip[1]
        v_y_dot, r_dot, a_y = vehicles.saturating_bicycle(true | turned, v_y, r, *slip, speed)
        if k % FINE == 0:
            rows.append((v_y, r, a_y, r_dot))
        v_y, r = v_y + h * (v_y_dot - vehicles.G * np.sin(bank)), r + h * r_dot
    parts = []
    for rng, v, angle, motion in zip(rngs, speeds, logged, np.array(rows).transpose(2, 1, 0), strict=True):
        v_y, r, a_y, r_dot = motion
        seen = {
            "v_y": scale * (v_y + noise * 0.02 * rng.standard_normal(len(r))),
            "r": r + noise * 0.003 * rng.standard_normal(len(r)),
            "a_y": 1.08 * (a_y + 0.4 * r_dot) + noise * 0.05 * rng.standard_normal(len(r)),  # 0.4 m ahead, with roll
        }
        inputs = {"delta": angle[::FINE], "v_x": np.full(len(r), scale * v)}
        parts.append(Dataset.from_arrays(inputs, {n: seen[n] for n in outputs}, DT))
    return parts


def drives(speeds=(10.0, 14.0, 18.0, 22.0, 26.0), **how):
    """At several speeds; the same object for the same words, as it takes long to make it."""
    key = repr((speeds, sorted(how.items())))
    if key not in DRIVES:
        DRIVES[key] = join(*logs(speeds, range(len(speeds)), **how)).hold_mean()
    return DRIVES[key]


def driven(share):
    """The drives at a share of their speed."""
    data = drives()
    return data.with_channel("v_x", share * data["v_x"], "m/s")


def brief(**how):
    """Two drives, enough for what hangs on no number."""
    return drives((12.0, 20.0), **how)


@pytest.fixture(scope="module")
def job():
    """What a job found, the model that it got and what it warned of."""
    found = []

    def remembering(self, data, identify=WholeCar.identify):
        found.append(identify(self, data))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(WholeCar, "identify", remembering)
        with pytest.warns(IdentifiabilityWarning) as said:
            model = fitted(KINDS["car"], KNOWN, ("delta", "v_x"), ("v_y", "r"), drives(), "car")
    return found[0], model, [str(warning.message) for warning in said]


@pytest.fixture(scope="module")
def car(job):
    return job[0]


@pytest.fixture(scope="module")
def brief_car():
    return identify_car(brief(), **KNOWN)


def test_the_truth_is_in_the_intervals_and_they_are_narrow(car):
    for name in ("C_f", "C_r", "inertia_z"):
        low, high = car.interval(name)
        assert low <= TRUE[name] <= high
        assert high - low < 0.25 * TRUE[name]
        assert car.separated[name]


def test_delay_lag_gain_and_offset_are_found_apart(car):
    value = car.model.value
    assert value("delay_delta") == pytest.approx(STEERING["delay"], abs=0.006)
    assert value("steering_lag") == pytest.approx(STEERING["lag"], abs=0.008)
    assert value("steering_gain") == pytest.approx(STEERING["gain"], rel=0.02)
    assert value("steering_offset") == pytest.approx(STEERING["offset"], abs=1e-3)


def test_delay_and_lag_are_said_apart(car):
    said = next(s for s in car.sentences if s.startswith("steering and tires together are"))
    assert "ms late: pure delay" in said
    for name, true in (("delay_delta", STEERING["delay"]), ("steering_lag", STEERING["lag"])):
        low, high = car.interval(name)
        assert low <= true <= high


@pytest.mark.parametrize("over", [pytest.param(-1.0, marks=pytest.mark.slow), -12.0])
def test_a_steering_logged_in_other_units_or_turned_gives_the_same_car(car, over):
    """The first guess of its gain is 1."""
    data = drives()
    found = identify_car(data.with_channel("delta", over * data["delta"], "rad"), **KNOWN)
    assert found.model.value("steering_gain") * over == pytest.approx(car.model.value("steering_gain"), rel=0.01)
    for name in STIFF:
        assert found.model.value(name) == pytest.approx(car.model.value(name), rel=0.03)
        assert np.array(found.interval(name)) == pytest.approx(np.array(car.interval(name)), rel=0.1)
    assert any("wrong sign" in doubt for doubt in found.doubts)


def test_it_says_what_each_correction_changed(car):
    said = next(s for s in car.sentences if "delay and lag" in s)
    assert "C_f" in said
    assert "->" in said


def test_a_car_that_is_steered_little_keeps_the_equations_of_small_angles(car):
    assert car.model.ode.small_angles


def test_a_car_without_downforce_has_none_and_no_word_of_it(car):
    assert "downforce_f" not in car.model.fit_info.names
    assert car.model.value("downforce_r") == 0.0
    assert not any("downforce" in s or s.startswith("v_x is logged") for s in car.sentences)


def test_unseen_manoeuvre(car):
    test = join(log(16.0, 100, amplitude=0.07), log(24.0, 101, amplitude=0.06)).hold_mean()
    run = car.model.simulate(test)
    used = run.predicted & (np.arange(len(run.t)) % 400 > 50)
    error = np.linalg.norm(run.error[used], axis=0) / np.linalg.norm(run.measured[used], axis=0)
    assert error[1] < 0.08


def test_yaw_rate_alone_is_within_or_said_not_to_be_separable():
    found = identify_car(drives(outputs=("r",)), **KNOWN)
    for name in ("C_f", "C_r", "inertia_z"):
        low, high = found.interval(name)
        assert low <= TRUE[name] <= high or not found.separated[name]
        assert low > 0
    for name in (n for n, fine in found.separated.items() if not fine):
        assert any(s.startswith(f"{name} cannot be separated") for s in found.sentences)


def test_a_car_a_third_as_long_is_the_same_car():
    """Lengths and speed over 3, mass over 300: forces over 900, inertia over 2700."""
    car = identify_car(drives(seconds=16.0), **KNOWN)
    known = {n: v / (300 if n == "mass" else 3) for n, v in KNOWN.items()}
    small = identify_car(drives(seconds=16.0, scale=1 / 3), **known)
    assert small.model.fit_info.names == car.model.fit_info.names
    for name, factor in (("C_f", 900.0), ("C_r", 900.0), ("inertia_z", 2700.0)):
        assert factor * small.model.value(name) == pytest.approx(car.model.value(name), rel=1e-3)


def test_a_model_car_of_40_g_is_found_like_any_other():
    """1:43, by the model's own equations: ordinary tires and friction, speeds of a table top."""
    known = dict(mass=0.04, wheelbase=0.062, l_f=0.03)
    load, l_r = 0.04 * 9.81 / 0.062, 0.032
    true = dict(C_f=9.0 * load * l_r, C_r=13.0 * load * 0.03, inertia_z=1.2 * 0.04 * 0.03 * l_r)
    params = SaturatingBicycleParams(**known, **true, steering_gain=0.9, steering_offset=0.02)
    plant = SaturatingBicycle(params=params, dt=DT, outputs=OUTPUTS)
    parts, rng = [], np.random.default_rng(4)
    for speed in (0.5, 0.8, 1.1, 1.4):
        f = np.arange(1, 30) * 0.1
        t = np.arange(400) * DT
        wave = np.cos(2 * np.pi * (np.outer(t, f) + rng.uniform(0, 1, len(f)))).sum(axis=1)
        u = np.column_stack([0.02 + 0.1 / speed * wave / np.abs(wave).max(), np.full(len(t), speed)])
        y = np.vstack([np.zeros(2), plant.free_run(np.zeros(2), u)]) + rng.standard_normal((len(t), 2)) * (0.002, 0.02)
        parts.append(Dataset.from_arrays({"delta": u[:, 0], "v_x": u[:, 1]}, {"v_y": y[:, 0], "r": y[:, 1]}, DT))
    car = identify_car(join(*parts), **known)
    assert not car.doubts
    for name, value in true.items():
        low, high = car.interval(name)
        assert low <= value <= high
        assert high - low < 0.3 * value


def test_a_delay_that_a_fit_left_at_nothing_stops_no_later_search(car):
    """Such as 1e-22 s: scaled by itself, it kept every other parameter where it was."""
    model = car.model.with_values(delay_delta=1e-22, steering_gain=0.6)
    found = fit(model, car.model.fit_info.names, drives(amplitude=0.05))
    assert found.model.value("steering_gain") == pytest.approx(STEERING["gain"], rel=0.03)
    assert found.model.value("delay_delta") == pytest.approx(STEERING["delay"], abs=0.01)


def test_where_the_wheels_follow_at_once_no_lag_is_made_up():
    """One of two steps of the integrator, which nothing had asked for, was taken off the inertia."""
    prompt = drives(noise=0.0, amplitude=0.01, steering=dict(delay=0.0, lag=1e-9, gain=1.0, offset=0.0))
    found = fit(first_guess(**KNOWN, dt=DT, outputs=("v_y", "r"), gain=1.0), STIFF, prompt)
    for name in STIFF:
        assert found.model.value(name) == pytest.approx(TRUE[name], rel=0.02)


def test_a_correction_that_costs_a_little_on_held_out_stretches_is_said_to(car):
    stage = Stage(correction="it is there", kept=True, error=np.ones(2), change=0.1, values=car.stages[0].values)
    assert changes([car.stages[0], stage]) == ["the held-out error rises by 5.1 % when it is there"]
    assert changes([car.stages[0], replace(stage, change=-0.1)])[0].startswith("the held-out error falls by 4.9 %")


def test_a_mass_in_tonnes_is_doubted_and_one_that_cannot_be_checked_is_said(car):
    light = identify_car(brief(), **KNOWN | {"mass": 1e-3 * KNOWN["mass"]})
    assert any(
        said.startswith("mass is 1.3 kg at a wheelbase of 2.6 m; expected 264 to 26400 kg") for said in light.doubts
    )
    assert not any("mass" in said for said in car.doubts)
    assert any("in proportion to the mass that was given, 1300 kg" in said for said in car.sentences)


def test_a_centre_of_gravity_that_a_sensor_elsewhere_explains_is_said_with_what_it_does():
    """30 cm too far behind: the place of the v_y sensor takes it all, and the stiffness is a third off."""
    wrong = KNOWN["l_f"] + 0.3
    found = identify_car(drives(), **KNOWN | {"l_f": wrong})
    assert found.model.value("lever_v_y") == pytest.approx(0.3, abs=0.03)
    (said,) = (s for s in found.model.fit_info.warnings if s.startswith("v_y reads as if measured +0."))
    found = re.search(r"l_f is (.+) m in .* about (.+) and C_r (.+) N", said)
    l_f, C_f, C_r = (float(x.replace(" ", "")) for x in found.groups())
    assert l_f == pytest.approx(KNOWN["l_f"], abs=0.03)
    assert C_f == pytest.approx(TRUE["C_f"], rel=0.06)
    assert C_r == pytest.approx(TRUE["C_r"], rel=0.06)


def test_a_wheelbase_a_fifth_too_long_is_named_with_the_one_that_the_log_shows():
    """The steering's gain, which hardly anybody knows to a fifth, took it, and nothing said what it does to inertia."""
    found = identify_car(drives(), **KNOWN | {n: 1.2 * KNOWN[n] for n in ("wheelbase", "l_f")})
    assert found.model.value("inertia_z") > 1.3 * TRUE["inertia_z"]
    (said,) = (s for s in found.sentences if "a wheelbase of about" in s)
    at = re.search(
        r"a wheelbase of about (.+) m in place of (.+) m, .* turn (.+) times .* inertia_z about ([\d ]+)", said
    )
    wheelbase, given, gain, inertia = (float(x.replace(" ", "")) for x in at.groups())
    assert wheelbase == pytest.approx(KNOWN["wheelbase"], rel=0.06)
    assert given == pytest.approx(1.2 * KNOWN["wheelbase"], rel=0.01)
    assert gain == pytest.approx(1.0, abs=0.06)
    assert inertia == pytest.approx(TRUE["inertia_z"], rel=0.1)


def doubted(data):
    """What contradicts itself in a log, and what it does not explain, by a fit of the linear bicycle."""
    car, whole = WholeCar(**KNOWN), stretches(data, KNOWN["wheelbase"])
    linear, _ = car._begin(data, data, whole)
    return (*car._suspect(data, linear, whole), *_unexplained(linear(whole.all)))


def said_of(data):
    """All that is said of a log."""
    return identify_car(data, **KNOWN).sentences


asked = pytest.mark.parametrize("ask", [doubted, pytest.param(said_of, marks=pytest.mark.slow)])


@asked
def test_channels_that_have_nothing_to_do_with_each_other_are_said_to(ask):
    data, rng = drives(), np.random.default_rng(0)
    for name, size in (("v_y", 0.3), ("r", 0.1)):
        data = data.with_channel(name, size * rng.standard_normal(len(data)), data.unit(name))
    said = ask(data)
    assert any(re.match("steering and speed explain [0-3] % of v_y and [0-3] % of r", s) for s in said)
    assert not any("measure v_y" in s for s in said)  # it is


@asked
@pytest.mark.parametrize(("name", "other"), [("r", "v_y"), ("v_y", "r")])
def test_a_channel_that_has_nothing_to_do_with_the_drive_is_named_beside_a_sound_one(name, other, ask):
    data = drives()
    alien = np.concatenate([part[name] for part in reversed(data.experiments)])  # of the other drives
    (said,) = (
        s for s in ask(data.with_channel(name, alien, data.unit(name))) if s.startswith("steering and speed explain")
    )
    assert re.match(rf"steering and speed explain \d % of {name}, but \d\d+ % of {other}, ", said)


@asked
def test_a_yaw_rate_in_degrees_is_named_whatever_friction_it_asks_for(ask):
    data = drives()
    data = data.with_channel("r", np.rad2deg(data["r"]), "rad/s")
    assert any("r is logged in deg/s" in s for s in ask(data))
    (frictions,) = (c.starts for c in corrections(data, KNOWN["wheelbase"], None) if c.free == ("mu_f", "mu_r"))
    assert all(start["mu_f"] <= SaturatingBicycleParams.metadata()["mu_f"].upper for start in frictions)


def test_values_that_no_car_has_are_doubted_only_where_their_whole_interval_is_such(car):
    guess = first_guess(**KNOWN, dt=DT, outputs=("v_y", "r"), gain=1.0)
    final = fit(guess.with_values(mu_f=0.3, mu_r=0.9), (*STIFF, "mu_f", "mu_r"), drives(), prior={})
    at = dict(zip(final.names, range(5), strict=True))
    limits = np.array([[0.9, 1.1]]) * np.array([[final.values[n]] for n in final.names])
    assert impossible(final.names, final, limits, friction_reached(final)) == []
    load = 9.81 * KNOWN["mass"] / KNOWN["wheelbase"] * (KNOWN["wheelbase"] - KNOWN["l_f"])
    limits[at["C_f"]] = 0.1 * load, 2.9 * load
    limits[at["inertia_z"]] = 2.6 * KNOWN["mass"] * 1.2 * 1.4, 1e5
    said = impossible(final.names, final, limits, friction_reached(final))
    assert [s.split(" is ")[0] for s in said] == ["C_f", "inertia_z"]
    limits[at["C_f"], 1] = 3.1 * load
    limits[at["inertia_z"], 0] = 1.0
    assert impossible(final.names, final, limits, friction_reached(final)) == []


def test_the_friction_that_a_log_uses_is_not_that_of_v_x_r_in_a_swerve():
    """In a quick swerve v_x r is half as much again as the tires' acceleration, which says what the log has used."""
    steering = dict(delay=0.0, lag=0.02, gain=1.0, offset=0.0)
    data = log(30.0, 0, amplitude=0.12, outputs=("v_y", "r", "a_y"), steering=steering).hold_mean()
    used = np.quantile(np.abs(data["a_y"] / 1.08 - 0.4 * np.gradient(data["r"], DT)), 0.999) / 9.81
    assert np.quantile(np.abs(data["v_x"] * data["r"]), 0.999) / 9.81 > 1.3 * used
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0).with_values(mu_f=0.9, mu_r=0.9)
    final = fit(guess, (*STIFF, "mu_f", "mu_r"), data.select(outputs=OUTPUTS))
    assert friction_reached(final) == pytest.approx(used, rel=0.05)
    assert any(
        f"the log uses {friction_reached(final):.2g} at most" in said for said in bounds(final, friction_reached(final))
    )


def test_a_rear_that_holds_more_than_the_front_may_one_that_holds_less_is_drawn_up():
    """By a log that tells nothing of friction; the front's is known, the rear's within 0.2."""
    data = drives(amplitude=0.004)
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0)

    def rear(front, back):
        known = {"mu_f": (front, 0.01, False), "mu_r": (back, 0.2, False)}
        start = guess.with_values(mu_f=front, mu_r=back)
        return fit(start, (*STIFF, "mu_f", "mu_r"), data, prior=known)

    above, below = rear(0.8, 1.3), rear(1.3, 0.8)
    assert above.values["mu_r"] == pytest.approx(1.3, abs=0.05)
    assert 1.0 < below.values["mu_r"] < 1.3
    assert np.linalg.norm(above.pull[-1]) < 0.1 * np.linalg.norm(below.pull[-1])  # so do their intervals


def test_an_accelerometer_tells_stiffness_and_inertia_apart_and_where_it_sits():
    found = identify_car(drives(outputs=("r", "a_y")), **KNOWN)
    assert found.model.outputs == ("r", "a_y")
    for name in STIFF:
        low, high = found.interval(name)
        assert low <= TRUE[name] <= high
        assert found.model.value(name) == pytest.approx(TRUE[name], rel=0.06)
    assert found.model.value("gain_a_y") == pytest.approx(1.08, abs=0.02)
    assert found.model.value("lever_a_y") == pytest.approx(0.4, abs=0.1)
    assert found.model.value("steering_gain") == pytest.approx(STEERING["gain"], rel=0.02)


def test_the_mass_that_all_is_in_proportion_to_stands_on_the_page(car):
    assert car.model.fit_info.method.endswith("in proportion to the given mass of 1300 kg")


def test_the_car_is_saved_and_read_again(car, tmp_path):
    again = read(save(car.model, tmp_path / "car.json"))
    assert again == car.model
    assert np.array_equal(again.fit_info.limits, car.model.fit_info.limits)


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (dict(l_f=9.0), ParameterError, "between the axles"),
        (dict(mass=-1.0), ParameterError, "mass is -1"),
        (dict(steering_gain=0.0), ParameterError, "steering_gain is 0; expected at least 0.0001 either way"),
        (dict(share=-1.0), TooShortError, "v_x is negative most of the time, turn its sign"),
        (dict(share=0.05), TooShortError, "above 2.6 m/s"),
    ],
)
def test_bad_input_gets_a_sentence(change, error, said):
    given = KNOWN | change
    data = driven(given.pop("share", 1.0))
    with pytest.raises(error, match=said):
        identify_car(data, **given)


def test_a_missing_channel_and_milliseconds_get_a_sentence():
    data = drives()
    with pytest.raises(MissingColumnError, match="no channel 'r'"):
        identify_car(
            Dataset.from_arrays({"delta": data["delta"], "v_x": data["v_x"]}, {"v_y": data["v_y"]}, DT), **KNOWN
        )
    slow = replace(data, dt=20.0, start_times=tuple(1000 * t for t in data.start_times))
    with pytest.raises(SampleTimeError, match="ms"):
        identify_car(slow, **KNOWN)


def test_a_job_fits_it_and_checks_its_entries(job):
    car, model, said = job
    assert model is car.model
    assert any("->" in sentence for sentence in model.fit_info.corrections)
    assert not any("->" in warning for warning in said)
    (used,) = re.findall(r"the log uses (\S+) at most", " ".join(said))
    assert float(used) == pytest.approx(0.41, abs=0.04)  # as the oracle's tires accelerate it; v_x r reaches 0.53 g
    with pytest.raises(ConfigError, match="weight"):
        check_entries("car", KNOWN | {"weight": 3.0}, "model 'car'")


def test_a_cross_slope_that_is_logged_is_no_offset(brief_car):
    """Four degrees to either side: the tires hold against the slope, as if the car turned."""
    data = brief()
    bank = np.where(np.arange(data.n_samples) // 400 % 2 == 0, 0.07, -0.07)
    flat = Dataset.from_arrays(
        {n: data[n] for n in data.inputs} | {"bank": 0 * bank}, {n: data[n] for n in data.outputs}, DT
    )
    flat = replace(flat, starts=data.starts, start_times=data.start_times)
    model = identify_car(flat, **KNOWN).model
    for name in ("C_f", "C_r", "inertia_z"):
        assert model.value(name) == pytest.approx(brief_car.model.value(name), rel=1e-6)
    sloped = replace(model, fit_info=None).simulate(flat.with_channel("bank", bank, "rad"))
    assert np.abs(sloped.channel("v_y") - model.simulate(flat).channel("v_y")).max() > 0.05


def test_beside_v_y_an_accelerometer_is_not_fitted():
    found = identify_car(brief(outputs=("v_y", "r", "a_y")), **KNOWN)
    assert found.model.outputs == ("v_y", "r")


def test_v_y_that_is_no_output_is_not_fitted():
    assert identify_car(brief().select(outputs=("r",)), **KNOWN).model.outputs == ("r",)


def test_stretches_leave_out_standstill_and_hold_out_every_fourth():
    data = drives()
    stopped = data.with_channel("v_x", np.where(np.arange(data.n_samples) % 400 < 50, 0.0, data["v_x"]), "m/s")
    cut = stretches(stopped, 2.0)
    assert cut.all["v_x"].min() > 2.0
    assert len(cut.held_out.experiments) == round(len(cut.all.experiments) / 4)


def test_a_log_of_which_little_can_be_used_is_said_to_be():
    data = drives()
    rows = np.arange(data.n_samples)
    pieces = [data.rows(int(a), int(a) + 60) for a in rows[:-400:60]]
    found = identify_car(join(data.rows(data.n_samples - 400, data.n_samples), *pieces), **KNOWN)
    assert found.sentences[0].startswith(
        f"{100 * (1 - 400 / (400 + 60 * len(pieces))):.0f} % of the driving is in pieces"
    )
