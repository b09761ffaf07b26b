"""Models that run away say so when fitted, when simulated and in a verdict; no fit ends in a traceback."""

import warnings
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import IdentifiabilityWarning, ModelWarning, ParameterError, SimulationError, SlipangleError
from slipangle.identify.judge.compare import compare
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.inside import Held, fitted
from slipangle.identify.linear.order_search import Judged, OrderChoice
from slipangle.identify.linear.pem import PEM
from slipangle.identify.linear.polynomial import ARMAX, OutputError
from slipangle.identify.linear.recursive import RLS
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.subspace import Subspace
from slipangle.identify.physics import grey_box as greybox
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.identify.stability import breakdown_said, later
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.custom import Ode


def log(pole, n=400, noise=0.01, seed=0):
    """A first-order system with one pole, driven by noise."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(n)
    y = lfilter([0.0, 1.0], [1.0, -pole], u)
    return Dataset.from_arrays({"u": u}, {"y": y + noise * rng.standard_normal(n)}, 0.1)


LINEAR = {
    "ARX": ARX(na=1, nb=1),
    "ARMAX": ARMAX(na=1, nb=1, nc=1),
    "RLS": RLS(na=1, nb=1),
    "subspace": Subspace(order=1),
    "state space": StateSpace(order=1),
}


@pytest.mark.parametrize("estimator", LINEAR.values(), ids=LINEAR)
def test_an_unstable_fit_says_so_and_how_fast_it_grows(estimator):
    with pytest.warns(ModelWarning, match=r"unstable: it has a pole of modulus 1\.0[34]"):
        model = estimator.fit(log(1.04))
    assert "grows tenfold every" in model.fit_info.warnings[-1]
    assert f"the training data last {400}" in model.fit_info.warnings[-1]


@pytest.mark.parametrize("pole", [0.9, 1.0, 1.001])
@pytest.mark.parametrize("estimator", LINEAR.values(), ids=LINEAR)
def test_stable_and_integrating_fits_do_not(estimator, pole):
    """1.001 grows by half over the record: what an integrator's estimate looks like."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ModelWarning)
        model = estimator.fit(log(pole))
    assert not any("unstable" in s for s in model.fit_info.warnings)


def diverging():
    """An ARX model fitted to quiet data, whose pole is then moved out."""
    data = log(0.9)
    return replace(ARX(na=1, nb=1).fit(data), A=np.array([-1.2])), log(0.9, seed=1)


def test_free_runs_and_long_predictions_that_go_astray_say_so():
    model, data = diverging()
    with pytest.warns(ModelWarning, match="free run of 'y' goes astray: at sample") as caught:
        run = model.simulate(data)
    limit = 100 * 0.5 * np.ptp(np.concatenate([data["y"], log(0.9)["y"]]))
    first = int(np.argmax(np.abs(run.y[:, 0]) > limit))
    sample = int(str(caught[0].message).split("at sample ")[1].split()[0])
    assert abs(sample - first) <= 2
    assert list(run.astray) == ["y"]
    with pytest.warns(ModelWarning, match="100-step-ahead prediction of 'y' goes astray"):
        model.predict(data, 100)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not model.predict(data, 1).astray


def test_the_experiment_is_named():
    model, data = diverging()
    both = replace(data, starts=(0, 20), start_times=(0.0, 100.0))
    with pytest.warns(ModelWarning, match="of the experiment from t = 100 s"):
        model.simulate(both)


def test_predictions_that_leave_the_finite_numbers_end_in_a_sentence():
    model, data = diverging()
    model = replace(model, A=np.array([-1e40]))
    with pytest.raises(SimulationError, match="20-step-ahead prediction of 'y' leaves the finite numbers at sample 20"):
        model.predict(data, 20)


def test_verdicts_name_it():
    model, data = diverging()
    with pytest.warns(ModelWarning):
        verdict = validate(model, data)
    assert "free run of 'y' goes astray" in verdict.residuals["y"].sentences[0]
    with pytest.warns(ModelWarning):
        ranked = compare({"wild": model, "tame": replace(model, A=np.array([-0.9]))}, data)
    assert ranked.best.name == "tame"
    assert not any("goes astray" in sentence for sentence in ranked.best.warnings)
    astray, grown = ranked.entries[1].warnings[-2:]
    assert "goes astray" in astray
    assert "unstable where it was driven" in grown


