"""Loops whose measurements go missing: no exception, no NaN, no limit broken, and the car drives on."""

import numpy as np
import pytest

from slipangle.control.followers.followers import Stanley
from slipangle.control.mpc import MPC
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import End
from slipangle.simulate.sensors import Sensor, Sensors

LIMIT, RATE = 0.1, 0.5
CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("v_y", "r")))
MPC_ = MPC(
    OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))),
    horizon=12,
    controls=("delta",),
    Q=Weights(X=0.1, Y=1.0, psi=1.0),
    S=Weights(delta=50.0),
    limits=Limits(delta=LIMIT),
    rates=Limits(delta=RATE),
)
STANLEY = Stanley(params=SOUSA_TABLE_7_2, limit=LIMIT)
CHANNELS = ("X", "Y", "psi", "v_x", "v_y", "r", "delta")


def drive(seed, controller):
    rng = np.random.default_rng(seed)
    lost = rng.choice(["nan", "hold"], p=[0.8, 0.2])
    sensors = {
        name: Sensor(
            noise=0.002,
            drop_out=float(rng.uniform(0, 0.6)),
            drop_length=float(rng.choice([1, 5, 40])),
            delay=float(rng.choice([0, 0.05])),
            lost=str(lost),
        )
        for name in CHANNELS
        if rng.random() < 0.7
    }
    plant = Plant(CAR, sensors=Sensors(**sensors), seed=seed)
    return closed_loop(plant, controller, double_lane_change(12.0), duration=4.0)


def check(seeds):
    ended = []
    for seed in seeds:
        controller = MPC_ if seed % 2 else STANLEY
        run = drive(seed, controller)
        commands = run.commands[:, 0]
        assert np.isfinite(run.states).all(), seed
        assert np.isfinite(commands).all(), seed
        assert np.abs(commands).max() <= LIMIT + 1e-9, seed
        if controller is MPC_:
            assert np.abs(np.diff(commands, prepend=0.0)).max() <= RATE * MPC_.dt + 1e-9, seed
        ended.append(run.end)
    return ended


def test_loops_with_missing_measurements():
    ended = check(range(12))
    assert ended.count(End.NOT_FINITE) == 0


def test_a_speed_that_goes_missing_once_is_forgotten():
    """The controller's model takes the last speed known: one NaN must not stay in its state."""
    sensors = Sensors(v_x=Sensor(drop_out=0.3, drop_length=3.0, lost="nan"))
    run = closed_loop(Plant(CAR, sensors=sensors, seed=4), MPC_, double_lane_change(12.0))
    assert run.end is End.FINISHED
    assert run.max("y") < 0.1
    assert run.fallbacks == 0


@pytest.mark.slow
def test_a_thousand_loops_with_missing_measurements():
    check(range(1000))
