"""A drive says what of it, and of its plans, lies outside of the data that its controller's model learned from."""

from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.models.model import FitInfo
from slipangle.models.region import Region
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler was found")

CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))


def trained(fastest, largest):
    """The car, as if it had learned from data up to a speed [m/s] and a steering angle [rad]."""
    t = np.linspace(0.0, 300.0, 6000)
    channels = {"delta": largest * np.sin(t), "v_x": fastest - 5 + 5 * np.sin(0.7 * t)}
    data = sa.Dataset.from_arrays(channels, {"v_y": np.sin(1.3 * t), "r": np.sin(2.1 * t)}, 0.05)
    nothing = {"names": (), "values": np.empty(0), "covariance": np.empty((0, 0)), "noise_std": np.ones(2)}
    return replace(CAR, fit_info=FitInfo(**nothing, n_samples=1, region=Region.of(data)))


@pytest.fixture(scope="module")
def run():
    limit = sa.deg(20)
    mpc = sa.MPC(
        sa.OnGround(CAR),
        horizon=12,
        controls=("delta",),
        Q=sa.Weights(X=0.1, Y=1.0, psi=1.0),
        S=sa.Weights(delta=50.0),
        limits=sa.Limits(delta=(-limit, limit)),
    )
    return sa.closed_loop(sa.Plant(sa.OnGround(CAR)), mpc, sa.double_lane_change(20.0), sample=0.05)


def test_a_model_of_such_driving_and_one_that_learned_from_nothing_have_no_word(run):
    assert run.beyond(trained(25.0, 0.5)) == ()
    assert run.beyond(sa.OnGround(trained(25.0, 0.5))) == ()
    assert run.beyond(CAR) == ()


def test_one_of_slower_driving_says_so_of_the_drive_and_of_the_plans(run):
    driven, planned = run.beyond(sa.OnGround(trained(15.0, 0.5)))
    assert driven.startswith(
        "100 % of the drive, first at t = 0 s, lie outside of the training data: v_x 72 km/h, there"
    )
    assert planned.startswith("100 % of the motion that its plans foresee, first at t = 0 s")


def test_one_of_less_steering_says_when_and_how_far(run):
    most = float(np.abs(run["delta"]).max())
    driven, _ = run.beyond(trained(25.0, 0.5 * most))
    outside = np.abs(run["delta"]) > 1.2 * 0.5 * most
    first = run.t[np.argmax(outside)]
    assert f"first at t = {first:g} s" in driven
    assert f"delta {np.degrees(run['delta'][np.argmax(np.abs(run['delta']))]):.3g} deg, there " in driven