def test_a_model_of_unknown_data_is_not_suspected_of_a_normal_run():
    """A catalogue model on stand-in outputs: only what no unit explains counts."""
    data = Dataset.from_arrays({"u": np.ones(300)}, {"y": np.r_[0.1, np.zeros(299)]}, 0.1)
    integrator = ARXModel(A=np.array([-1.0]), B=np.array([1.0]), dt=0.1, inputs=("u",), outputs=("y",))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert integrator.simulate(data).y.max() > 290
    with pytest.warns(ModelWarning, match="goes astray"):
        replace(integrator, A=np.array([-1.1])).simulate(data)


def hard():
    """A record on which the free-run fit ends at a pole of modulus 1.1 that only its own initial state tames."""
    rng = np.random.default_rng(44)
    n, order = 400, int(rng.integers(1, 4))
    poles = rng.uniform(0.3, 1.05, order) * np.where(rng.random(order) < 0.3, -1, 1)
    u = rng.standard_normal(n)
    y = lfilter([0.0, 1.0], np.real(np.poly(poles)), u)
    return Dataset.from_arrays({"u": u}, {"y": y + 0.1 * np.std(y) * rng.standard_normal(n)}, 0.1)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_free_run_fit_follows_its_own_training_data_or_says_so(order):
    data = hard()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = StateSpace(order=order, focus="simulation").fit(data)
        error = model.simulate(data).error
    said = " ".join(model.fit_info.warnings)
    unstable = "those of an unstable system" in said
    assert np.sqrt(np.mean(error**2)) < 2 * np.std(data.y) or unstable
    assert not unstable or abs(np.abs(model.poles).max() - 1.02689) < 1e-3  # as it was made


def test_a_fit_that_only_its_initial_state_tames_is_made_again_with_its_poles_held():
    """Pure noise: free-run fits without a limit run off to unstable poles."""
    rng = np.random.default_rng(0)
    n = 300
    u = rng.standard_normal(n)
    data = Dataset.from_arrays({"u": u}, {"y": 1.2 ** np.arange(n) + u}, 0.05)
    with pytest.warns(ModelWarning, match="goes astray: "):
        model = StateSpace(order=2, focus="simulation", offsets="both").fit(data)
    assert any("expected data that a free run can follow" in s for s in model.fit_info.warnings)


def test_a_pole_that_grows_more_slowly_than_the_training_data_show_is_held():
    """Modes of 1.002 to 1.004 explain drifts over 100 samples; after 3000 they are 500 times the signal."""
    rng, parts = np.random.default_rng([0, 100]), []
    for _ in range(6):
        u = rng.standard_normal(100)
        drift = 0.3 * np.cumsum(rng.standard_normal(100)) / 10.0
        y = lfilter([0.0, 0.3], [1.0, -0.7], u + 0.5) + drift + 0.05 * rng.standard_normal(100)
        parts.append(Dataset.from_arrays({"u": u}, {"y": y}, 0.05))
    with pytest.warns(IdentifiabilityWarning, match="no free run over held-out data is better for them"):
        model = StateSpace(order=(1, 2, 3)).fit(join(*parts))
    assert np.abs(model.poles).max() <= 1 + 1e-12
    assert "poles held inside the unit circle" in model.fit_info.method
    StateSpace(order=(1, 2, 3), max_radius=1.0).fit(join(*parts))  # says nothing
    assert "slightly unstable: it has a pole of modulus 1.003" in later(np.array([0.5, 1.003]), join(*parts))
    assert not later(np.array([0.5, 1.0]), join(*parts))


@dataclass(frozen=True)
class Fits:
    """What `fitted` asks of settings: fits that end outside the unit circle where no limit is given."""

    max_radius: float | None = None
    focus: str = "simulation"

    def _lasting(self, data, choice):
        return choice, SimpleNamespace(A=np.array([[self.max_radius or 1.01]]))


