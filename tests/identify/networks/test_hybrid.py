"""Hybrids and joint models: they find what is missing, switch off where they do not help, adapt to a session."""

import warnings
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from slipangle.codegen import compiler as compiled
from slipangle.control.mpc import MPC
from slipangle.data.dataset import Dataset
from slipangle.errors import MissingColumnError, ModelWarning, ParameterError, TooShortError
from slipangle.identify.adapt import Adapt
from slipangle.identify.judge.validate import score
from slipangle.identify.networks.hybrid import Hybrid
from slipangle.identify.networks.joint import Joint
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.problem import Stage
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.models.vehicles import neural_bicycle, neural_bicycle_code
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.models.vehicles.neural_bicycle import NeuralBicycle, TireNetworkBicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.wrappers.ensemble import EnsembleModel
from slipangle.models.wrappers.hybrid import HybridModel
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.solution import Status
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.lane_change import double_lane_change
from tests.models.all_models import discrepancy
from tests.models.all_models import neural_bicycle as example

PARAMS = NonlinearBicycleParams(
    mass=982.0, inertia_z=900.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=9e4, steering_lag=0.05
)
SMALL = NARX(
    na=2, nb=2, hidden=(8,), activation="tanh", holdout=0.2, stages=(Stage(horizon=1, epochs=60, learning_rate=3e-3),)
)


def drive(n=1200, dt=0.05, seed=0):
    """Smooth steering and speed, inputs of the bicycle at the limit."""
    rng = np.random.default_rng(seed)
    kernel = np.hanning(31) / np.hanning(31).sum()
    delta = 0.1 * np.convolve(rng.standard_normal(n + 30), kernel, "valid")
    v_x = 25 + 8 * np.convolve(rng.standard_normal(n + 30), kernel, "valid").cumsum() * dt
    v_x = np.clip(v_x, 12, 40)
    return Dataset.from_arrays(
        {"delta": delta, "v_x": v_x, "v_x_dot": np.gradient(v_x, dt)}, {"r": np.zeros(n)}, dt, name=f"drive {seed}"
    )


def made_by(model, data):
    return data.with_channel("r", model.simulate(data).channel("r"), "rad/s")


def linear_plant():
    return ARXModel(A=[-1.4, 0.6], B=[0.5, 0.3], dt=0.05, inputs=("delta",), outputs=("r",))


# ---- discrepancy ---------------------------------------------------------------------------------------------------


def nonlinear_response(n=1500, seed=0):
    """An ARX model's output plus a static, squared, lagged effect of the input."""
    data = drive(n, seed=seed).select(inputs=("delta",))
    y = linear_plant().simulate(data).y[:, 0]
    extra = np.zeros(n)
    for k in range(1, n):
        extra[k] = 0.8 * extra[k - 1] + 50.0 * data["delta"][k - 1] ** 2
    return data.with_channel("r", y + extra, "rad/s")


@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")  # they are faster or steer less
def test_discrepancy_explains_what_the_base_leaves():
    train, test = nonlinear_response().split(0.7)
    settings = FreeRunNARX(start=SMALL, max_iterations=60)
    model = Hybrid(base=linear_plant(), discrepancy=settings).fit(train)
    assert model.gain == 1
    before, after = (score(m.simulate(test), "r").rmse for m in (model.base, model))
    assert after < 0.5 * before
    added = model.contribution(test)[:, 0]
    left = test["r"] - model.base.simulate(test).y[:, 0]
    assert np.corrcoef(added[20:], left[20:])[0, 1] > 0.85
    share = model.share(test)[:, 0]
    assert np.isnan(share[: model.memory]).all()
    base = np.abs(model.base.simulate(test).y[:, 0])
    k = model.memory + 50
    assert share[k] == pytest.approx(100 * abs(added[k]) / (abs(added[k]) + base[k]))


@pytest.mark.slow
def test_discrepancy_that_cannot_help_switches_itself_off():
    data = drive(900).select(inputs=("delta",))
    y = linear_plant().simulate(data).y[:, 0]
    noisy = data.with_channel("r", y + 0.02 * np.random.default_rng(5).standard_normal(len(y)), "rad/s")
    model = Hybrid(base=linear_plant(), discrepancy=SMALL, folds=2).fit(noisy)
    assert model.gain == 0
    assert "the discrepancy is off" in model.fit_info.warnings[-1]
    assert model.simulate(noisy).y == pytest.approx(model.base.simulate(noisy).y, abs=1e-12)


