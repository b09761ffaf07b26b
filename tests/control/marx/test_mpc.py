"""MARX-MPC: the blend, the quadratic program against Ipopt and NumPy, and what happens outside its world."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.marx.interpreted import Interpreted
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.marx.solver import Compiled
from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.multi_arx import MultiARXModel, ParallelARX, speed_weights
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Values, Weights
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant

needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())
SPEEDS = (10.0, 15.0, 20.0)
LIMIT = float(np.deg2rad(20))


def lateral(gain, na=2):
    A = [-2.0, 1.0] if na == 2 else [-1.8, 0.6, 0.2]
    return ARXModel(A=A, B=[0.6 * gain, 0.4 * gain], dt=0.05, inputs=("delta",), outputs=("Y",))


def planar(gain, outputs=("v_y", "r")):
    A = np.array([[[-0.6, 0.1], [0.05, -0.7]], [[0.1, 0.0], [0.0, 0.1]]])
    B = gain * np.array([[[0.3], [0.5]], [[0.2], [0.1]], [[0.05], [0.1]]])
    if outputs == ("r", "v_y"):
        A, B = A[:, ::-1, ::-1], B[:, ::-1]
    return ARXModel(A=A, B=B, c=[0.01, -0.02], dt=0.05, inputs=("delta",), outputs=outputs)


def bicycle_arx(v_x):
    """The linear bicycle at one speed is an ARX model of one lag."""
    model = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))
    A = np.column_stack([model.step(e, np.array([0.0, v_x])) for e in np.eye(2)])
    B = model.step(np.zeros(2), np.array([1.0, v_x]))
    return ARXModel(A=-A[None], B=B[None, :, None], dt=0.05, inputs=("delta",), outputs=("v_y", "r"))


Y_MODEL = MultiARXModel(models=(lateral(0.08), lateral(0.17, na=3), lateral(0.28)), speeds=SPEEDS)
GROUND = OnGround(MultiARXModel(models=tuple(planar(k) for k in (1.0, 1.5, 1.7)), speeds=SPEEDS, shape="smooth"))
SETTINGS = {"horizon": 10, "S": Weights(delta=100.0), "limits": Limits(delta=LIMIT)}
BY_Y = MultiARXMPC(Y_MODEL, Q=Weights(Y=100.0), terminal=Weights(Y=300.0), rates=Limits(delta=1.0), **SETTINGS)
BY_POSE = MultiARXMPC(GROUND, Q=Weights(e_y=100.0, e_psi=20.0), R=Weights(delta=3.0), **SETTINGS)
BOTH = pytest.mark.parametrize("mpc", [BY_Y, BY_POSE], ids=["Y", "on the ground"])
KNOTS = (0, 1, 3, 7)


def situation(mpc, seed, spread=1.0):
    """State, reference and last input of a random moment."""
    rng = np.random.default_rng(seed)
    n, v = mpc.horizon, rng.uniform(7.0, 23.0)
    side = spread * np.cumsum(rng.normal(0, 0.3, n + 1))
    speeds = v + rng.uniform(-5, 5) * mpc.dt * np.arange(n)
    applied = np.array([rng.uniform(-LIMIT, LIMIT)])
    if mpc is BY_Y:
        x = np.array([0.3, 0.2, 0.15, 0.02]) * rng.standard_normal(4)
        tracked = np.column_stack([np.zeros(n + 1), side, np.zeros(n + 1)])
    else:
        x = 0.2 * rng.standard_normal(mpc.model.n_states)
        x[-1] = rng.uniform(-3, 3)
        along, c, s = v * mpc.dt * np.arange(n + 1), np.cos(x[-1]), np.sin(x[-1])
        turned = x[-1] + np.cumsum(rng.normal(0, 0.03, n + 1)) + 2 * np.pi * rng.integers(-2, 3)
        tracked = np.column_stack([x[-3] + c * along - s * side, x[-2] + s * along + c * side, turned])
    return x, Reference(tracked=tracked, exogenous=speeds[:, None]), applied


# ---- weights and models ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["triangular", "smooth"])
def test_weights_sum_to_one_and_belong_to_neighbours(shape):
    v = np.linspace(-5.0, 40.0, 901)
    w = np.array(speed_weights(v, (10.0, 14.0, 20.0, 21.0), shape))
    assert w.sum(axis=0) == pytest.approx(np.ones(901), abs=1e-15)
    assert w.min() >= 0.0
    assert (w > 0).sum(axis=0).max() == 2
    assert w[:, v <= 10.0] == pytest.approx(np.eye(4)[:, :1] * np.ones((v <= 10.0).sum()))
    assert w[:, v >= 21.0] == pytest.approx(np.eye(4)[:, 3:] * np.ones((v >= 21.0).sum()))
    assert np.array(speed_weights(12.0, (10.0, 14.0), shape)) == pytest.approx([0.5, 0.5])
    slope = np.diff(w, axis=1) / 0.05
    if shape == "smooth":
        assert np.abs(np.diff(slope, axis=1)).max() < 0.6  # no corner
    assert speed_weights(3.0, (15.0,)) == [1.0]


def test_at_a_models_speed_the_blend_is_that_model():
    rng = np.random.default_rng(0)
    x, one = rng.standard_normal(Y_MODEL.n_states), Y_MODEL.models[1]
    assert Y_MODEL.step(x, np.array([0.1, 15.0])) == pytest.approx(one.step(x, np.array([0.1])))
    side = ParallelARX(models=Y_MODEL.models, speeds=SPEEDS)
    start = np.concatenate([x[:3]] * 3 + [x[3:]])
    for v in (10.0, 13.0, 25.0):  # one step of the blend and of the models side by side are the same
        after = side.step(start, np.array([0.1, v]))
        assert side.output(after, np.array([0.0, v])) == pytest.approx(Y_MODEL.step(x, np.array([0.1, v]))[:1])


def test_models_side_by_side_keep_to_themselves():
    """Eq. 7-3: each model runs on its own predictions, unlike a blend of coefficients."""
    side = ParallelARX(models=Y_MODEL.models, speeds=SPEEDS)
    x, alone = np.zeros(side.n_states), [np.zeros(m.n_states) for m in side.models]
    rng = np.random.default_rng(1)
    for _ in range(30):
        u, v = rng.normal(0, 0.1), rng.uniform(8, 22)
        y = sum(w * a[0] for w, a in zip(side.weights(v), alone, strict=True))
        assert side.output(x, np.array([u, v])) == pytest.approx([y])
        x = side.step(x, np.array([u, v]))
        alone = [m.step(a, np.array([u])) for m, a in zip(side.models, alone, strict=True)]
        symbolic = np.asarray(side.functions[0](x, np.array([u, v]))).ravel()
        assert symbolic == pytest.approx(side.step(x, np.array([u, v])), rel=1e-12, abs=1e-12)
    assert side.correct(x, np.zeros(2), np.array([7.0]))[[0, 3, 6]].tolist() == [7.0] * 3


# ---- the quadratic program -------------------------------------------------------------------------------------------


@needs_compiler
@BOTH
def test_compiled_equals_numpy(mpc):
    assert isinstance(mpc.solver, Compiled)
    other = Interpreted(mpc.problem, mpc.numbers)
    most = 0
    for seed in range(60):
        x, reference, applied = situation(mpc, seed, 1.0 + 2.0 * (seed % 3))
        plan = mpc.plan(x, reference, applied=applied)
        found = other.solve(x, reference.tracked, reference.exogenous, float(applied[0]), None, 0.0)
        assert plan.status is found.status is Status.SOLVED
        assert plan.u == pytest.approx(found.u, abs=1e-7)
        assert plan.x == pytest.approx(found.x, abs=1e-6)
        assert plan.cost == pytest.approx(found.cost, rel=1e-8)
        assert plan.weights == pytest.approx(mpc.blended.weights(reference.exogenous[0, 0]))
        most = max(most, plan.iterations)
    assert most >= 5  # limits were active


def test_the_plan_is_ipopts_on_the_thesis_cost():
    """Models side by side as a Model in the general problem (constant speed: its weights are those of each step)."""
    side = ParallelARX(models=Y_MODEL.models, speeds=SPEEDS)
    general = MPC(
        side,
        Q=BY_Y.Q,
        terminal=BY_Y.terminal,
        rates=BY_Y.rates,
        solver=Ipopt(tolerance=1e-10),
        controls=("delta",),
        **SETTINGS,
    )
    for seed in range(6):
        x, reference, applied = situation(BY_Y, seed)
        v = reference.exogenous[:1] * np.ones((10, 1))
        plan = BY_Y.plan(x, replace(reference, exogenous=v), applied=applied)
        wide = np.concatenate([x[:3]] * 3 + [x[3:]])
        other = general.plan(wide, Reference(tracked=reference.tracked[:, 1:2], exogenous=v), applied=applied)
        assert plan.u == pytest.approx(other.u, abs=1e-6)
        assert plan.cost == pytest.approx(other.cost, rel=1e-6)
        assert plan.x[:, 0] == pytest.approx(
            [float(side.output(s, np.array([0.0, v[0, 0]]))[0]) for s in other.x], abs=1e-6
        )


def test_on_the_ground_it_is_the_general_controller_near_the_path():
    """The linear bicycle as ARX: the same command as the nonlinear program, up to the angles' squares."""
    model = OnGround(MultiARXModel(models=(bicycle_arx(15.0),), speeds=(15.0,)))
    ours = MultiARXMPC(model, Q=Weights(e_y=100.0, e_psi=50.0), **SETTINGS)
    general = MPC(
        OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))),
        Q=ours.Q,
        solver="realtime",
        **SETTINGS,
    )
    angle = np.linspace(0, 1.5, 200)
    path = Path.from_points(80 * np.sin(angle), 80 * (1 - np.cos(angle))).with_speed(15.0)
    for s, side in ((20.0, 0.05), (40.0, -0.1), (60.0, 0.2)):
        at = path.at(s)
        psi = float(at.psi[0]) + 0.02
        X, Y = float(at.X[0] - side * np.sin(psi)), float(at.Y[0] + side * np.cos(psi))
        x, look = np.array([0.05, 0.15, X, Y, psi]), path.ahead(s, 10, 0.05)
        a = ours.plan(x, look)
        b = general.plan(x, look)
        assert a.u == pytest.approx(b.u, abs=0.03 * np.abs(b.u).max())
        assert a.x[:, 2:] == pytest.approx(b.x[:, 2:], abs=0.02)