@pytest.mark.parametrize(
    ("outside", "settings", "radius"),
    [(False, Fits(), 1.0), (True, Fits(), 1.01), (False, Fits(focus="prediction"), 1.01), (False, Fits(1.02), 1.02)],
    ids=["nothing bears it out", "held-out data do", "prediction", "a limit is given"],
)
def test_a_pole_outside_that_held_out_data_say_nothing_for_is_held(outside, settings, radius):
    none = np.zeros(1)
    choice = OrderChoice(orders=(1,), errors=none, singular_values=none, order=1, holdout="", outside=outside)
    found, model = fitted(settings, None, choice)
    assert model.A[0, 0] == radius
    assert found.inside is (radius == 1.0)


@pytest.mark.parametrize("better", [True, False])
def test_orders_after_one_whose_poles_are_held_are_refined_so_alone(better):
    """Orders 2 to 4: the first ends inside the unit circle, the second outside."""
    poles, asked = {2: 0.9, 3: 1.01, 4: 1.01}, []

    def refined(order):
        def refine(how, most):
            asked.append((order, how.max_radius))
            pole = min(poles[order], how.max_radius or np.inf)
            model, error = SimpleNamespace(A=np.array([[pole]])), 0.5 if pole > 1 and not better else 1.0
            return Judged(model, [model], np.array([[error**2]]), np.full(10, error**2), 1.0)

        return refine

    held = Held(Fits())
    ends = [held.better(order, refined(order), np.inf).model.A[0, 0] for order in poles]
    assert ends == ([0.9, 1.0, 1.0] if better else [0.9, 1.01, 1.01])
    assert asked == [(2, None), (3, None), (3, 1.0), *([(4, 1.0)] if better else [(4, None), (4, 1.0)])]
    assert [held.of(order).max_radius for order in poles] == ([None, 1.0, 1.0] if better else [None] * 3)


def test_poles_are_not_held_where_that_is_worse_though_by_less_than_chance():
    """So the positioning system, which integrates, lost a state and 7 % of its position."""
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, 10)

    def refine(how, most):
        model, error = SimpleNamespace(A=np.array([[how.max_radius or 1.01]])), 1.05 if how.max_radius else 1.0
        blocks = error**2 + (noise if how.max_radius else 0.0)
        return Judged(model, [model], np.array([[error**2]]), blocks, 1.0)

    held = Held(Fits())
    assert refine(Fits(1.0), 0.0).alike(refine(Fits(), 0.0)) > 1.05
    assert held.better(3, refine, np.inf).model.A[0, 0] == 1.01
    assert held.of(3).max_radius is None


@pytest.mark.parametrize(
    "estimator",
    [StateSpace(), StateSpace(order=2), Subspace(order=2), OutputError(nb=1, nf=1), ARMAX(na=1, nb=1, nc=1)],
    ids=["order open", "order 2", "subspace", "output error", "ARMAX"],
)
def test_diverging_numbers_end_in_one_sentence(estimator):
    rng = np.random.default_rng(0)
    u = rng.standard_normal(200)
    data = Dataset.from_arrays({"u": 1e160 * u}, {"y": 1e160 * np.r_[0.0, u[:-1]]}, 0.1)
    with np.errstate(all="ignore"), pytest.raises(SlipangleError) as said:
        estimator.fit(data)
    assert "infs or NaNs" not in str(said.value)


def test_a_start_that_overflows_ends_in_one_sentence():
    start = StateSpaceModel(A=[[1e200]], B=[[1.0]], C=[[1.0]], K=[[1e250]], dt=0.1, inputs=("u",), outputs=("y",))
    with np.errstate(all="ignore"), pytest.raises(SimulationError, match="diverged; expected numbers that stay finite"):
        PEM(start=start).fit(log(0.9))


@pytest.mark.parametrize(
    "error",
    [ValueError("array must not contain infs or NaNs"), np.linalg.LinAlgError("SVD did not converge"), OverflowError()],
)
def test_what_linear_algebra_says_is_not_what_a_user_reads(error):
    with pytest.raises(SimulationError, match=r"^the fit of a thing to 'data' diverged; expected"):
        with breakdown_said("a thing", log(0.5)):
            raise error
    with pytest.raises(ValueError, match="a bug"), breakdown_said("a thing", log(0.5)):
        raise ValueError("a bug of ours")


