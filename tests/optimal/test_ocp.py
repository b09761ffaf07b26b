"""One description: names, arrays, every argument effective, errors that help."""

import math
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

from slipangle.control.mpc import MPC
from slipangle.errors import ModelWarning, ParameterError, nearest
from slipangle.models.custom import Ode
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ocp import OCP, ProblemSettings, Reference
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.path import Path
from tests.optimal.linear import double_integrator, two_masses

CAR = OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "a_y")))
BASE = MPC(
    double_integrator(feedthrough=0.2),
    solver="ipopt",
    horizon=8,
    Q=Weights(p=1.0, v=0.1),
    R=Weights(a=0.1),
    S=Weights(a=0.1),
    limits=Limits(a=2.0, v=1.0),
    rates=Limits(a=30.0),
    slack=Weights(v=10.0),
    slack_linear=Weights(v=1.0),
)


def first_plan(ocp, x=(8.0, -0.9)):
    reference = Reference(
        tracked=np.zeros((ocp.horizon + 1, len(ocp.references))),
        exogenous=np.zeros((ocp.horizon, len(ocp.exogenous))),
    )
    return ocp.plan(np.array(x), reference)


CHANGES = {
    "model": {"model": double_integrator(dt=0.12, feedthrough=0.2)},
    "horizon": {"horizon": 5},
    "Q": {"Q": Weights(p=3.0, v=0.1)},
    "R": {"R": Weights(a=0.5)},
    "S": {"S": Weights(a=0.5)},
    "terminal": {"terminal": Weights(p=30.0)},
    "limits": {"limits": Limits(a=1.0, v=1.0)},
    "rates": {"rates": Limits(a=2.0)},
    "terminal_limits": {"terminal_limits": Limits(v=(0.4, 0.4))},
    "slack": {"slack": Weights(v=1000.0)},
    "slack_linear": {"slack_linear": Weights(v=100.0)},
    "huber": {"huber": Weights(p=0.5)},
    "steps": {"steps": (1, 1, 1, 1, 2, 2, 3, 3)},
    "terms": {"terms": {"mixed": lambda x, u, p: x[1] + u[0]}, "Q": Weights({**BASE.ocp.Q, "mixed": 1.0})},
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_every_number_changes_the_plan(change):
    other = replace(BASE, **change)
    for key, value in change.items():
        assert getattr(other.ocp, key) == value
    a, b = first_plan(BASE), first_plan(other)
    assert a.status.solved
    assert b.status.solved
    n = min(len(a.u), len(b.u))
    assert np.abs(a.u[:n] - b.u[:n]).max() > 1e-3


def test_every_argument_of_the_problem_is_covered():
    elsewhere = {"controls", "corridor", "parameters"}  # the next two tests, and test_horizon.py
    elsewhere |= {"scenarios", "free", "duration"}  # test_joined.py
    assert {f.name for f in fields(OCP) if f.init} == {*CHANGES, *elsewhere}
    assert {"model", *ProblemSettings.__annotations__} == {*CHANGES, *elsewhere}


def test_controls_choose_what_is_decided():
    model = two_masses()
    both = MPC(model, solver="ipopt", horizon=6, Q=Weights(p1=1.0), R=Weights(a1=0.1, a2=0.1))
    one = MPC(model, solver="ipopt", horizon=6, Q=Weights(p1=1.0), R=Weights(a1=0.1), controls=("a1",))
    assert (both.controls, both.exogenous) == (("a1", "a2"), ())
    assert (one.controls, one.exogenous) == (("a1",), ("a2",))
    assert first_plan(both, np.ones(4)).u.shape == (6, 2)
    still = Reference(tracked=np.zeros((7, 1)), exogenous=np.zeros((6, 1)))
    pushed = Reference(tracked=np.zeros((7, 1)), exogenous=np.full((6, 1), 3.0))
    u = [one.plan(np.ones(4), ref).u for ref in (still, pushed)]
    assert np.abs(u[0] - u[1]).max() > 1e-3
    swapped = replace(both, controls=("a2", "a1"))
    assert swapped.plan(np.ones(4), Reference(tracked=np.zeros((7, 1)), exogenous=np.empty((6, 0)))).u[
        :, ::-1
    ] == pytest.approx(first_plan(both, np.ones(4)).u, abs=1e-6)


def car(**options):
    settings = {"Q": Weights(Y=1.0, psi=1.0), "S": Weights(delta=10.0), "limits": Limits(delta=0.5), "solver": "ipopt"}
    return MPC(CAR, horizon=15, **(settings | options))


def test_corridor_keeps_the_vehicle_between_the_edges():
    path = double_lane_change(15.0, width=1.8)
    x = np.array([0.0, 0.0, -2.0, 0.0, 0.0])
    preview = path.ahead(path.project(-2.0, 0.0).s, 15, 0.05)
    off = replace(preview, Y=preview.Y + 1.5)  # the wanted line leaves the lane: 0.21 m are free to each side
    free = car().plan(x, off)
    # e_y counts from the wanted line, so the lane moves the other way
    moved = replace(off, right=off.right + 1.5, left=off.left - 1.5)
    kept = car(corridor=1.8, slack_linear=Weights(e_y=1e3)).plan(x, moved)
    half = 0.5 * (1.1 * 1.8 + 0.25) - 0.9
    inside = (preview.X > 0) & (preview.X < 15)
    assert free.x[inside, 3].max() > half + 0.05
    assert kept.status.solved
    assert np.abs(kept.x[inside, 3]).max() < half + 1e-4


def test_names_and_arrays():
    ocp = OCP(
        CAR,
        horizon=5,
        Q=Weights(e_y=2.0, r=3.0),
        S=Weights(delta=1.0),
        limits=Limits(delta=0.4, r=0.5, a_y=(-6.0, 5.0)),
        slack=Weights(a_y=7.0),
        terminal=Weights(e_psi=4.0),
        rates=Limits(delta=0.8),
    )
    assert (ocp.controls, ocp.exogenous) == (("delta",), ("v_x",))
    assert ocp.tracked == ("e_y", "r", "e_psi")
    assert ocp.references == ("r", "X", "Y", "psi")
    assert (ocp.limited, ocp.soft) == (("r", "a_y"), ("a_y",))
    assert ocp.limited_now.tolist() == [False, True]  # lateral acceleration follows the steering at once
    q, end, r, s = ocp.weights
    assert (q.tolist(), end.tolist(), r.tolist(), s.tolist()) == ([2, 3, 0], [0, 0, 4], [0], [1])
    assert ocp.input_bounds.tolist() == [[-0.4, 0.4]]
    assert ocp.step_bounds == pytest.approx(np.tile([-0.04, 0.04], (5, 1, 1)))
    x, u, w = np.array([0.1, 0.2, 3.0, 4.0, 0.3]), np.array([0.05]), np.array([20.0])
    assert np.asarray(ocp.dynamics(x, u, w)).ravel() == pytest.approx(CAR.step(x, np.array([0.05, 20.0])))
    error, limited = ocp.stage(x, u, w, np.array([0.5, 1.0, 1.0, 0.2]))
    e_y = 3.0 * np.cos(0.2) - 2.0 * np.sin(0.2)
    assert np.asarray(error).ravel() == pytest.approx([e_y, 0.2 - 0.5, 0.1])
    a_y = CAR.output(x, np.array([0.05, 20.0]))[1]
    assert np.asarray(limited).ravel() == pytest.approx([0.2, a_y])


def test_reference_from_a_path():
    ocp = OCP(CAR, horizon=5, Q=Weights(e_y=2.0, r=3.0, v_y=1.0), S=Weights(delta=1.0))
    preview = double_lane_change(20.0).ahead(50.0, 5, 0.05)
    reference = ocp.reference(preview)
    assert reference.exogenous == pytest.approx(np.full((6, 1), 20.0))
    table = dict(zip(ocp.references, reference.tracked.T, strict=True))
    assert np.array_equal(table["Y"], preview.Y)
    assert table["r"] == pytest.approx(20.0 * preview.curvature)
    assert np.array_equal(table["v_y"], np.zeros(6))
    assert ocp.reference(preview, v_x=12.0).exogenous == pytest.approx(12.0)
    with pytest.raises(ParameterError, match="6"):
        ocp.reference(double_lane_change(20.0).ahead(50.0, 6, 0.05))
    with pytest.raises(ParameterError, match="v_x"):
        ocp.reference(preview, v_X=12.0)


def test_the_speed_and_its_rate_over_the_horizon_are_those_of_the_profile():
    """An acceleration of 2 m/s2 from 10 m/s on, measured 0.5 m/s slower: v^2 = 10^2 + 2 a s along the path."""
    model = Ode(
        f=lambda x, u, p: [u[2] + 0.1 * u[0] - x[0]],
        states=("v",),
        inputs=("a", "v_x", "v_x_dot"),
        params={},
        dt=0.1,
    )
    ocp = OCP(model, horizon=5, Q=Weights(v=1.0), R=Weights(a=1.0), steps=(1, 1, 2, 2, 4))
    x = np.linspace(0.0, 100.0, 201)
    path = Path.from_points(x, np.zeros(201), spacing=0.05)
    path = path.with_speed(np.sqrt(100.0 + 4.0 * path.s))
    preview = path.ahead(10.0, ocp.times, v_x=float(path.speed(10.0)) - 0.5)
    v_x, rate = ocp.reference(preview).exogenous.T
    assert v_x[0] == pytest.approx(np.sqrt(140.0) - 0.5, abs=1e-3)
    assert rate == pytest.approx(2.0, rel=0.06)  # the slower car meets the same speeds later
    assert v_x[1:] == pytest.approx(v_x[:-1] + rate[:-1] * np.diff(ocp.times), abs=1e-9)
    assert rate[-1] == rate[-2]
    given = ocp.reference(preview, v_x_dot=0.3).exogenous
    assert (given[:, 1] == 0.3).all()


def test_a_path_error_is_the_same_in_every_direction():
    """Turned and moved world, same plan."""
    x = np.array([0.1, 0.05, 2.0, 0.4, 0.1])
    ocp = MPC(
        CAR,
        solver="ipopt",
        horizon=10,
        Q=Weights(e_y=1.0, e_psi=1.0, e_x=0.1),
        S=Weights(delta=1.0),
        limits=Limits(delta=0.5),
    )
    preview = double_lane_change(15.0).ahead(40.0, 10, 0.05)
    plans = []
    for turn, X0, Y0 in ((0.0, 0.0, 0.0), (2.0, 30.0, -40.0), (-3.0, 1.0, 5.0)):
        c, s = np.cos(turn), np.sin(turn)
        moved = replace(
            preview, X=X0 + c * preview.X - s * preview.Y, Y=Y0 + s * preview.X + c * preview.Y, psi=preview.psi + turn
        )
        state = np.array([*x[:2], X0 + c * x[2] - s * x[3], Y0 + s * x[2] + c * x[3], x[4] + turn])
        plans.append(ocp.plan(state, moved).u)
    assert plans[1] == pytest.approx(plans[0], abs=1e-6)
    assert plans[2] == pytest.approx(plans[0], abs=1e-6)


def test_a_full_turn_of_the_heading_changes_nothing():
    preview = double_lane_change(15.0).ahead(40.0, 15, 0.05)
    x = np.array([0.0, 0.0, 10.0, 0.2, 0.0])
    turned = x + np.array([0, 0, 0, 0, 6 * np.pi])
    assert car().plan(turned, preview).u == pytest.approx(car().plan(x, preview).u, abs=1e-7)


def ocp(**options):
    settings = {"horizon": 5, "Q": Weights(Y=1.0), "S": Weights(delta=1.0)} | options
    return OCP(CAR, **settings)


def test_a_term_with_nothing_to_do_is_said():
    with pytest.warns(ModelWarning, match="'t' is neither limited nor has a weight"):
        ocp(terms={"t": lambda x, u, p: x[1]})


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"horizon": 0}, "horizon"),
        ({"horizon": 2.5}, "horizon"),
        ({"Q": Weights(y=1.0)}, "'Y'"),
        ({"Q": Weights()}, "nothing is tracked"),
        ({"S": Weights()}, "no input is decided"),
        ({"S": Weights(Delta=1.0)}, "'delta'|no input"),
        ({"terminal": Weights(yaw=1.0)}, "terminal"),
        ({"controls": ("steer",)}, "controls"),
        ({"controls": ("delta", "delta")}, "repeat"),
        ({"controls": ("v_x",)}, "decided"),
        ({"limits": Limits(alpha=1.0)}, "limits"),
        ({"rates": Limits(r=1.0)}, "rates"),
        ({"rates": Limits(delta=(0.1, 0.2))}, "contains 0"),
        ({"slack": Weights(r=1.0)}, "slack"),
        ({"slack": Weights(delta=1.0), "limits": Limits(delta=1.0)}, "slack"),
        ({"slack_linear": Weights(r=1.0)}, "slack_linear"),
        ({"corridor": 0.0}, "corridor"),
        ({"terms": {"t": 3.0}}, "'t' fails on symbols.*TypeError"),
        ({"terms": {"t": lambda x, u: x[0]}}, "'t' fails on symbols.*3 were given.*see line"),
        ({"terms": {"t": lambda x, u, p: [x[0], x[1]]}}, "'t' gives .*expected a function .* that gives one number"),
        ({"terms": {"t": lambda x, u, p: None}}, "'t' gives None"),
        ({"terms": {"t": lambda x, u, p: p.mas}}, "'t' fails on symbols.*'mas'"),
        ({"terms": {"t": lambda x, u, p: math.sin(x[0])}}, "'t' gives nan"),
        ({"terms": {"t": lambda x, u, p: x[1] * math.sin(x[0])}}, "on symbols and .* on numbers.*ops.sin"),
        ({"Q": {}, "terminal": "lqr", "limits": Limits(r=1.0)}, "no weights in Q"),
    ],
)
def test_bad_problems_say_what_to_do(options, what):
    with pytest.raises(ParameterError, match=what):
        ocp(**options)


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("solver", ["ipopt", "realtime"])
def test_least_effort_from_rest_to_rest_tracks_nothing(solver):
    """The inputs of least squares that lead there: the pseudo-inverse of what they do to the end."""
    mass, n = double_integrator(), 12
    mpc = MPC(
        mass, horizon=n, Q={}, R=Weights(a=1.0), terminal_limits=Limits(p=(1.0, 1.0), v=(0.0, 0.0)), solver=solver
    )
    plan = mpc.plan(np.zeros(2))
    push = (np.arange(n)[::-1] + 0.5) * mass.dt**2
    wanted = np.linalg.pinv(np.stack([push, np.full(n, mass.dt)])) @ [1.0, 0.0]
    assert plan.status.solved
    assert plan.u[:, 0] == pytest.approx(wanted, rel=1e-6)
    assert plan.cost == pytest.approx(wanted @ wanted, rel=1e-6)
    for said in ({"p": 1.0}, {"Q": {"nothing": 1.0}}):  # what counts for nothing cannot be wanted
        with pytest.raises(ParameterError, match="names"):
            mpc.plan(np.zeros(2), **said)


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("solver", ["realtime", "none"])
@pytest.mark.parametrize(("bound", "horizon"), [(0.3, 10), (0.3, 30), (0.05, 10)])
def test_two_inputs_that_do_the_same_need_no_weight(solver, bound, horizon, monkeypatch):
    """Both at their limits until nothing is left: the sum of squares by hand, of a Hessian of half its rank."""
    if solver == "none":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
    tank = Ode(f=lambda x, u, p: [u[0] + u[1]], states=("a",), inputs=("F", "G"), params={}, dt=0.05)
    mpc = MPC(tank, horizon=horizon, controls=("F", "G"), Q=Weights(a=1.0), limits=Limits(F=bound, G=bound))
    plan = mpc.plan(np.array([0.5]), a=0.0)
    left = np.maximum(0.5 - 2 * bound * 0.05 * np.arange(horizon + 1), 0.0)
    assert plan.status.solved
    assert plan.cost == pytest.approx(left @ left, rel=1e-8)
    assert plan.x[:, 0] == pytest.approx(left, abs=1e-5)


