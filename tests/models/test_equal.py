"""Models are the same where all that they are made of is, read back from a file too."""

from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from slipangle.models.model import FitInfo
from slipangle.models.tires.neural import NeuralCurve
from tests.models.all_models import ALL_MODELS, neural_tire


@pytest.mark.parametrize("name", ALL_MODELS)
def test_a_model_is_the_same_as_itself_read_back(name, tmp_path):
    model = ALL_MODELS[name]
    sa.save(model, tmp_path / "model.json")
    again = sa.load(tmp_path / "model.json")
    assert again == model
    assert not again != model
    assert hash(again) == hash(model)


def test_one_number_makes_another_model():
    model = ALL_MODELS["ARX"]
    other = replace(model, A=model.A * (1 + 1e-15))
    assert not np.array_equal(other.A, model.A)
    assert other != model
    assert model != ALL_MODELS["state space"]
    assert len({model, replace(model), other}) == 2


def test_a_fitted_curve_of_a_network_is_the_same_as_one_of_another_fit():
    """How a thing was fitted is not what it is, and its arrays have no order to be compared by."""
    curve = next(v for v in vars(neural_tire()).values() if isinstance(v, NeuralCurve))

    def told():
        return FitInfo(names=("w",), values=np.ones(2), covariance=np.eye(2), noise_std=np.ones(1), n_samples=9)

    assert told() == told()
    assert replace(told(), values=np.zeros(1)) != told()
    assert replace(curve, fit_info=told()) == replace(curve, fit_info=told()) == curve
