"""The car that a job's controller drives is built around the physics inside of a model, whatever stands around it."""

import numpy as np
import pytest

from slipangle.errors import ConfigError
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.hybrid import HybridModel, OffsetModel
from slipangle.workflow.drive import ControllerSettings, PlantSettings, build_plant, drive, late

PHYSICS = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))


def network():
    """One that adds nothing."""
    net = MLP.random((4, 3, 2), activation="tanh", seed=0)
    channels = {"dt": 0.05, "inputs": ("delta", "v_x"), "outputs": ("v_y", "r")}
    return NARXModel(na=1, nb=1, nk=1, network=net.with_parameters(np.zeros(net.n_parameters)), **channels)


def hybrid(base=PHYSICS):
    return HybridModel(base=base, discrepancy=network())


@pytest.mark.parametrize("model", [hybrid(), OffsetModel(model=PHYSICS), OffsetModel(model=hybrid())], ids=str)
def test_a_hybrid_and_an_adapted_car_are_driven_as_their_physics(model):
    plant, _, said = build_plant(PlantSettings(), model)
    assert plant.model.params == build_plant(PlantSettings(), PHYSICS)[0].model.params
    assert "stand-in" in said


def test_what_is_late_inside_of_it_is_late_in_the_plant():
    assert late(hybrid(Steered(PHYSICS, steering_lag=0.07)), "steering_lag") == {"delta": 0.07}


def test_a_hybrid_of_nothing_physical_has_no_car():
    with pytest.raises(ConfigError, match="the controller's model is no bicycle"):
        build_plant(PlantSettings(), hybrid(network()))


def test_a_controller_on_a_hybrid_that_adds_nothing_drives_as_one_on_its_physics():
    wanted = ControllerSettings.from_table({"model": "car", "kind": "mpc", "v_x": 15.0, "dt": 0.05, "cars": 0}, "job")
    mixed, alone = (drive(wanted, PlantSettings(), model, lambda share: None)[0] for model in (hybrid(), PHYSICS))
    assert mixed.finished
    assert mixed.rmse() == pytest.approx(alone.rmse(), rel=0.1)