@pytest.mark.filterwarnings("ignore:no C compiler")
@pytest.mark.parametrize("solver", ["ipopt", "realtime"])
@pytest.mark.parametrize(("other", "known"), [(0.25, True), (0.3, False)])
def test_an_end_that_is_asked_for_twice_is_asked_for_once(solver, other, known):
    """A state and an output of half its size: the same equation, or one that contradicts it."""
    cart = Ode(
        f=lambda x, u, p: [x[1], u[0]],
        states=("a", "b"),
        inputs=("F",),
        outputs=("half",),
        more=lambda x, u, p: {"half": 0.5 * x[0]},
        params={},
        dt=0.05,
    )
    once = MPC(
        cart, horizon=20, Q=Weights(a=1.0), R=Weights(F=1e-3), terminal_limits=Limits(a=(0.5, 0.5)), solver=solver
    )
    twice = MPC(ocp=once.ocp, terminal_limits=Limits(a=(0.5, 0.5), half=(other, other)), solver=solver)
    plan, wanted = twice.plan(np.array([1.0, 0.0]), a=0.0), once.plan(np.array([1.0, 0.0]), a=0.0)
    assert plan.status is (wanted.status if known else Status.INFEASIBLE)
    if known:
        assert plan.u == pytest.approx(wanted.u, abs=1e-6)


