"""Cars with steered rear wheels and torque vectoring in jobs: fitted by name, driven on plants that have neither."""

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.data.dataset import Dataset
from slipangle.errors import ConfigError, ParameterError
from slipangle.models.vehicles.aided import RearSteered, TorqueVectored
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.workflow.controllers import ControllerSettings
from slipangle.workflow.drive import PlantSettings, drive
from slipangle.workflow.kinds import KINDS, check_entries, fitted
from slipangle.workflow.robustness import tried

KNOWN = dict(mass=1300.0, inertia_z=1900.0, wheelbase=2.6, l_f=1.2)
TRUE = BicycleParams(**KNOWN, C_f=9e4, C_r=1.2e5)
pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")


def car(dt, outputs=("r", "v_y")):
    return TorqueVectored(RearSteered(Bicycle(params=TRUE, dt=dt, outputs=outputs)))


def steering(model):
    """A short plan of the steering along a path."""
    more = dict(horizon=12, controls=("delta",), Q=Weights(e_y=10.0, e_psi=10.0), S=Weights(delta=100.0))
    return MPC(OnGround(model), limits=Limits(delta=0.35), **more)


def test_a_job_fits_such_a_car_by_its_kind():
    rng, n = np.random.default_rng(3), 1500
    smooth = np.ones(20) / 20
    moved = [np.convolve(rng.standard_normal(n), smooth, "same") for _ in range(3)]
    inputs = {"delta": 0.2 * moved[0], "v_x": np.full(n, 18.0), "delta_r": 0.1 * moved[1], "M_z": 4e3 * moved[2]}
    empty = {"r": np.zeros(n), "v_y": np.zeros(n)}
    true = car(0.02).with_values(gain_M_z=0.8)
    y = true.simulate(Dataset.from_arrays(inputs, empty, 0.02)).y
    log = Dataset.from_arrays(inputs, dict(zip(empty, y.T, strict=True)), 0.02)
    table = {"car": {**KNOWN, "inertia_z": 1500.0, "C_f": 6e4, "C_r": 6e4}, "rear_steered": True}
    table |= {"torque_vectored": True, "free": ["C_f", "C_r", "inertia_z", "gain_M_z"]}
    entries = check_entries("bicycle", table, "[[model]]")
    found = fitted(KINDS["bicycle"], entries, (), ("r", "v_y"), log, "car")
    values = [found.value(n) for n in ("C_f", "C_r", "inertia_z", "gain_M_z")]
    assert values == pytest.approx([9e4, 1.2e5, 1900.0, 0.8], rel=1e-4)
    with pytest.raises(ConfigError, match="car has no parameter 'gain_Mz'"):
        check_entries("bicycle", table | {"car": {"gain_Mz": 1.0}}, "[[model]]")


def test_inputs_that_the_plant_has_not_are_held():
    """The same drive as of a controller that knows of none."""
    plant = Plant(OnGround(Bicycle(params=TRUE, dt=0.001, outputs=("r", "v_y"))))
    path = double_lane_change(20.0, run_in=10.0, run_out=5.0)
    plain = closed_loop(plant, steering(Bicycle(params=TRUE, dt=0.05, outputs=("r", "v_y"))), path, duration=2.0)
    aided = steering(car(0.05))
    assert {"delta_r", "M_z"} <= {*aided.exogenous}
    held = closed_loop(plant, aided, path, duration=2.0, held=Values(delta_r=0.0, M_z=0.0))
    assert held.commands == pytest.approx(plain.commands, abs=1e-7)
    turned = closed_loop(plant, aided, path, duration=2.0, held=Values(delta_r=0.0, M_z=500.0))
    assert np.abs(turned.commands - plain.commands).max() > 1e-3
    with pytest.raises(ParameterError, match="the controller names 'M_z'"):
        closed_loop(plant, aided, path, duration=2.0, held=Values(delta_r=0.0))
    with pytest.raises(ParameterError, match="held names 'wind'"):
        closed_loop(plant, aided, path, duration=2.0, held=Values(delta_r=0.0, M_z=0.0, wind=1.0))


def test_a_job_drives_on_a_stand_in_without_and_says_so():
    wanted = ControllerSettings(model="car", kind="mpc", v_x=15.0)
    run, said, _ = drive(wanted, PlantSettings(), car(0.02), lambda share: None)
    assert run.rmse("y") < 0.2
    assert said.endswith(", and its rear wheels straight, no yaw moment by its drive")
    plain = Bicycle(params=TRUE, dt=0.02, outputs=("r", "v_y"))
    assert "rear wheels" not in drive(wanted, PlantSettings(), plain, lambda share: None)[1]


@pytest.mark.skipif(compiled.compiler() is None, reason="cars are driven side by side in compiled code only")
def test_a_job_tries_it_on_cars_without_and_says_so():
    wanted = ControllerSettings(model="car", kind="mpc", v_x=15.0, cars=2)
    plant, quiet = PlantSettings(), lambda share: None
    _, _, controller = drive(wanted, plant, car(0.02), quiet)
    found = tried(wanted, plant, car(0.02), controller, quiet)
    assert found.trials.lacking == "They have no delta_r and no M_z: these stayed zero."
    assert found.trials.metrics()["without"] == ["delta_r", "M_z"]
