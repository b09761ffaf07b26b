"""Free runs that start from the state which fits the first samples of a record, where a protocol gives these."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.judge.compare import compare
from slipangle.identify.judge.initial import free_run
from slipangle.identify.judge.validate import validate
from slipangle.models.black_box.statespace import StateSpaceModel

A = np.array([[0.995, 0.02], [0.0, 0.99]])  # two slow tanks, of which the level of the second is measured
B, C = np.array([[0.0], [0.05]]), np.array([[1.0, 0.0]])


def record(seed=0, n=600, noise=0.05):
    """A level that is still moving when the record begins: from a state that one sample does not tell."""
    rng = np.random.default_rng(seed)
    u, x, y = lfilter([0.1], [1, -0.9], rng.standard_normal(n)), np.array([3.0, -2.0]), np.empty(n)
    for k in range(n):
        y[k] = x[0]
        x = A @ x + B[:, 0] * u[k]
    data = Dataset.from_arrays({"u": u}, {"y": y + noise * rng.standard_normal(n)}, 1.0)
    return data, y


@pytest.fixture
def model():
    shared = {"dt": 1.0, "inputs": ("u",), "outputs": ("y",)}
    return StateSpaceModel(A=A, B=B, C=C, D=np.zeros((1, 1)), K=np.zeros((2, 1)), **shared)


def test_the_state_is_found_from_the_first_samples(model):
    data, y = record()
    run = free_run(model, data, start=50)
    assert not run.predicted[:50].any()
    assert run.predicted[50:].all()
    left = run.y[run.predicted, 0] - y[run.predicted]
    default = free_run(model, data)
    astray = default.y[default.predicted, 0] - y[default.predicted]
    assert np.sqrt(np.mean(left**2)) < 0.1 * np.sqrt(np.mean(astray**2))


def test_later_outputs_are_not_looked_at(model):
    data, _ = record()
    other = data.with_channel("y", np.where(np.arange(600) < 50, data["y"], 7.0))
    np.testing.assert_array_equal(free_run(model, data, start=50).y[50:], free_run(model, other, start=50).y[50:])


def test_every_experiment_has_its_start(model):
    data = join(record(0)[0], record(1)[0])
    run = free_run(model, data, start=30)
    assert np.flatnonzero(~run.predicted).tolist() == [*range(30), *range(600, 630)]
    alone = free_run(model, record(1)[0], start=30)
    np.testing.assert_allclose(run.y[630:], alone.y[30:], rtol=1e-9)


def test_validate_and_compare_start_alike(model):
    data, _ = record()
    found = validate(model, data, start=50)
    ranked = compare({"slow": model, "half": replace(model, B=0.5 * B)}, data, start=50)
    assert found.free_run_scores["y"] == ranked.best.scores["y"]
    assert ranked.best.name == "slow"
    assert found.free_run_scores["y"].rmse == pytest.approx(0.05, rel=0.1)  # the noise
    assert validate(model, data).free_run_scores["y"].rmse > 0.1


def test_starts_that_are_no_start_are_refused(model):
    data, _ = record()
    with pytest.raises(TooShortError, match="600 samples and the start takes 600 of them; expected"):
        free_run(model, data, start=600)
    with pytest.raises(ParameterError, match="start is 1 samples and the model reads"):
        free_run(replace(model, memory=2), data, start=1)
