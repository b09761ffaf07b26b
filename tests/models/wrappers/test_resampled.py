"""Models at another sample time: the same motion, also behind a steering that is late, and what a controller gets."""

import warnings

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.simulate.run import End
from slipangle.workflow.drive import ControllerSettings, PlantSettings, build_mpc, drive
from tests.models.all_models import ALL_MODELS

LATE = Delayed(
    Steered(Bicycle(params=FERRARI_250LM, dt=0.01, outputs=("r",)), steering_lag=0.05),
    delays={"delta": 0.04},
    longest=0.3,
)


def step_response(model, duration=1.0):
    """Outputs at the end of a second at a held input, after standing still in it."""
    n = round(duration / model.dt) + model.memory
    held = {"v_x": 20.0, "delta": 0.02, "bank": 0.01, "v_x_dot": 0.1}
    inputs = {name: np.full(n, held[name]) for name in model.inputs}
    start = {name: np.zeros(n) for name in ("v_y", "r", "a_y")}
    data = Dataset.from_arrays(inputs, start, model.dt, extra={})
    run = model.free_run(model.initial_state(data.rows(0, model.memory)), data.u[model.memory - 1 :])
    return run[round(duration / model.dt) - 1]


@pytest.mark.parametrize(
    "name",
    [
        "bicycle",
        "nonlinear bicycle",
        "relaxing bicycle",
        "steered bicycle",
        "steered, banked",
        "bicycle with late steering",
    ],
)
def test_the_motion_does_not_depend_on_the_sample_time(name):
    model = ALL_MODELS[name]
    quicker = model.resampled(model.dt / 2)
    assert quicker.dt == model.dt / 2
    assert quicker.outputs == model.outputs
    assert step_response(quicker, 10 * model.dt) == pytest.approx(step_response(model, 10 * model.dt), rel=2e-3)


def test_outputs_are_those_asked_for_and_no_more_past_is_kept_than_the_delay_needs():
    slower = LATE.resampled(0.05, outputs=("v_y", "r"))
    assert slower.outputs == ("v_y", "r")
    assert slower.delays == {"delta": 0.04}
    assert slower.n_past == 2
    assert slower.ode.params == LATE.ode.params


def test_the_steps_follow_a_lag_that_is_short_for_the_new_sample_time():
    quick = Steered(Bicycle(params=FERRARI_250LM, dt=0.002), steering_lag=0.001)
    with pytest.raises(ParameterError, match="steering_lag"):
        Steered(Bicycle(params=FERRARI_250LM, dt=0.05), steering_lag=0.001)
    slower = quick.resampled(0.05)
    assert slower.substeps == 20
    assert np.all(np.isfinite(step_response(slower)))


def test_a_car_with_late_steering_is_driven_at_the_controllers_rate():
    settings = ControllerSettings(model="car", v_x=15.0, manoeuvre="lane-changes")
    controller = build_mpc(LATE, settings)
    assert controller.dt == settings.dt
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run, said, _ = drive(settings, PlantSettings(), LATE, lambda share: None)
    assert "as late as identified" in said
    assert run.end is End.FINISHED
    assert run.rmse() < 0.15
