"""A network's physics from what is known of a car alone: it finds a made car, and says what it lacks."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError, MissingColumnError, ParameterError
from slipangle.identify.networks.hybrid import Hybrid
from slipangle.identify.networks.joint import Joint
from slipangle.identify.physics.at_the_limit import KnownCar
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.vehicles.nonlinear_bicycle import with_speed_derivative
from slipangle.reproduce import table_8_2
from slipangle.workflow.kinds import KINDS, check_entries

KNOWN = {"mass": 982.0, "wheelbase": 2.4, "l_f": 1.3}


def drive(n=900, dt=0.05):
    """A made car's yaw rate, steering and speed; in SI units."""
    t = np.arange(n) * dt
    delta = 0.06 * np.sin(0.9 * t + 0.002 * t**2) + 0.03 * np.sin(3.1 * t)
    v_x = 22 + 6 * np.sin(0.25 * t)
    data = with_speed_derivative(Dataset.from_arrays({"delta": delta, "v_x": v_x}, {"r": 0.0 * t}, dt, name="drive"))
    truth = KnownCar(**KNOWN).guess(dt)
    truth = replace(truth, params=truth.params.with_values(C_f=6e4, C_r=9e4, steering_offset=0.01, steering_lag=0.06))
    return data.with_channel("r", truth.simulate(data).channel("r"), "rad/s")


@pytest.mark.slow
def test_the_physics_is_found_from_mass_and_geometry():
    data = drive()
    model = KnownCar(**KNOWN).bicycle(data)
    run = model.simulate(data)
    assert np.sqrt(np.mean(run.error**2)) < 1e-3 * np.std(data["r"])
    assert model.params.steering_offset == pytest.approx(0.01, abs=1e-3)


def test_a_first_guess_scales_with_the_car():
    small, large = (KnownCar(mass=m, wheelbase=w, l_f=w / 2).guess(0.05).params for m, w in ((1.5, 0.25), (4e4, 6.0)))
    assert large.C_f / small.C_f == pytest.approx(4e4 / 1.5)
    assert small.inertia_z == pytest.approx(1.5 * 0.125**2)


def test_the_drag_of_a_first_guess_scales_with_the_car():
    """Lengths and speeds times 3, mass times 300: every acceleration times 3."""
    small, large = (KnownCar(mass=m, wheelbase=w, l_f=w / 2).guess(0.05).params for m, w in ((5.0, 0.8), (1500.0, 2.4)))
    assert large.drag * 3**2 / 300 == pytest.approx(3 * small.drag)
    assert KnownCar(**KNOWN).guess(0.05).params.drag == pytest.approx(0.4, rel=0.01)


@pytest.mark.parametrize("estimator", [Joint, Hybrid])
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "neither .* nor mass, wheelbase, l_f are given; expected a model"),
        ({"mass": 982.0, "wheelbase": 2.4}, "nor l_f is given"),
        ({"mass": 982.0, "wheelbase": 2.4, "l_f": 2.6}, "l_f is 2.6 m and the wheelbase 2.4 m"),
        ({"mass": 0.1, "wheelbase": 2.4, "l_f": 1.3}, "mass is 0.1 kg at a wheelbase of 2.4 m"),
    ],
)
def test_a_car_that_is_not_known_gets_a_sentence(estimator, given, said):
    with pytest.raises(ParameterError, match=said) as error:
        estimator(**given)
    assert "\n" not in str(error.value)


def test_a_model_and_its_parameters_are_one_too_many():
    start = KnownCar(**KNOWN).guess(0.05)
    with pytest.raises(ParameterError, match="start is given, and mass too"):
        Joint(start=start, mass=982.0)
    with pytest.raises(ParameterError, match="base is given, and mass, wheelbase, l_f too"):
        Hybrid(base=start, **KNOWN)


@pytest.mark.parametrize("estimator", [Joint(**KNOWN), Hybrid(**KNOWN), Joint(start=KnownCar(**KNOWN).guess(0.05))])
@pytest.mark.parametrize("channel", ["v_x", "v_x_dot", "delta", "r"])
def test_a_missing_channel_gets_a_sentence(estimator, channel):
    data = drive(200)
    names = [c.name for c in data.channels if c.name != channel]
    without = Dataset.from_arrays(
        {n: data[n] for n in names if n != "r"}, {n: data[n] for n in names if n == "r"}, 0.05
    )
    with pytest.raises(MissingColumnError, match=f"no channel '{channel}'") as error:
        estimator.fit(without)
    assert "\n" not in str(error.value)


# ---- as entries of a job -------------------------------------------------------------------------------------------


def test_a_job_names_them_and_their_defaults_are_those_of_table_8_2():
    joint = KINDS["joint"](**check_entries("joint", dict(KNOWN), "model 1"))
    assert joint == Joint(**KNOWN)
    base = joint.guess(0.05)
    assert replace(joint, start=base, mass=None, wheelbase=None, l_f=None) == table_8_2.chapter.joint(base, (0,))
    hybrid = KINDS["hybrid"](**check_entries("hybrid", dict(KNOWN), "model 1"))
    assert hybrid == Hybrid(**KNOWN)
    assert hybrid.discrepancy == table_8_2.chapter.narx(0)


@pytest.mark.parametrize(
    ("kind", "entries", "said"),
    [
        ("joint", {"mass": 982.0, "wheelbase": 2.4}, "neither start nor l_f is given"),
        ("hybrid", {**KNOWN, "mass": 2e-4}, "mass is 0.0002 kg; expected 0.001 to 100000 kg"),
        ("hybrid", {**KNOWN, "mass": 0.982}, "mass is 0.982 kg at a wheelbase of .*0.982 t are 982 kg"),
        ("joint", {**KNOWN, "epochs": 3}, "has no entry 'epochs'"),
    ],
)
def test_a_wrong_entry_gets_a_sentence(kind, entries, said):
    with pytest.raises(ConfigError, match=said):
        check_entries(kind, entries, "model 1")


@pytest.mark.slow
def test_small_ones_fit_in_one_call():
    data = drive(400)
    data = data.with_channel("r", data["r"] + 0.02 * np.random.default_rng(0).standard_normal(400), "rad/s")
    stages = [{"epochs": 3}, {"horizon": 40, "epochs": 2}]
    tiny = {"joint": {"hidden": (3,), "max_iterations": 3}, "hybrid": {"discrepancy": {"hidden": 4, "stages": stages}}}
    physics = KnownCar(**KNOWN).bicycle(data).fit_info
    assert physics.warnings
    base = GreyBox(start=KnownCar(**KNOWN).guess(0.05), free=("C_f",), starts=1).fit(data)
    for kind, entries in tiny.items():
        model = KINDS[kind](**check_entries(kind, {**KNOWN, **entries}, "model 1")).fit(data)
        errors = [np.std(m.simulate(data).error[m.memory :, 0]) for m in (model, base)]
        assert errors[0] < errors[1]
        assert set(physics.warnings) <= set(model.fit_info.warnings)