@pytest.mark.filterwarnings("ignore:no C compiler")
def test_a_slow_process_wants_longer_steps():
    """A tank over a day, minute by minute: its equation has an exact solution, which four steps a minute keep."""

    def rate(x, u, p):
        return [(u[0] - x[0]) / 600.0]

    slow = Ode(f=rate, states=("level",), inputs=("flow",), params={}, dt=60.0)
    posed = {"horizon": 10, "Q": {"level": 1.0}, "R": {"flow": 1e-3}, "limits": {"flow": 5.0}}
    with pytest.raises(ParameterError, match=r"takes 6000 explicit steps.*expected at most 400"):
        OCP(slow, **posed)
    plan = MPC(replace(slow, substeps=4), **posed).plan(np.array([2.0]), level=1.0)
    level, kept = 2.0, np.exp(-60.0 / 600.0)
    for flow, predicted in zip(plan.u[:, 0], plan.x[1:, 0], strict=True):
        level = kept * level + (1 - kept) * flow
        assert predicted == pytest.approx(level, abs=1e-8)


def test_corridor_needs_a_pose():
    with pytest.raises(ParameterError, match="OnGround"):
        OCP(double_integrator(), horizon=3, Q=Weights(p=1.0), R=Weights(a=1.0), corridor=1.8)


