"""Models are the same where all that they are made of is, read back from a file too."""

from dataclasses import replace

import numpy as np
import pytest

import slipangle as sa
from tests.models.all_models import ALL_MODELS


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