@BOTH
def test_between_knots_the_input_runs_straight_and_the_plan_is_the_best_of_those(mpc):
    """The cost is quadratic about the full program's optimum, so its best restriction to the knots is a projection."""
    few, n = replace(mpc, knots=KNOTS, rates=Limits(), limits=Limits()), mpc.horizon
    free = replace(mpc, rates=Limits(), limits=Limits())
    shape = np.column_stack([np.interp(np.arange(n), KNOTS, one) for one in np.eye(len(KNOTS))])
    for seed in range(5):
        x, reference, applied = situation(mpc, seed)
        plan, full = few.plan(x, reference, applied=applied), free.plan(x, reference, applied=applied)
        assert plan.u[:, 0] == pytest.approx(shape @ plan.u[list(KNOTS), 0], abs=1e-12)
        assert plan.cost >= full.cost - 1e-9 * abs(full.cost)
        H = _hessian(Interpreted(free.problem, free.numbers), x, reference, applied)
        best = np.linalg.solve(shape.T @ H @ shape, shape.T @ H @ full.u[:, 0])
        assert plan.u[:, 0] == pytest.approx(shape @ best, abs=1e-8)


def _hessian(solver, x, reference, applied):
    """Half the second derivative of the cost by the inputs, as DAQP is given it but for its scale: half the trace."""
    import daqp

    caught, solve = [], daqp.solve

    def note(H, *rest):
        caught.append(H.copy())
        return solve(H, *rest)

    daqp.solve = note
    try:
        solver.solve(x, reference.tracked, reference.exogenous, float(applied[0]), None, 0.0)
    finally:
        daqp.solve = solve
    return caught[0]


