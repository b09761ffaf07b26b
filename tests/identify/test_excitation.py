"""What every estimator refuses before it starts."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, MissingColumnError, TooShortError
from slipangle.identify import excitation
from slipangle.identify.excitation import require_identifiable, require_independent


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
    with pytest.raises(
        ExcitationError, match="the inputs T, a of 'log' are linear combinations of delta, v_x; expected"
    ):
        require_independent(wide)
    require_independent(three.select(inputs=("delta", "T")))


def test_a_signal_may_be_small_but_is_not_called_constant():
    require_identifiable(data(delta=1e-13 * np.sin(np.arange(50))), 10)
    with pytest.raises(
        ExcitationError, match=r"moves by 2e-200 only, .* its right unit.* expected a signal that moves"
    ):
        require_identifiable(data(delta=1e-200 * np.sin(np.arange(50))), 10)
