"""Where tracking is exact the cost has no slope; a limit that then becomes active must be kept as Ipopt keeps it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning
from slipangle.models.custom import Ode
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime import RealTime, backend
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from tests.optimal.realtime.test_realtime import car

N = 12
SOFT = {"hard": (None, None), "squared": (100.0, None), "plain": (None, 30.0), "both": (100.0, 30.0)}


@pytest.fixture(params=["compiled", "interpreted"])
def solver(request, monkeypatch):
    if request.param == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        backend._say_once.cache_clear()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        yield RealTime()


def softened(mpc, name, kind):
    """One limit made soft."""
    square, plain = SOFT[kind]
    return replace(
        mpc,
        slack=Weights(**({name: square} if square else {})),
        slack_linear=Weights(**({name: plain} if plain else {})),
    )


def point_mass():
    """Brakes for what appears ahead."""
    model = Ode(
        f=lambda x, u, p: [u[0] * 1.3, x[0] * 0.7],
        states=("v", "X"),
        inputs=("a", "Xo"),
        more=lambda x, u, p: {"gap": u[1] - x[1]},
        outputs=("gap",),
        params={},
        dt=0.05,
    )
    limits = Limits(a=8.0, gap=(2.0, np.inf))
    mpc = MPC(model, solver="ipopt", horizon=N, controls=("a",), Q=Weights(v=1.0), R=Weights(a=0.1), limits=limits)
    tracked = np.full((N + 1, 1), 15.0)
    return mpc, "gap", np.array([15.0, 0.0]), [Reference(tracked=tracked, exogenous=np.full((N, 1), d)) for d in (8, 7)]


def lanes(mpc, x, reference):
    """The lane becomes narrow on one side from some stage on, so that its middle leaves the path."""
    cases = []
    for at, right in ((N // 2, 0.5), (N - 2, 0.7), (N, 0.2)):
        corridor = np.full((N + 1, 2), 5.0)
        corridor[at:, 0] = right
        cases.append(replace(reference, corridor=corridor))
    return mpc, "e_y", x, cases


def bicycle():
    mpc = MPC(
        OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.1, outputs=("r",))),
        solver="ipopt",
        horizon=N,
        Q=Weights(X=1.0, Y=1.0, psi=1.0),
        R=Weights(delta=1.0),
        limits=Limits(delta=0.3),
        corridor=1.8,
    )
    x = np.zeros(5)
    tracked = np.zeros((N + 1, 3))
    tracked[:, 0] = 15.0 * mpc.times
    return lanes(mpc, x, Reference(tracked=tracked, exogenous=np.full((N, 1), 15.0)))


def single_track():
    mpc = replace(car(N), corridor=1.8)
    x = mpc.model.straight(20.0)
    states = [x]
    for _ in range(N):
        states.append(mpc.model.step(states[-1], np.zeros(3)))
    tracked = np.array([[s[mpc.model.states.index(n)] for n in mpc.references] for s in states])
    return lanes(mpc, x, Reference(tracked=tracked, exogenous=np.zeros((N, 1))))


EACH = pytest.mark.parametrize(
    ("problem", "kind"),
    [
        pytest.param(
            p,
            k,
            id=f"{p.__name__}, {k}",
            marks=[pytest.mark.slow] * (p is single_track or (p is bicycle and k in ("squared", "plain"))),
        )
        for p in (point_mass, bicycle, single_track)
        for k in SOFT
    ],
)


@EACH
def test_a_limit_that_becomes_active_is_kept(problem, kind, solver):
    mpc, name, x, cases = problem()
    ours, theirs = (softened(replace(mpc, solver=s), name, kind) for s in (solver, "ipopt"))
    scale = np.maximum(mpc.ocp.input_bounds[:, 1], 1e-9)
    moved = 0
    for case in cases:
        mine, wanted = ours.plan(x, case), theirs.plan(x, case)
        assert wanted.status.solved
        assert mine.status is Status.SOLVED
        assert mine.cost == pytest.approx(wanted.cost, rel=1e-6, abs=1e-9)
        assert np.abs((mine.u - wanted.u) / scale).max() <= 1e-4
        moved += np.abs(mine.u / scale).max() > 1e-3
    assert moved


@EACH
def test_it_may_appear_during_the_drive(problem, kind, solver):
    """Steps on the path, each of them exact, then the limit."""
    mpc, name, x, cases = problem()
    ours, theirs = (softened(replace(mpc, solver=s), name, kind) for s in (solver, "ipopt"))
    scale = np.maximum(mpc.ocp.input_bounds[:, 1], 1e-9)
    corridor = None if mpc.ocp.corridor is None else np.full((N + 1, 2), 5.0)
    far = replace(cases[0], exogenous=cases[0].exogenous + 1e3 * (mpc.ocp.corridor is None), corridor=corridor)
    plan = ours.plan(x, far, ours.plan(x, far))
    assert np.abs(plan.u / scale).max() <= 1e-9
    for _ in range(3):
        plan = ours.plan(x, cases[0], plan)
        assert plan.status.solved
    assert np.abs((plan.command - theirs.plan(x, cases[0]).command) / scale).max() <= 2e-2