@BOTH
@needs_compiler
def test_with_knots_compiled_and_numpy_agree(mpc):
    for knots in (KNOTS, (0,), (0, 9), (0, 2, 4, 6, 8)):
        few = replace(mpc, knots=knots, rates=Limits(delta=1.0))
        for seed in range(4):
            x, reference, applied = situation(mpc, seed, 2.0)
            asked = x, reference.tracked, reference.exogenous, float(applied[0]), None, 0.0
            fast, slow = few.solver.solve(*asked), Interpreted(few.problem, few.numbers).solve(*asked)
            assert fast.status is slow.status
            assert fast.u == pytest.approx(slow.u, abs=1e-8)
            assert fast.x == pytest.approx(slow.x, abs=1e-8)
            assert fast.cost == pytest.approx(slow.cost, rel=1e-8)


@pytest.mark.parametrize("knots", [(), (1, 2), (0, 0), (0, 3, 2), (0, 10), (0, 1.5), (0, -1)])
def test_knots_that_are_none_are_refused(knots):
    with pytest.raises(ParameterError, match=r"knots is .*expected growing whole numbers from 0 to at most 9"):
        replace(BY_Y, knots=knots)


@BOTH
def test_limits_and_rates_are_kept(mpc):
    tight = replace(mpc, limits=Limits(delta=(-0.1, 0.05)), rates=Limits(delta=0.6))
    tights = tight, replace(tight, knots=KNOTS)
    for seed in range(60):
        tight = tights[seed % 2]
        x, reference, _ = situation(mpc, seed, 5.0)
        applied = np.array([(-0.1, 0.05, 0.0)[seed % 3]])
        u = tight.plan(x, reference, applied=applied).u[:, 0]
        assert u.min() >= -0.1 - 1e-12
        assert u.max() <= 0.05 + 1e-12
        assert np.abs(np.diff(u, prepend=applied)).max() <= 0.6 * 0.05 + 1e-12


