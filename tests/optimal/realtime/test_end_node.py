"""Exogenous inputs have a value of their own at the end of the horizon, the same for every solver."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning, ParameterError
from slipangle.models.custom import Ode
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from tests.optimal.realtime.test_realtime import car

N = 10


@pytest.fixture(params=["compiled", "interpreted", "ipopt"])
def solver(request, monkeypatch):
    """Every solver."""
    if request.param == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        backend._say_once.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        yield "ipopt" if request.param == "ipopt" else RealTime()


def follower(solver):
    """A point mass behind a moving obstacle."""
    model = Ode(
        f=lambda x, u, p: [u[0], x[0]],
        states=("v", "X"),
        inputs=("a", "Xo"),
        more=lambda x, u, p: {"gap": u[1] - x[1]},
        outputs=("gap",),
        params={},
        dt=0.1,
    )
    return MPC(
        model,
        horizon=N,
        controls=("a",),
        Q=Weights(v=1.0),
        R=Weights(a=0.1),
        limits=Limits(a=8.0, gap=(2.0, np.inf)),
        solver=solver,
    )


def obstacle(rows):
    """Where it is at each node: it drives at 5 m/s."""
    return 9.0 + 5.0 * 0.1 * np.arange(rows)[:, None]


def test_the_gap_is_that_at_the_end(solver):
    mpc = follower(solver)
    x, tracked = np.array([15.0, 0.0]), np.full((N + 1, 1), 15.0)
    whole = mpc.plan(x, Reference(tracked=tracked, exogenous=obstacle(N + 1)))
    short = mpc.plan(x, Reference(tracked=tracked, exogenous=obstacle(N)))
    assert whole.status is short.status is Status.SOLVED
    assert obstacle(N + 1)[-1, 0] - whole.x[-1, 1] == pytest.approx(2.0, abs=1e-6)
    assert obstacle(N)[-1, 0] - short.x[-1, 1] == pytest.approx(2.0, abs=1e-6)  # held: a step late
    theirs = follower("ipopt").plan(x, Reference(tracked=tracked, exogenous=obstacle(N + 1)))
    assert whole.u == pytest.approx(theirs.u, abs=1e-5)
    after = mpc.plan(whole.x[1], Reference(tracked=tracked, exogenous=obstacle(N + 2)[1:]), whole)
    assert after.status.solved
    assert obstacle(N + 2)[-1, 0] - after.x[-1, 1] == pytest.approx(2.0, abs=1e-5)


def test_what_holds_at_the_end_only_does_not_bind_before_it(solver):
    mpc = follower(solver)
    x, tracked = np.array([5.0, 0.0]), np.full((N + 1, 1), 5.0)
    wall = np.full((N + 1, 1), 1e3)
    wall[-1] = 6.0
    plan = mpc.plan(x, Reference(tracked=tracked, exogenous=wall))
    assert plan.status is Status.SOLVED
    assert plan.x[-1, 1] == pytest.approx(4.0, abs=1e-6)
    other = mpc.plan(x, Reference(tracked=tracked, exogenous=np.vstack([wall[:-1], 0 * wall[-1:] + 1e3])))
    assert other.x[-1, 1] == pytest.approx(5.0, abs=1e-6)


def test_looks_along_a_path_bring_the_end():
    mpc = car(6)
    preview = double_lane_change(20.0, blend=12.0).ahead(0.0, mpc.times)
    for given in (0.0, np.zeros(6), np.zeros(7)):
        assert mpc.reference(preview, T_r=given).exogenous.shape == (7, 1)
    ramp = np.arange(7.0)
    assert (mpc.reference(preview, T_r=ramp).exogenous[:, 0] == ramp).all()
    assert (mpc.reference(preview, T_r=ramp[:6]).exogenous[:, 0] == [*ramp[:6], 5.0]).all()
    reference = mpc.reference(preview, T_r=0.0)
    with pytest.raises(ParameterError, match="exogenous"):
        mpc.check_reference(replace(reference, exogenous=np.zeros((8, 1))))
