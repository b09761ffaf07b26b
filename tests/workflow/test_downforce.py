"""Downforce and a locked axle in a job: path followers know what they do where they drive, the stand-in has none."""

import re

import pytest

from slipangle.errors import ConfigError
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.workflow.controllers import CONTROLLERS, ControllerSettings
from slipangle.workflow.drive import PlantSettings, build_plant

KNOWN = dict(mass=740.0, inertia_z=1000.0, wheelbase=3.0, l_f=1.7, C_f=5e4, C_r=7e4)


def car(**down):
    return SaturatingBicycle(params=SaturatingBicycleParams(**KNOWN, **down), dt=0.02, outputs=("v_y", "r"))


def test_a_path_follower_has_the_stiffness_of_its_speed():
    wanted = ControllerSettings(model="car", kind="feedforward-feedback", v_x=50.0)
    law = CONTROLLERS[wanted.kind](car(downforce_f=0.35, downforce_r=0.48), wanted)
    C_f = 5e4 * (1 + 0.35 * 50.0**2 / (740 * 9.81 * 1.3 / 3.0))
    C_r = 7e4 * (1 + 0.48 * 50.0**2 / (740 * 9.81 * 1.7 / 3.0))
    assert law.understeer_gradient == pytest.approx(740 / 3.0 * (1.3 / C_f - 1.7 / C_r), rel=1e-9)


def test_the_stand_in_is_said_to_be_without_downforce():
    assert "without its downforce" in build_plant(PlantSettings(), car(downforce_r=0.48))[2]
    assert "downforce" not in build_plant(PlantSettings(), car())[2]


def test_the_stand_in_is_said_to_have_wheels_that_turn_by_themselves():
    assert "turn as one" in build_plant(PlantSettings(), car(locked_half_track=0.7))[2]
    assert "turn as one" not in build_plant(PlantSettings(), car())[2]


def test_a_path_follower_steers_as_much_as_a_locked_axle_asks():
    wanted = ControllerSettings(model="car", kind="feedforward-feedback", v_x=50.0)
    law = CONTROLLERS[wanted.kind](car(locked_half_track=0.7), wanted)
    more = 1 + (0.7 / 3.0) ** 2 * (1 + 7e4 / 5e4)
    assert law.params.steering_gain == pytest.approx(1 / more, rel=1e-9)
    assert law.params.C_f == pytest.approx(5e4 * more, rel=1e-9)


def test_ice_on_which_the_stand_in_s_tires_would_be_too_steep_is_named_with_the_least_friction():
    with pytest.raises(ConfigError, match=r"\[plant\] friction is 0.05, .*; expected 0\.\d+ or more") as refused:
        build_plant(PlantSettings(friction=0.05), car())
    lowest = float(re.search(r"expected (0\.\d+) or more", str(refused.value))[1])
    load = 740 * 9.81 / 3.0 / 2  # of a wheel, by its distance from the other axle
    assert lowest == pytest.approx(max(5e4 / (2 * load * 1.3), 7e4 / (2 * load * 1.7)) * 2 / 165, abs=1e-3)
    build_plant(PlantSettings(friction=lowest), car())