def test_order_of_outputs_does_not_matter():
    models = tuple(planar(k, ("r", "v_y")) for k in (1.0, 1.5, 1.7))
    turned = [replace(m, c=np.array([-0.02, 0.01])) for m in models]
    other = replace(BY_POSE, model=OnGround(MultiARXModel(models=tuple(turned), speeds=SPEEDS, shape="smooth")))
    x, reference, applied = situation(BY_POSE, 3)
    swapped = x.copy()
    swapped[[0, 1, 2, 3]] = x[[1, 0, 3, 2]]
    assert other.plan(swapped, reference, applied=applied).u == pytest.approx(
        BY_POSE.plan(x, reference, applied=applied).u, abs=1e-9
    )


@BOTH
def test_without_a_compiler_it_plans_the_same(mpc, monkeypatch):
    x, reference, applied = situation(mpc, 5)
    expected = mpc.plan(x, reference, applied=applied)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    slow = replace(mpc)
    assert isinstance(slow.solver, Interpreted)
    assert slow.plan(x, reference, applied=applied).u == pytest.approx(expected.u, abs=1e-7)


# ---- outside its world -----------------------------------------------------------------------------------------------


@BOTH
@pytest.mark.parametrize("hole", ["x", "path", "speed", "applied"])
def test_never_nan(mpc, hole):
    x, reference, applied = situation(mpc, 1)
    good = mpc.plan(x, reference, applied=applied)
    if hole == "x":
        x = x * np.nan
    elif hole == "path":
        reference = replace(reference, tracked=reference.tracked + np.inf)
    elif hole == "speed":
        reference = replace(reference, exogenous=reference.exogenous * np.nan)
    else:
        applied = np.array([np.nan])
    plan = good
    for k in range(1, 9):
        plan = mpc.plan(x, reference, plan, applied=applied if hole == "applied" else None)
        assert np.isfinite(plan.u).all()
        assert np.abs(plan.u).max() <= LIMIT
        if hole == "applied":
            assert plan.age == 0
            assert plan.detail.startswith("applied is nan for 'delta', which no input can be")
            continue
        assert plan.status is Status.NOT_FINITE
        assert (plan.age, plan.stopping) == (k, k > 5)
        if k <= 5:
            assert plan.command[0] == good.u[k, 0]
        else:
            assert abs(plan.command[0]) < abs(good.u[5, 0]) + 1e-12
    again = mpc.plan(*situation(mpc, 1)[:2], plan)
    assert again.status is Status.SOLVED


@BOTH
def test_outside_the_range_the_nearest_model_plans_and_says_so(mpc):
    x, reference, applied = situation(mpc, 2)
    for v, nearest in ((4.0, 0), (33.0, 2)):
        plan = mpc.plan(x, replace(reference, exogenous=np.full((10, 1), v)), applied=applied)
        assert plan.outside
        assert "outside" in plan.message
        assert plan.weights.tolist() == np.eye(3)[nearest].tolist()
        assert plan.status is Status.SOLVED
    inside = mpc.plan(x, replace(reference, exogenous=np.full((10, 1), 12.0)), applied=applied)
    assert not inside.outside
    assert "outside" not in inside.message


