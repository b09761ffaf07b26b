"""What every estimator refuses before it starts."""

import re

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, IdentifiabilityWarning, MissingColumnError, ModelWarning, TooShortError
from slipangle.identify import excitation
from slipangle.identify.excitation import nearly_dependent, require_identifiable, require_independent
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.polynomial import ARMAX, BoxJenkins, OutputError
from slipangle.identify.linear.statespace import StateSpace


def data(n=50, **change):
    t = np.arange(n)
    channels = {"delta": np.sin(t), "v_x": 20 + np.cos(t), "r": np.sin(t - 1.0)} | change
    return Dataset.from_arrays({k: channels[k] for k in ("delta", "v_x")}, {"r": channels["r"]}, 0.1, name="log")


def test_good_data_pass():
    require_identifiable(data(), 10)
    require_identifiable(data(v_x=np.full(50, 20.0)), 10, scheduling=("v_x",))


@pytest.mark.parametrize(
    ("bad", "kind", "said"),
    [
        (data(delta=np.full(50, 0.25)), ExcitationError, r"the input 'delta' of 'log' is constant at 0\.25.*expected"),
        (data(r=np.zeros(50)), ExcitationError, r"the output 'r' of 'log' is constant at 0"),
        (data().select(inputs=()), MissingColumnError, r"names no inputs.*data\.select\(inputs="),
        (data().select(outputs=()), MissingColumnError, r"names no outputs.*data\.select\(outputs="),
        (data(12), TooShortError, r"12 samples for 10 parameters; expected at least 22"),
    ],
)
def test_poor_data_do_not_pass(bad, kind, said):
    for scheduling in (None, ("v_x",)):
        with pytest.raises(kind, match=said):
            require_identifiable(bad, 10, scheduling=scheduling)


def test_dependent_inputs_are_named(monkeypatch):
    monkeypatch.setattr(excitation, "CHUNK", 7)
    good = data(v_x=np.cos(0.3 * np.arange(50)))
    require_independent(good)
    three = good.with_channel("T", 5 - 3 * good["delta"] + 0.1 * good["v_x"]).with_channel("a", 1e-6 * good["delta"])
    wide = three.select(inputs=("delta", "v_x", "T", "a"))
    said = (
        r"inputs T, a of 'log' are linear combinations of delta, v_x \(the correlation of a and delta is \+1\); expec"
    )
    with pytest.raises(ExcitationError, match=said):
        require_independent(wide)
    require_independent(three.select(inputs=("delta", "T")))


def test_a_signal_may_be_small_but_is_not_called_constant():
    require_identifiable(data(delta=1e-13 * np.sin(np.arange(50))), 10)
    with pytest.raises(
        ExcitationError, match=r"moves by 2e-200 only, .* its right unit.* expected a signal that moves"
    ):
        require_identifiable(data(delta=1e-200 * np.sin(np.arange(50))), 10)


def noisy_pair(c, seed=0):
    rng = np.random.default_rng(seed)
    u, w, n = rng.standard_normal((3, 600))
    w = u + c * w
    y = lfilter([0, 0.2, 0.1], [1, -1.5, 0.7], u + 0.3 * w) + 0.1 * n
    return Dataset.from_arrays({"u": u, "w": w}, {"y": y}, 0.1)


EVERY = [
    ARX(na=2, nb=2),
    ARX(na=2, nb=2, offset=True),
    OutputError(nb=1, nf=2),
    ARMAX(na=2, nb=1, nc=1),
    BoxJenkins(nb=1, nf=1, nc=1, nd=1),
    StateSpace(order=2),
    StateSpace(order=2, focus="simulation"),
]


@pytest.mark.parametrize("estimator", EVERY, ids=repr)
def test_inputs_that_move_alike_are_named_by_every_linear_estimator(estimator):
    with pytest.warns(
        IdentifiabilityWarning, match=r"the inputs u and w .* move alike \(correlation \+0\.99"
    ) as caught:
        model = estimator.fit(noisy_pair(0.05))
    assert len([w for w in caught if "move alike" in str(w.message)]) == 1
    assert sum("move alike" in s for s in model.fit_info.warnings) == 1
    with pytest.raises(
        ExcitationError, match=r"inputs w of .* combinations of u \(the correlation of w and u is \+1\)"
    ):
        estimator.fit(noisy_pair(0.0))


@pytest.mark.parametrize("estimator", EVERY[:3], ids=repr)
def test_inputs_that_move_apart_are_not(estimator):
    assert not any("move alike" in s for s in estimator.fit(noisy_pair(0.3)).fit_info.warnings)


def test_an_input_that_several_others_nearly_make_up_is_named():
    rng = np.random.default_rng(1)
    a, b, c = rng.standard_normal((3, 2000))
    three = Dataset.from_arrays({"a": a, "b": b, "c": a + b + 0.05 * c}, {"y": a}, 0.1)
    (said,) = nearly_dependent(three)
    assert re.search(r"the input c .* nearly a combination of the others \(multiple correlation 0\.999", said)
    assert nearly_dependent(three.select(inputs=["a", "c"])) == ()


def test_without_an_offset_means_tell_inputs_apart():
    u = np.random.default_rng(2).standard_normal(500)
    data = Dataset.from_arrays({"u": u, "w": 2 * u + 3}, {"y": u}, 0.1)
    require_independent(data, offset=False)
    assert nearly_dependent(data, offset=False) == ()
    with pytest.raises(ExcitationError, match="combinations of u"):
        require_independent(data)


def test_samples_that_come_twice_are_named_and_make_intervals_too_narrow():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(400)
    y = lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.3 * rng.standard_normal(400)
    once, other = (Dataset.from_arrays({"u": u[k]}, {"y": y[k]}, 0.1) for k in (slice(0, 200), slice(200, 400)))
    std = ARX(na=1, nb=1).fit(join(once, other)).fit_info.std
    with pytest.warns(ModelWarning, match="experiments 1 and 3 of .* hold the same samples, which then count twice"):
        twice = ARX(na=1, nb=1).fit(join(once, other, once, other)).fit_info.std
    assert np.mean(twice / std) < 0.85