def test_wrong_shapes_are_named():
    mpc = car()
    preview = double_lane_change(15.0).ahead(40.0, 15, 0.05)
    good = mpc.reference(preview)
    for key, bad in (
        ("tracked", np.zeros((15, 2))),
        ("exogenous", np.zeros((15, 2))),
        ("inputs", np.zeros((16, 1))),
        ("corridor", np.zeros((15, 2))),
    ):
        with pytest.raises(ParameterError, match=key):
            mpc.plan(np.zeros(5), replace(good, **{key: bad}))
    with pytest.raises(ParameterError, match="x has 4"):
        mpc.plan(np.zeros(4), good)
    with pytest.raises(ParameterError, match="applied"):
        mpc.plan(np.zeros(5), good, applied=np.zeros(2))
    kept = car(corridor=1.8)
    without = replace(kept.reference(preview), corridor=None)
    with pytest.raises(ParameterError, match="corridor"):
        kept.plan(np.zeros(5), without)


def test_records_are_frozen_and_check_their_numbers():
    with pytest.raises(FrozenInstanceError):
        BASE.horizon = 3
    assert Weights(a=1) == Weights(a=1.0)
    assert hash(Weights(a=1.0, b=2.0)) == hash(Weights(b=2.0, a=1.0))
    assert hash(Limits(a=1.0)) == hash(Limits(a=(-1.0, 1.0)))
    assert repr(Limits(a=1.0)) == "Limits(a=(-1.0, 1.0))"
    for bad in (-1.0, np.nan, np.inf):
        with pytest.raises(ParameterError):
            Weights(a=bad)
    with pytest.raises(ParameterError):
        Values(a=np.nan)
    for bad in (-1.0, (1.0, 0.0), (0.0, np.nan), (1.0, 2.0, 3.0)):
        with pytest.raises(ParameterError):
            Limits(a=bad)
    assert nearest("y", ["Y"]) == "nearest are 'Y'"


