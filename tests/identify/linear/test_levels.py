"""Levels that a model without a constant cannot hold are named, and nothing else is taken for one."""

import warnings

import numpy as np
import pytest
from scipy.signal import lfilter

import slipangle as sa
from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning
from slipangle.identify.linear.pem import PEM
from slipangle.identify.linear.subspace import Subspace

LEVEL = "the data have a level that a model without a constant cannot hold"


def record(n, *, u_mean=0.0, level=0.0, noise=0.1, colour=0.0, seed=0, pole=0.9):
    """A lag of gain 2 and white or coloured noise, as a share of the output's standard deviation."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(n // 3 + 1), 3)[:n] + u_mean
    long = np.concatenate([np.full(500, u_mean), u])
    y = lfilter([0, 2 * (1 - pole)], [1, -pole], long)[500:]
    e = lfilter([np.sqrt(1 - colour**2)], [1, -colour], rng.standard_normal(n + 500))[500:]
    return Dataset.from_arrays({"u": u}, {"y": y + np.std(y) * noise * e + level}, 0.1)


def said(estimator, data):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = estimator.fit(data)
    kinds = {w.category for w in caught if LEVEL in str(w.message)}
    told = [s for s in model.fit_info.warnings if LEVEL in s]
    assert kinds == ({IdentifiabilityWarning} if told else set())
    return told


@pytest.mark.parametrize(
    "estimator",
    [
        *(sa.ARX(na=2, nb=2), sa.OutputError(nb=1, nf=1), sa.ARMAX(na=1, nb=1, nc=1), sa.StateSpace(order=1)),
        Subspace(order=1),
    ],
    ids=lambda e: type(e).__name__,
)
def test_a_level_is_named_with_its_size_and_the_fix(estimator):
    (sentence,) = said(estimator, record(600, u_mean=3.0, level=44.0))
    fix = "offsets='output'" if hasattr(estimator, "offsets") else "offset=True"
    assert f"set {fix}, or subtract the means" in sentence
    assert float(sentence.partition("y of ")[2].partition(" ")[0]) == pytest.approx(44.0, rel=0.02)
    name, value = fix.split("=")
    assert not said(
        type(estimator)(**{**vars(estimator), name: {"True": True}.get(value, "output")}),
        record(600, u_mean=3.0, level=44.0),
    )


def test_estimators_that_choose_say_it_too():
    data = record(400, level=5.0)
    assert said(sa.ARX(), data)
    assert said(sa.StateSpace(order=(1, 2)), data)


@pytest.mark.parametrize("colour", [0.0, 0.9])
@pytest.mark.parametrize(
    ("noise", "n", "pole"), [(0.0, 600, 0.9), (0.1, 600, 0.9), (0.5, 3000, 0.7), (1.0, 9000, 0.98)]
)
def test_inputs_with_a_mean_are_no_level(colour, noise, n, pole):
    for seed in range(2):
        data = record(n, u_mean=20.0, noise=noise, colour=colour, seed=seed, pole=pole)
        assert not said(sa.ARX(na=1, nb=1), data)


def test_several_outputs_are_told_apart_and_pem_knows_the_levels_of_its_start():
    one = record(600, u_mean=3.0, level=20.0)
    b = lfilter([0, 1], [1, -0.5], one["u"]) + 0.1 * np.random.default_rng(1).standard_normal(600)
    data = Dataset.from_arrays({"u": one["u"]}, {"a": one["y"], "b": b}, 0.1).rows(20, 600)
    (sentence,) = said(sa.ARX(na=1, nb=1), data)
    assert "a of 2" in sentence
    assert "b of" not in sentence
    start = sa.StateSpace(order=1, offsets="output").fit(one)
    assert not said(PEM(start=start, focus="simulation"), one)