@pytest.mark.slow
def test_discrepancy_that_fails_on_manoeuvres_unlike_the_others_switches_itself_off():
    """What is left has the other sign in one fast part early on: the last quarter alone would have believed it."""
    data = drive(1600).select(inputs=("delta",))
    fast = (np.arange(1600) >= 400) & (np.arange(1600) < 800)
    data, extra = data.with_channel("v_x", np.where(fast, 38.0, 15.0), "m/s"), np.zeros(1600)
    for k in range(1, 1600):
        extra[k] = 0.8 * extra[k - 1] + (-0.4 if fast[k] else 0.4) * data["delta"][k - 1]
    data = data.with_channel("r", linear_plant().simulate(data).y[:, 0] + extra, "rad/s")
    network, left = replace(SMALL, linear_start=False), data.with_channel("r", extra, "rad/s")
    late = left.rows(1200, 1600)
    with warnings.catch_warnings():  # of a network that is not better than its start on one of the parts
        warnings.filterwarnings("ignore", "seed 0: ", ModelWarning)
        model = Hybrid(base=linear_plant(), discrepancy=network, inputs=("delta",)).fit(data)
        by_the_last = network.fit(left.rows(0, 1200)).simulate(late).y[:, 0]
    assert model.gain == 0
    assert "on manoeuvres unlike those it was trained on it changed the RMSE by +" in model.fit_info.warnings[-1]
    assert np.std(late["r"] - by_the_last) < 0.9 * np.std(late["r"])


@pytest.fixture(scope="module")
def trusted():
    """A hybrid whose discrepancy was not checked, with its data and base model."""
    data, base = nonlinear_response(400), linear_plant()
    return Hybrid(base=base, discrepancy=replace(SMALL, linear_start=False), folds=0).fit(data), data, base


def test_hybrid_keeps_the_base_model_and_says_how_it_was_fitted(trusted):
    model, data, base = trusted
    assert isinstance(model, HybridModel)
    assert model.base is base
    assert model.fit_info.method.startswith("discrepancy of ARXModel")
    assert model.fit_info.train_name == data.name


@pytest.mark.parametrize("kwargs", [{"folds": -1}, {"worth": 1.0}])
def test_settings_out_of_range(kwargs):
    with pytest.raises(ParameterError, match=next(iter(kwargs))):
        Hybrid(base=linear_plant(), **kwargs)


