"""The loop with an estimator: true states give the same drive, late and slow poses one that stays on the path."""

import numpy as np
import pytest

from slipangle.control.followers.preview_lqr import PreviewLQR
from slipangle.errors import ParameterError, SampleTimeError
from slipangle.estimate.ekf import EKF
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Values
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.sensors import Sensor, Sensors

CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.002, outputs=("v_y", "r")))
LAW = PreviewLQR(params=SOUSA_TABLE_7_2)
FAST = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("r",)))
NOISE = {"r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.002}
POSE = ("X", "Y", "psi")
PATH = double_lane_change(20.0, blend=10.0)


def estimator(model=FAST, **more):
    return EKF(start=model, noise_std=NOISE, process_std={"v_y": 0.1, "r": 0.05}, **more)


def late(seed, **more):
    pose = {n: Sensor(interval=0.1, delay=0.1, noise=NOISE[n], **more) for n in POSE}
    return Plant(CAR, sensors=Sensors(r=Sensor(noise=0.002, interval=0.01), **pose), seed=seed)


def test_a_pose_that_is_slow_and_late_costs_little_with_an_estimator():
    """v_y is not measured; without an estimator the pose is taken for that of now."""
    plant = late(1)
    blind = closed_loop(plant, LAW, PATH)
    seen = closed_loop(plant, LAW, PATH, estimator=estimator(late=dict.fromkeys(POSE, 0.1), gate=5.0))
    best = closed_loop(Plant(CAR), LAW, PATH)
    assert blind.rmse("y") > 0.1
    assert seen.rmse("y") < best.rmse("y") + 0.01


def test_lost_samples_are_bridged():
    lossy = late(2, drop_out=0.3, drop_length=3.0, lost="nan")
    run = closed_loop(lossy, LAW, PATH, estimator=estimator(late=dict.fromkeys(POSE, 0.1)))
    assert np.isfinite(run.commands).all()
    assert run.rmse("y") < 0.15


def test_the_true_state_by_way_of_an_estimator_gives_the_same_drive():
    """The plant is the filter's own model, measured without noise: the estimate is the state."""
    car = Plant(FAST, noise=Values())
    plain = closed_loop(Plant(OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01))), LAW, PATH)
    run = closed_loop(car, LAW, PATH, estimator=estimator())
    assert run.e_y == pytest.approx(plain.e_y, abs=1e-9)


def test_what_does_not_fit_is_said():
    with pytest.raises(SampleTimeError, match="the estimator's step"):
        closed_loop(Plant(CAR), LAW, PATH, estimator=estimator(FAST.__class__(FAST.model.resampled(0.005))))
    with pytest.raises(ParameterError, match="the estimator does not know 'X'"):
        closed_loop(Plant(CAR), LAW, PATH, estimator=EKF(start=FAST.model, noise_std={"r": 0.002}))
