"""A car with downforce in a job: path followers know its stiffness where they drive, the stand-in has no downforce."""

import pytest

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