def test_orders_that_differ_by_rounding_are_not_ranked():
    """Without noise every order from the true one on is exact: the smallest of them is chosen on any processor."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300)
    y = lfilter([0.0, 0.1, 0.05], [1.0, -1.5, 0.7], u)
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.05)
    assert StateSpace(order=(1, 2, 3, 4)).choose_order(data).order == 2


@pytest.mark.parametrize(
    ("order", "second", "enough"),
    [
        (1, lambda y: 2 * y, False),
        (2, lambda y: 2 * y, True),
        ((1, 2, 3), lambda y: 2 * y, True),
        ((2, 3), lambda y: np.r_[0.0, y[:-1]], True),  # a delay is one more state
    ],
    ids=["too few states", "twice", "twice, order open", "later"],
)
def test_outputs_that_repeat_each_other_are_fitted(order, second, enough):
    """Their residuals' covariance is singular: no gain can be made of it."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(300)
    y = lfilter([0.0, 0.1, 0.05], [1.0, -1.5, 0.7], u)
    data = Dataset.from_arrays({"u": u}, {"y": y, "z": second(y)}, 0.05)
    model = StateSpace(order=order, offsets="output", max_radius=1.0).fit(data)
    error = np.std(model.simulate(data).error, axis=0)
    assert np.all(error < (0.05 if enough else 2.0) * np.std(data.y, axis=0))


# ---- grey box ------------------------------------------------------------------------------------------------------


def tank(dt, **more):
    """Level of a tank that a pump fills and a hole empties; ``idle`` hardly matters."""

    def rate(x, u, p):
        return [p.pump * u[0] - p.hole * x[0] + 1e-6 * p.idle]

    parameters = {"pump": (0.02, 1e-4, 1.0), "hole": (0.03, 1e-4, 1.0), "idle": (1.0, 0.0, 10.0)} | more
    return Ode(f=rate, states=("h",), inputs=("u",), params=parameters, dt=dt)


@pytest.mark.parametrize("dt", [0.01, 0.5, 4.0, 30.0])
def test_slow_data_cost_no_finished_fit(dt):
    """Levels every 4 s: sweeps from 0.5 Hz on cannot be logged, so the advice is of slower ones."""
    rng = np.random.default_rng(0)
    true = tank(dt).with_values(pump=0.03, hole=0.02)
    data = Dataset.from_arrays({"u": np.repeat(rng.uniform(0, 2, 50), 5)}, {"h": np.zeros(250)}, dt)
    noisy = true.simulate(data).y[:, 0] + 0.2 * rng.standard_normal(250)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        model = GreyBox(start=tank(dt), free=("pump", "hole", "idle")).fit(data.with_channel("h", noisy))
    off = (model.fit_info.values[:2] - [0.03, 0.02]) / model.fit_info.std[:2]
    assert np.abs(off).max() < 4
    assert any("idle" in s for s in model.fit_info.warnings)


def test_advice_that_cannot_be_made_costs_no_finished_fit(monkeypatch):
    def refused(*arguments):
        raise ParameterError("f_start is 0.5 Hz")

    monkeypatch.setattr(greybox, "better_sentences", refused)
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays({"u": rng.uniform(0, 2, 200)}, {"h": np.zeros(200)}, 4.0)
    made = data.with_channel("h", tank(4.0).simulate(data).y[:, 0] + 0.1 * rng.standard_normal(200))
    with pytest.warns(IdentifiabilityWarning):
        assert GreyBox(start=tank(4.0), free=("pump", "hole", "idle")).fit(made).fit_info.n_samples == 199


@pytest.mark.filterwarnings("ignore::slipangle.errors.IdentifiabilityWarning")
def test_a_grey_box_that_runs_away_on_its_own_data_says_so():
    def rate(x, u, p):
        return [p.grow * x[0] ** 3 + u[0]]

    start = Ode(f=rate, states=("h",), inputs=("u",), params={"grow": (5.0, 4.0, 6.0)}, dt=0.1)
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays({"u": np.ones(100) + rng.standard_normal(100)}, {"h": 1 + rng.standard_normal(100)}, 0.1)
    with np.errstate(all="ignore"):
        model = GreyBox(start=start, free="grow").fit(data)
    assert any("leaves the finite numbers on its own training data" in s for s in model.fit_info.warnings)