def turntable(name, **settings):
    model = Ode(f=lambda x, u, p: [x[1], u[0]], states=(name, "w"), inputs=("a",), params={}, dt=0.1)
    usual = {"horizon": 30, "controls": ("a",), "Q": {name: 3.0}, "R": Weights(a=0.1), "limits": Limits(a=20.0)}
    return MPC(model, **(usual | settings))


@pytest.mark.parametrize("name", ["psi", "e_y", "e_psi", "x", "self", "X"])
def test_names_of_a_model_of_ones_own_mean_nothing_but_what_it_says(name):
    """A full turn is one where there is no pose; path errors and arguments of plan() are states as others are."""
    plans = [turntable(n).plan(np.zeros(2), **{n: 2 * np.pi}) for n in (name, "angle")]
    assert plans[0].cost == pytest.approx(plans[1].cost, rel=1e-12)
    assert plans[0].x[-1, 0] > 6.0


def test_words_of_a_plan_are_no_names_of_what_is_tracked():
    with pytest.raises(ParameterError, match="'applied' is tracked, which is a word of plan"):
        turntable("applied")


@pytest.mark.parametrize("solver", ["realtime", "ipopt"])
@pytest.mark.parametrize("slack", ["slack", "slack_linear"])
def test_a_soft_limit_along_the_way_leaves_the_end_hard(solver, slack):
    more = {"limits": Limits(a=6.0, w=1.0), slack: Weights(w=2.0), "terminal_limits": Limits(w=(0.0, 0.0))}
    mpc = turntable("angle", solver=RealTime(iterations=0) if solver == "realtime" else solver, **more)
    plan = mpc.plan(np.zeros(2), angle=4.0)
    assert plan.status.solved
    assert plan.x[:, 1].max() > 1.3
    assert plan.x[-1, 1] == pytest.approx(0.0, abs=1e-7)
    narrow = mpc.plan(np.zeros(2), angle=4.0, limits={"w": (-9.0, 9.0)})
    assert narrow.x[:, 1].max() > plan.x[:, 1].max() + 0.1
    assert narrow.x[-1, 1] == pytest.approx(0.0, abs=1e-7)


def test_an_end_alone_is_soft_where_a_slack_names_it():
    plan = turntable("angle", slack=Weights(w=0.1), terminal_limits=Limits(w=(0.0, 0.0))).plan(np.zeros(2), angle=9.0)
    assert abs(plan.x[-1, 1]) > 1e-3
