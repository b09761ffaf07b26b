"""A network inside physics proves itself on manoeuvres that it was not trained on, or the physics comes back."""

import json
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from slipangle.errors import ModelWarning, ParameterError
from slipangle.identify.judge.validate import score
from slipangle.identify.networks.joint import Joint
from slipangle.identify.networks.joint_problem import JointProblem
from slipangle.identify.networks.unlike import Proof
from slipangle.models.storage import load, save
from slipangle.models.vehicles.neural_bicycle import NeuralBicycle, TireNetworkBicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle
from tests.identify.networks.test_hybrid import PARAMS, drive, made_by

CAR = NonlinearBicycle(params=PARAMS, dt=0.05, substeps=3)
TINY = {"start": CAR, "free": ("C_f",), "hidden": (4,), "max_iterations": 3}


def noisy(n=400, seed=1):
    """The very car that the physics is, with noise on its yaw rate."""
    data = made_by(CAR, drive(n, seed=seed))
    return data.with_channel("r", data["r"] + 0.02 * np.random.default_rng(seed).standard_normal(n), "rad/s")


@pytest.fixture(scope="module")
def ensemble():
    return Joint(**TINY, seeds=(0, 1)).fit_ensemble(noisy(300))


def test_physics_that_nobody_fitted_is_fitted_before_a_network_is_judged_beside_it():
    """As it was given it fits the yaw rate far worse, and came back as 'better alone'."""
    wrong = replace(CAR, params=PARAMS.with_values(C_f=0.6 * PARAMS.C_f, inertia_z=1.6 * PARAMS.inertia_z))
    data, unseen = noisy(400), noisy(300, seed=4)
    settings = Joint(**TINY | {"start": wrong, "free": ("C_f", "C_r", "inertia_z")})
    found = settings.fit(data)
    assert score(wrong.simulate(unseen), "r").rmse > 0.04  # where the noise is 0.02
    assert score(found.simulate(unseen), "r").rmse < 0.021


def test_where_the_physics_is_right_it_comes_back_and_says_so(ensemble):
    (alone,) = ensemble.members
    harder = drive(300, seed=2)
    harder = harder.with_channel("delta", 2.0 * harder["delta"], "rad")
    assert isinstance(alone, NeuralBicycle)
    assert np.array_equal(alone.simulate(harder).y, CAR.simulate(harder).y)
    assert len(ensemble.fit_info.trials) == 2
    for trial in ensemble.fit_info.trials:
        assert trial.note.startswith("the network is off: on manoeuvres unlike those it was trained on it changed the")
    assert [trial.note for trial in ensemble.fit_info.trials] == list(ensemble.fit_info.warnings)


WORSE = replace(CAR, params=PARAMS.with_values(C_f=0.6 * PARAMS.C_f))


@pytest.mark.parametrize(("physics", "with_network", "off"), [(WORSE, CAR, False), (CAR, WORSE, True)])
def test_a_network_stays_where_it_is_better_on_what_it_was_not_trained_on(physics, with_network, off, monkeypatch):
    trained = SimpleNamespace(run=lambda *_: with_network, alone=lambda model, note: note)
    monkeypatch.setattr(Joint, "_problem", lambda *_: trained)
    data = noisy(400)
    signals = np.column_stack([data["v_x"], data["v_x"] * data["r"]])
    (judged,) = Joint(**TINY)._judged(physics, data, signals, SimpleNamespace(part=0))
    assert (judged is not None) == off


def test_the_physics_that_comes_back_is_saved_and_read(ensemble, tmp_path):
    (alone,) = ensemble.members
    again = load(save(alone, tmp_path / "model.json"))
    assert again == alone
    assert again.fit_info.warnings == alone.fit_info.warnings
    assert "is off" in json.dumps(json.loads((tmp_path / "model.json").read_text()))


@pytest.mark.slow
def test_tire_networks_are_judged_alike():
    alone = Joint(**TINY, corrects="tires").fit(noisy())
    assert isinstance(alone, TireNetworkBicycle)
    assert np.array_equal(alone.simulate(noisy(seed=3)).y, CAR.simulate(noisy(seed=3)).y)


def test_a_fitted_physics_keeps_its_estimates_and_doubts(ensemble):
    info = replace(ensemble.fit_info, names=("C_f",), values=np.array([6e4]), covariance=np.eye(1), warnings=("loose",))
    fitted = replace(CAR, fit_info=info)
    (tried,) = ensemble.members
    tried = replace(tried, fit_info=replace(tried.fit_info, trials=tried.fit_info.trials[:1]))
    alone = Joint(**{**TINY, "start": fitted})._problem(fitted, noisy()).alone(tried, "the network is off")
    assert alone.params == CAR.params
    assert alone.fit_info.names == ("C_f",)
    assert alone.fit_info.warnings == ("loose", "the network is off")
    assert not alone.network.parameters.any()


@pytest.mark.slow
def test_unjudged_a_network_is_never_off():
    data = noisy()
    model = Joint(**TINY, folds=0).fit(data)
    assert not np.array_equal(model.simulate(data).y, CAR.simulate(data).y)
    assert not any("is off" in said for said in model.fit_info.warnings)


@pytest.mark.slow
def test_what_comes_back_is_not_worse_than_the_physics_where_that_was_fitted_too():
    """Of made cars that the physics describes, unjudged networks lose on unseen drives."""
    data, unseen = noisy(900, seed=4), made_by(CAR, drive(900, seed=5))
    settings = Joint(start=CAR, hidden=(12,), max_iterations=25)
    judged, trusted = settings.fit(data), replace(settings, folds=0).fit(data)
    fits = [score(model.simulate(unseen), "r").fit for model in (CAR, judged, trusted)]
    assert fits[1] == fits[0] > fits[2] + 0.5


@pytest.mark.slow
def test_a_fit_whose_derivatives_are_no_numbers_ends_where_it_is(monkeypatch):
    whole = JointProblem.linearised

    def broken(self, theta):
        hessian, gradient = whole(self, theta)
        return np.full_like(hessian, np.nan), gradient

    monkeypatch.setattr(JointProblem, "linearised", broken)
    monkeypatch.setattr(JointProblem, "_info", lambda self, theta, data, trial: None)
    with pytest.warns(ModelWarning, match="never improved on the physics"):
        Joint(**TINY, folds=0).fit(noisy())


@pytest.mark.parametrize("kwargs", [{"folds": -1}, {"worth": 1.0}])
def test_settings_out_of_range(kwargs):
    with pytest.raises(ParameterError, match=next(iter(kwargs))):
        Joint(**{**TINY, **kwargs})


@pytest.mark.parametrize(
    ("before", "after", "believed"),
    [
        ([1.0], [0.9], True),
        ([1.0], [0.99], False),
        ([1.0, 1.0], [0.5, 1.01], False),
        ([1.0, 1.0], [0.9, 0.9], True),
        ([0.0], [0.0], False),
        ([np.inf], [0.3], True),
        ([1.0], [np.inf], False),
        ([np.inf], [np.inf], False),
        ([1.0], [np.nan], False),
    ],
)
def test_what_a_proof_believes(before, after, believed):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        doubt = Proof(before=np.array(before), after=np.array(after)).doubt(0.02)
    assert (doubt == "") is believed