@BOTH
@pytest.mark.parametrize("v_x", [0.0, 0.5, -3.0])
def test_standing_and_reversing_the_wheels_stay(mpc, v_x):
    x, reference, _ = situation(mpc, 2)
    plan = mpc.plan(x, replace(reference, exogenous=np.full((10, 1), v_x)), applied=np.array([0.07]))
    assert (plan.u == 0.07).all()
    assert plan.status is Status.FAILED
    assert plan.age == 1
    assert not plan.stopping
    assert plan.outside
    assert "standing" in plan.message
    assert np.isfinite(plan.x).all()


def test_start_is_a_straight_past():
    seen = {"Y": 3.0, "psi": 0.1, "v_x": 12.0, "delta": 0.02}
    x = BY_Y.start(seen)
    assert x == pytest.approx([3.0, 3.0 - 0.6 * np.sin(0.1), 3.0 - 1.2 * np.sin(0.1), 0.02])
    on_ground = BY_POSE.start({"X": 1.0, "Y": 2.0, "psi": 0.1, "r": 0.2, "v_y": 0.3})
    assert on_ground.tolist() == [0.3, 0.2, 0.3, 0.2, 0.0, 0.0, 1.0, 2.0, 0.1]
    assert len(x) == BY_Y.model.n_states


@pytest.mark.parametrize("speed", [12.0, 16.0, 20.0])
def test_it_drives_a_path(speed):
    """The linear bicycle blended from three speeds, on a plant that is that bicycle."""
    model = OnGround(MultiARXModel(models=tuple(bicycle_arx(v) for v in SPEEDS), speeds=SPEEDS))
    mpc = MultiARXMPC(model, Q=Weights(e_y=100.0), **{**SETTINGS, "S": Weights(delta=1000.0)})
    angle = np.linspace(0, 1.2, 300)
    path = Path.from_points(100 * np.sin(angle), 100 * (1 - np.cos(angle))).with_speed(speed)
    plant = Plant(OnGround(Bicycle(params=SOUSA_TABLE_7_2, dt=0.01, outputs=("v_y", "r"))))
    run = closed_loop(plant, mpc, path, duration=5.0)
    assert run.max("y") < 0.05
    assert all(p.status is Status.SOLVED for p in run.plans)
    noisy = Plant(plant.model, noise=Values(r=0.01, v_y=0.02, X=0.01, Y=0.01, psi=0.003))
    assert closed_loop(noisy, mpc, path, duration=5.0).max("y") < 0.2


def test_bad_settings_say_what_to_do():
    with pytest.raises(ParameterError, match="horizon"):
        replace(BY_Y, horizon=0)
    with pytest.raises(ParameterError, match="e_y"):
        replace(BY_Y, Q=Weights(e_y=1.0))
    with pytest.raises(ParameterError, match="no weight"):
        replace(BY_Y, S=Weights())
    with pytest.raises(ParameterError, match="blend"):
        replace(BY_Y, model=lateral(0.1))
    with pytest.raises(ParameterError, match="v_y and r"):
        replace(BY_Y, model=GROUND.model)
    with pytest.raises(ParameterError, match="contains 0"):
        replace(BY_Y, rates=Limits(delta=(0.1, 0.2)))
    with pytest.raises(ParameterError, match="rows"):
        BY_Y.reference(Path.from_points([0, 1, 2, 3], [0, 0, 0, 0]).with_speed(1.0).ahead(0.0, 3, 0.05))
    with pytest.raises(ParameterError, match="entries"):
        BY_Y.plan(np.zeros(3), situation(BY_Y, 0)[1])
    with pytest.raises(ParameterError, match="rising"):
        MultiARXModel(models=Y_MODEL.models, speeds=(10.0, 20.0, 15.0))
    with pytest.raises(ParameterError, match="one for each"):
        MultiARXModel(models=Y_MODEL.models, speeds=(10.0, 20.0))
    with pytest.raises(ParameterError, match="alike"):
        MultiARXModel(models=(lateral(0.1), planar(0.1)), speeds=(10.0, 20.0))
