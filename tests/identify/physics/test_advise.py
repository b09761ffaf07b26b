"""The manoeuvre that is advised does what is said of it, when it is driven, logged with noise and fitted."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler
from slipangle.data.dataset import Dataset, join
from slipangle.data.public.sets import ferrari_250lm
from slipangle.errors import IdentifiabilityWarning, ParameterError
from slipangle.identify.physics.advise import advise
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM, SOUSA_TABLE_6_1, SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.longitudinal import Longitudinal, LongitudinalParams
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.delayed import Delayed
from tests.identify.physics.test_grey_box import drive

CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r",))
FREE = ("C_f", "C_r", "inertia_z")
SETTINGS = GreyBox(start=CAR, free=FREE)
T = CAR.dt * np.arange(600)
WEAVE = {"delta": 0.02 * np.sin(2 * np.pi * 0.2 * T), "v_x": np.full(600, 15.0)}  # one frequency, one speed


def logged(seed, noise, inputs):
    n = len(inputs["delta"])
    clean = CAR.simulate(Dataset.from_arrays(inputs, {"r": np.zeros(n)}, CAR.dt)).y[:, 0]
    r = clean + noise * np.random.default_rng(seed).standard_normal(n) * (np.arange(n) > 0)
    return Dataset.from_arrays(inputs, {"r": r}, CAR.dt)


def driven(advice, seed, noise):
    return logged(1000 + seed, noise, {c: advice.data[c] for c in CAR.inputs})


def quiet(data, settings=SETTINGS):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        return settings.fit(data)


def test_the_expected_interval_comes_true():
    """Log, fit, ask, drive, fit both: over 40 drives the estimates scatter as was expected, within a factor of 1.3."""
    noise, seeds = 1e-4, 40
    logs = [logged(seed, noise, WEAVE) for seed in range(seeds)]
    asked = [advise(quiet(log), log)[0] for log in logs[:8]]
    for best in asked:
        assert best.after < 0.1 * best.before
        assert "sweep" in best.manoeuvre
    expected = [best.std for best in asked]
    driven_too = (join(log, driven(asked[seed % 8], seed, noise)) for seed, log in enumerate(logs))
    found = [quiet(data).fit_info.values for data in driven_too]
    ratio = np.std(found, axis=0, ddof=1) / np.median(expected, axis=0)
    assert ratio == pytest.approx(1.0, abs=0.3)


@pytest.mark.skipif(compiler() is None, reason="advice comes by itself with compiled models only")
def test_a_warning_says_what_to_drive_and_driving_it_helps():
    noise = 7e-4
    log = logged(0, noise, WEAVE)
    poor = quiet(log).fit_info
    assert any("do not determine C_r" in w and "or drive a sine sweep of delta" in w for w in poor.warnings)
    best = advise(quiet(log), log, parameter="C_r")[0]
    assert any(best.sentence in w for w in poor.warnings)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        good = SETTINGS.fit(join(log, driven(best, 0, noise))).fit_info
    assert (good.std < 0.15 * poor.std).all()


def test_advice_is_ranked_and_within_what_the_log_has_seen():
    log = logged(3, 1e-3, WEAVE)
    ranked = advise(quiet(log), log)
    assert len(ranked) >= 10
    binary = [a.after for a in ranked if "binary" in a.manoeuvre]
    human = [a.after for a in ranked if "binary" not in a.manoeuvre]
    assert human == sorted(human)
    assert binary == sorted(binary)
    seen = np.abs(log["r"]).max()
    for a in ranked:
        assert np.abs(a.data["r"]).max() < 1.1 * seen
        assert np.abs(a.data["delta"]).max() <= 1.5 * np.abs(log["delta"]).max() * (1 + 1e-9)
        assert 15.0 * 0.6 <= a.data["v_x"][0] <= 15.0 * 1.4
        assert a.unit in a.sentence
        assert a.after <= a.before * (1 + 1e-9)


CASES = {
    "pedals": (
        Longitudinal(params=LongitudinalParams(mass=800.0, k_e=6000.0, k_d=60.0, k_r=0.02), dt=0.04),
        {"free": ("k_e", "k_d", "k_r")},
        "pedal",
    ),
    "late steering, an offset for each recording": (
        Delayed(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r")), delays={"delta": 0.06}),
        {"free": ("C_f", "inertia_z", "delay_delta"), "per_experiment": ("steering_offset",)},
        "delta",
    ),
    "speed as a state": (
        SingleTrack(
            params=SOUSA_TABLE_6_1,
            dt=0.05,
            tire_f=SOUSA_TABLE_6_2,
            tire_r=SOUSA_TABLE_6_2,
            method="radau",
            outputs=("v_x", "v_y", "r"),
        ),
        {"free": ("inertia_z", "l_f")},
        "m/s for 6 s",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_other_models_get_advice_too(case):
    model, how, word = CASES[case]
    log = join(*[drive(model, n=150, seed=s, noise=0.02) for s in range(2)])
    ranked = advise(quiet(log, GreyBox(start=model, **how)), log, duration=6.0)
    assert word in ranked[0].manoeuvre
    assert ranked[0].after < ranked[0].before
    again = model.simulate(ranked[0].data)  # it can be replayed
    assert np.isfinite(again.y).all()


def test_bad_questions_are_refused():
    log = logged(0, 1e-4, WEAVE)
    with pytest.raises(ParameterError, match="the model is no fit"):
        advise(CAR, log)
    with pytest.raises(ParameterError, match=r"'mass' was not fitted.*expected one of \['C_f'"):
        advise(quiet(log), log, parameter="mass")


def lap(car, *, scale=1.0, sign=1.0):
    """A log with hairpins at 6 m/s and bends up to 45 m/s, at about 0.4 g; a smaller car is slower by ``scale``."""
    t = np.arange(0, 80.0, car.dt)
    v_x = scale * (24 + 18 * np.sin(2 * np.pi * t / 40.0))
    wheelbase = car.value("wheelbase")
    delta = np.minimum(4.0 * wheelbase / v_x**2, 0.45)
    delta = delta * np.sin(2 * np.pi * 0.13 * t) * (1 + 0.2 * np.sin(2 * np.pi * 0.9 * t))
    inputs = {"delta": delta, "v_x": v_x}
    r = car.simulate(Dataset.from_arrays(inputs, {"r": np.zeros(len(t))}, car.dt)).y[:, 0]
    r = r + 2e-3 * np.random.default_rng(1).standard_normal(len(t)) * (np.arange(len(t)) > 0)
    return Dataset.from_arrays({"delta": sign * delta, "v_x": v_x}, {"r": r}, car.dt)


SMALL = replace(
    CAR,
    params=replace(SOUSA_TABLE_7_2, mass=2.5, wheelbase=0.26, l_f=0.13, inertia_z=0.04, C_f=60.0, C_r=65.0),
    dt=0.02,
)


@pytest.mark.parametrize("case", ["a car", "a car whose steering has the wrong sign", "a car of 2.5 kg"])
def test_manoeuvres_are_ones_that_the_car_can_drive(case):
    car, scale = (SMALL, 0.1**0.5) if "2.5 kg" in case else (CAR, 1.0)
    log = lap(car, scale=scale, sign=-1.0 if "sign" in case else 1.0)
    ranked = advise(quiet(log, GreyBox(start=car, free=FREE)), log)
    assert ranked
    wheelbase = car.value("wheelbase")
    rest = np.median(log["delta"])
    asked = (
        np.abs((log["delta"] - rest) * log["v_x"] ** 2).max() / wheelbase
    )  # lateral acceleration without slip [m/s2]
    turned = np.abs(log["v_x"] * log["r"]).max()
    for a in ranked:
        v_x, delta = a.data["v_x"][0], np.abs(a.data["delta"] - rest).max()
        assert v_x <= 1.05 * log["v_x"].max() * (1 + 1e-9)
        assert delta * v_x**2 / wheelbase <= max(1.1 * asked, min(1.5 * asked, 0.5 * 9.81)) * (1 + 1e-6)
        assert v_x * np.abs(a.data["r"]).max() <= 1.05 * 1.1 * turned + 1e-2 * scale
        assert f"{v_x:.3g} m/s" in a.manoeuvre


@pytest.mark.slow
def test_advice_for_the_ferrari_stays_within_its_log(real_data):
    log = ferrari_250lm(20.0).split(0.5)[0].select(inputs=("delta", "v_x"), outputs=("r",))
    start = replace(CAR, params=FERRARI_250LM, dt=log.dt)
    ranked = advise(quiet(log, GreyBox(start=start, free=FREE)), log)
    assert ranked
    rest = np.median(log["delta"])
    asked, turned = np.abs((log["delta"] - rest) * log["v_x"] ** 2).max(), np.abs(log["v_x"] * log["r"]).max()
    for a in ranked:
        v_x = a.data["v_x"][0]
        assert v_x <= 1.05 * log["v_x"].max() * (1 + 1e-9)
        assert np.abs(a.data["delta"] - rest).max() * v_x**2 <= 1.5 * asked
        assert v_x * np.abs(a.data["r"]).max() <= 1.2 * turned
