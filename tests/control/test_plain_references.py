"""Who keeps to the limits and weights that it was made with says so of a reference that has others."""

from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.errors import ParameterError
from slipangle.export import Recorder, build, load
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.paths.lane_change import double_lane_change
from tests.control.marx.test_mpc import BY_POSE

needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())
CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r",)))
PATH = double_lane_change(15.0)
OWN = {
    "limits": {"r": (-0.1, 0.1)},
    "Q": {"Y": 0.1},
    "S": {"delta": 1e3},
}


def mpc():
    return sa.MPC(
        CAR,
        horizon=10,
        Q=sa.Weights(Y=1.0, psi=1.0),
        R=sa.Weights(delta=1.0),
        S=sa.Weights(delta=1.0),
        limits=sa.Limits(delta=0.3, r=1.0),
        controls=("delta",),
    )


def references(one):
    """A plain one and those with something of their own."""
    plain = one.reference(PATH.ahead(0.0, one.times))
    return plain, [one.vary(plain, **{name: own}) for name, own in OWN.items()]


def refuses(one, x, plain, varied):
    """From nothing, and from a plan before, where the usual call takes few steps."""
    before = one.plan(x, plain)
    for other in varied:
        name = next(n for n in OWN if getattr(other, n) is not None)
        for previous in (None, before):
            with pytest.raises(ParameterError, match=rf"the reference has {name} of its own; expected none"):
                one.plan(x, other, previous)
    assert one.plan(x, plain, one.plan(x, plain)).status.solved


def test_a_follower_a_recorder_and_arx_models():
    one = mpc()
    plain, varied = references(one)
    x = CAR.straight(15.0)
    refuses(Recorder(one), x, plain, varied)
    stanley = sa.Stanley(params=SOUSA_TABLE_7_2)
    look = stanley.reference(PATH.ahead(0.0, stanley.times))
    with pytest.raises(ParameterError, match="the reference has R of its own"):
        stanley.plan(x, replace(look, R=np.ones((stanley.horizon, 1))))
    plain = BY_POSE.reference(PATH.ahead(0.0, BY_POSE.times))
    weights = {"limits": np.zeros((11, 1, 2)), "Q": np.ones((11, 2)), "S": np.ones((10, 1))}
    varied = [replace(plain, **{name: own}) for name, own in weights.items()]
    refuses(BY_POSE, BY_POSE.model.straight(15.0), plain, varied)


@needs_compiler
def test_a_built_controller(tmp_path):
    one = mpc()
    plain, varied = references(one)
    refuses(load(build(one, tmp_path / "built")), CAR.straight(15.0), plain, varied)