def test_gain_and_outputs_are_checked(trusted):
    good, *_ = trusted
    with pytest.raises(ParameterError, match=r"gain is 1\.5"):
        replace(good, gain=1.5)
    with pytest.raises(ParameterError, match="same, in the same order"):
        replace(good, discrepancy=replace(good.discrepancy, outputs=("v_y",)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")  # they steer less
def test_free_run_steps_lower_the_free_run_error():
    train, test = nonlinear_response().split(0.7)
    start = replace(SMALL, linear_start=False)  # the curve is then that of the training error
    adam, newton = start.fit(train), FreeRunNARX(start=start, max_iterations=15).fit(train)
    before, after = (score(m.simulate(train), "r").rmse for m in (adam, newton))
    assert after < 0.5 * before
    assert score(newton.simulate(test), "r").fit > score(adam.simulate(test), "r").fit
    curve = newton.fit_info.trials[0].curve
    assert np.all(np.diff(curve[:, 1]) < 0)


# ---- physics and network together ----------------------------------------------------------------------------------


def plant(kind=NeuralBicycle):
    """The bicycle with forces, or tires, that the physics lacks."""
    n, _ = kind.network_outputs
    sizes = Scaling(offset=[0.0, 0.0, 0.0, 0.0, 25.0, 0.0], factor=[1.0, 0.3, 0.1, 0.1, 8.0, 4.0])
    network = MLP.random(
        (6, 5, n),
        activation="tanh",
        seed=7,
        input_scaling=sizes,
        output_scaling=Scaling(offset=[0.0] * n, factor=[1.0, 0.5] if n == 2 else [1.0] * n),
    )
    return kind(params=PARAMS, network=network, dt=0.05, substeps=2)


@pytest.fixture(scope="module")
def jointly():
    """Base model, two seeds of the joint model, unseen data."""
    train, test = made_by(plant(), drive(900, seed=1)), made_by(plant(), drive(900, seed=2))
    start = NonlinearBicycle(params=PARAMS, dt=0.05, substeps=2)
    how = {"free": ("C_f", "C_r", "inertia_z"), "hidden": (6,), "max_iterations": 12}
    joint = Joint(start=start, **how, seeds=(0, 1), folds=0)  # what judges them is asked in test_joint_judged.py
    return start, joint.fit_ensemble(train), test


@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")  # they are faster or steer less
def test_joint_finds_what_the_physics_lacks(jointly):
    start, ensemble, test = jointly
    before = score(start.simulate(test), "r").rmse
    for member in ensemble.members:
        assert score(member.simulate(test), "r").rmse < 0.5 * before
        assert member.fit_info.seconds > 0
    assert score(ensemble.simulate(test), "r").rmse < 0.4 * before
    assert len(ensemble.fit_info.trials) == 2
    assert ensemble.spread(test)[1:].max() > 0


@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")  # they are faster or steer less
def test_joint_never_sees_outputs_after_the_start(jointly):
    _, ensemble, test = jointly
    garbage = test["r"].copy()
    garbage[1:] = 1e3
    spoiled = test.with_channel("r", garbage)
    for model in (ensemble, *ensemble.members):
        assert np.array_equal(model.simulate(test).y[1:], model.simulate(spoiled).y[1:])


@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")  # they are faster or steer less
def test_joint_finds_its_way_back_from_states_thrown_off(jointly):
    """Two seconds after a start anywhere in the range of the training data, a run is where the undisturbed one is."""
    _, ensemble, test = jointly
    for member in ensemble.members:
        x0 = member.initial_state(test.head(1))
        assert 0 < member.most_r < 2 * np.abs(test["r"]).max()
        straight = member.simulate(test, start=[x0]).y
        for v_y, r in product((-1.0, 1.0), repeat=2):
            away = np.array([v_y * member.most_v_y, r * member.most_r, 0.0]) / 1.2
            assert member.simulate(test, start=[away]).y[40:] == pytest.approx(straight[40:], abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [NeuralBicycle, TireNetworkBicycle])
def test_the_compiled_derivative_is_that_of_the_model(kind):
    """Sensitivities of the free run in JAX against differences of the CasADi model."""
    from slipangle.identify.networks import adam
    from slipangle.identify.networks.unrolled import Unrolled

    model, data = plant(kind), drive(60, seed=3)
    free = ("C_f", "steering_offset", "bias_r")
    scale = np.array([6e4, 0.01, 0.01])
    with adam.precision("double"):
        unrolled = Unrolled(model, free, scale, np.array([1.0]))
        theta = unrolled.pack(model.network)
        runs = unrolled.derivatives(theta, model.initial_state(data.head(1))[None], data.u[None])
        y, jacobian = (np.asarray(a)[0] for a in runs)
    assert y[:, 0] == pytest.approx(model.simulate(data).y[1:, 0], abs=1e-12)
    x0 = model.initial_state(data)  # of the same numbers in both runs: the start state is not differentiated
    for i in (0, 1, 2, 10, 40, len(theta) - 1):
        step = np.zeros(len(theta))
        step[i] = 1e-5
        ends = [unrolled.unpack(theta + s * step, ("r",)).simulate(data, start=[x0]).y[1:, 0] for s in (1, -1)]
        offset = 1.0 if i == len(theta) - 1 else 0.0
        assert jacobian[:, 0, i] == pytest.approx((ends[0] - ends[1]) / 2e-5 + offset, rel=1e-4, abs=1e-7)


@pytest.mark.parametrize(
    ("kwargs", "word"),
    [
        ({"hidden": ()}, "hidden"),
        ({"weight_prior": 0.0}, "weight_prior is"),
        ({"also": ("X",)}, "'X'"),
        ({"restart": 0.0}, "restart"),
        ({"settle": -1.0}, "settle"),
        ({"thrown_off": -1.0}, "thrown_off"),
        ({"holdout": 0.9}, "holdout"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"corrects": "brakes"}, "corrects"),
        ({"free": ("C_x",)}, "C_x"),
    ],
)
def test_joint_settings_out_of_range(kwargs, word):
    with pytest.raises(ParameterError, match=word):
        Joint(start=NonlinearBicycle(params=PARAMS, dt=0.05), **kwargs)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")  # they brake in other bends
def test_tire_coefficients_from_a_network_stay_within_bounds_and_are_found():
    truth = plant(TireNetworkBicycle)
    wild = replace(truth, network=truth.network.with_parameters(1e3 * truth.network.parameters))
    u, x = np.array([0.05, 25.0, 0.0]), np.array([0.3, 0.2, 0.04])
    corners = np.array([axle_corner(c, f, x, u) for c in (0.7, 1.3) for f in product((0.7, 1.3), repeat=3)])
    assert np.all(corners.min(axis=0) - 1e-9 <= wild.derivative(x, u)[:2])
    assert np.all(wild.derivative(x, u)[:2] <= corners.max(axis=0) + 1e-9)
    train, test = made_by(truth, drive(700, seed=1)), made_by(truth, drive(700, seed=2))
    start = NonlinearBicycle(params=PARAMS, dt=0.05, substeps=2)
    joint = Joint(start=start, free=("C_f",), corrects="tires", hidden=(5,), max_iterations=10)
    model = joint.fit(train)
    assert isinstance(model, TireNetworkBicycle)
    assert score(model.simulate(test), "r").rmse < 0.5 * score(start.simulate(test), "r").rmse


def axle_corner(c_f, others, x, u):
    """Rates with every coefficient at an end of its bounds."""
    ends = dict(zip(("C_f", "C_r", "mu_f", "mu_r"), (c_f, *others), strict=True))
    params = PARAMS.with_values(**{n: k * getattr(PARAMS, n) for n, k in ends.items()})
    return NonlinearBicycle(params=params, dt=0.05).derivative(x, u)[:2]


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
@pytest.mark.parametrize("kind", [NeuralBicycle, TireNetworkBicycle])
def test_compiled_free_run_is_the_repeated_step(kind, monkeypatch):
    model, data = plant(kind), drive(300, seed=8)
    wild = data.with_channel("delta", np.where(np.arange(300) > 200, 3.0, data["delta"]), "rad")  # reaches the bounds
    model = replace(model, most_r=0.6)
    plain = model.simulate(wild).y
    called = []
    monkeypatch.setattr(neural_bicycle, "LONG", 100)
    monkeypatch.setattr(neural_bicycle_code, "run", spied(neural_bicycle_code.run, called))
    assert model.simulate(wild).y == pytest.approx(plain, abs=1e-12)
    assert called == [True]
    assert np.abs(plain).max() == pytest.approx(0.6 + abs(PARAMS.bias_r), abs=1e-6)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    assert np.array_equal(model.simulate(wild).y, plain)
    assert called == [True, False]


def spied(function, called):
    def run(*given):
        found = function(*given)
        called.append(found is not None)
        return found

    return run


def test_a_start_from_several_samples_finds_the_lateral_velocity_nobody_measured():
    model = NonlinearBicycle(params=PARAMS, dt=0.05, substeps=2)
    data = drive(200, seed=9)
    x = [np.array([1.5, 0.3, 0.05])]
    for k in range(1, 30):
        x.append(model.step(x[-1], data.u[k - 1]))
    r = np.array([state[1] for state in x])
    late = data.rows(0, 30).with_channel("r", r, "rad/s")
    guesses = [replace(model, memory=m).initial_state(late.head(m)) for m in (1, 20)]
    assert abs(guesses[0][0] - x[0][0]) > 1.0
    assert guesses[1][0] == pytest.approx(x[19][0], abs=0.02)
    with pytest.raises(ParameterError, match="memory"):
        replace(model, memory=0)


def test_no_input_makes_the_neural_bicycle_leave_its_bounds():
    model = plant()
    rng = np.random.default_rng(0)
    x = np.zeros(3)
    for _ in range(400):
        x = model.step(x, np.array([rng.uniform(-0.6, 0.6), rng.uniform(0, 90), rng.uniform(-15, 10)]))
        assert abs(x[0]) <= model.most_v_y
        assert abs(x[1]) <= model.most_r


# ---- another session -----------------------------------------------------------------------------------------------


def test_offsets_of_another_session_come_back():
    model = NonlinearBicycle(params=PARAMS, dt=0.05, substeps=2)
    data = made_by(model, drive(1000, seed=4))
    other = data.with_channel("delta", data["delta"] + 0.012).with_channel("r", data["r"] - 0.02)
    adapted = Adapt(outputs=("r",)).fit(model, other)
    assert adapted.inputs_at_zero["delta"] == pytest.approx(0.012, abs=5e-4)
    assert adapted.outputs_at_zero["r"] == pytest.approx(-0.02, abs=5e-4)
    late = other.with_channel("r", np.where(np.arange(1000) < 600, other["r"], 9.0))
    assert Adapt(outputs=("r",)).fit(model, late).inputs_at_zero == adapted.inputs_at_zero
    with pytest.raises(TooShortError, match="30 s"):
        Adapt().fit(model, other.rows(0, 300))
    with pytest.raises(MissingColumnError, match="'Delta'"):
        Adapt(inputs=("Delta",)).fit(model, other.with_channel("Delta", other["delta"]))


def test_greybox_fits_the_neural_bicycle_as_any_other():
    """It is an ODE model like the rest: its physical parameters alone can be moved, the network fixed."""
    truth = plant()
    data = made_by(truth, drive(400, seed=6))
    start = replace(truth, params=PARAMS.with_values(C_f=5e4))
    assert GreyBox(start=start, free=("C_f",)).fit(data).params.C_f == pytest.approx(6e4, rel=1e-3)


# ---- as prediction model of the controller on the fast path --------------------------------------------------------

LATERAL = ("v_y", "r")


def networks_for_control():
    """Hybrid, joint models, ensemble and NARX with the outputs that a position on the ground needs."""
    few = {"dt": 0.05, "substeps": 1}
    lags = discrepancy(("delta", "v_x"), LATERAL)
    joint = [replace(example(seed, LATERAL), **few) for seed in (1, 2)]
    base = NARXModel(network=lags.network, na=2, nb=3, dt=0.05, inputs=("delta", "v_x"), outputs=LATERAL)
    return {
        "hybrid": HybridModel(base=Bicycle(params=FERRARI_250LM, dt=0.05, outputs=LATERAL), discrepancy=lags),
        "joint": joint[0],
        "tire network": replace(example(3, LATERAL, kind=TireNetworkBicycle), **few),
        "ensemble": EnsembleModel(members=tuple(joint)),
        "NARX": base,
    }


def plans(model, horizon=6):
    """First plan of a lane change from beside the path, by Ipopt and by the compiled solver, converged."""
    mpc = MPC(
        OnGround(model),
        solver="ipopt",
        horizon=horizon,
        controls=("delta",),
        Q=Weights(e_y=10.0, e_psi=10.0),
        S=Weights(delta=100.0),
        limits=Limits(delta=0.35),
        rates=Limits(delta=0.8),
    )
    path = double_lane_change(20.0)
    x = np.zeros(mpc.model.n_states)
    x[-3:] = path.start[0], 0.1, 0.005
    reference = mpc.reference(path.ahead(0.0, horizon, 0.05), **{n: 0.0 for n in mpc.exogenous if n != "v_x"})
    return mpc.plan(x, reference), replace(mpc, solver=RealTime(iterations=0)).plan(x, reference)


@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
@pytest.mark.parametrize("name", ["hybrid"])
def test_hybrids_plan_on_the_fast_path(name):
    theirs, ours = plans(networks_for_control()[name])
    assert ours.status is Status.SOLVED
    assert ours.u == pytest.approx(theirs.u, abs=1e-7)
    assert np.abs(ours.u).max() > 1e-5


@pytest.mark.slow
@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
@pytest.mark.parametrize("name", ["NARX", "joint", "tire network", "ensemble"])
def test_physics_with_networks_plan_on_the_fast_path(name):
    theirs, ours = plans(networks_for_control()[name])
    assert ours.status is Status.SOLVED
    assert ours.u == pytest.approx(theirs.u, abs=1e-6)


@pytest.mark.slow
@pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
def test_a_model_too_large_for_straight_line_code_plans_too():
    """Beyond so many instructions the solver calls CasADi's own code, with its work arrays."""
    members = tuple(example(seed, LATERAL) for seed in (4, 5))
    assert all(m.substeps == 5 for m in members)
    theirs, ours = plans(EnsembleModel(members=members), horizon=3)
    assert ours.status is Status.SOLVED
    assert ours.u == pytest.approx(theirs.u, abs=1e-6)
