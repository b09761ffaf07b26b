"""ARX with poles at 1: exact on its own data, and a free run that does not drift."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.integrated import IntegratedARX
from slipangle.models.black_box.arx import ARXModel


def record(model, n=300, seed=0, noise=0.0, slope=0.0):
    rng = np.random.default_rng(seed)
    u = 0.1 * rng.standard_normal(n)
    y = np.zeros(n)
    y[:3] = slope * np.arange(3)
    for k in range(3, n):
        y[k] = sum(-model.A[i, 0, 0] * y[k - 1 - i] for i in range(model.na))
        y[k] += sum(model.B[j, 0, 0] * u[k - model.nk - j] for j in range(model.nb))
    return Dataset.from_arrays({"delta": u}, {"Y": y + noise * rng.standard_normal(n)}, 0.05)


def arx(a, b, nk=1):
    A = np.convolve([1.0, -2.0, 1.0], [1.0, *a])[1:]
    return ARXModel(A=A, B=b, nk=nk, dt=0.05, inputs=("delta",), outputs=("Y",))


@pytest.mark.parametrize(("a", "b", "nk"), [((), (0.1, 0.05), 1), ((-0.5,), (0.2,), 1), ((-0.4,), (0.1, 0.3), 2)])
def test_it_recovers_the_model(a, b, nk):
    truth = arx(a, b, nk)
    data = join(record(truth, seed=1, slope=0.3), record(truth, seed=2))
    found = IntegratedARX(na=truth.na, nb=len(b), nk=nk).fit(data)
    assert found.A.ravel() == pytest.approx(truth.A.ravel(), abs=1e-8)
    assert found.B.ravel() == pytest.approx(truth.B.ravel(), abs=1e-8)


def test_its_free_run_keeps_straight_where_plain_least_squares_drifts():
    truth = arx((-0.3,), (0.05, 0.02))
    train, test = record(truth, n=120, noise=1e-4), record(truth, n=3000, seed=5)
    ours = IntegratedARX(na=3, nb=2).fit(train)
    plain = ARX(na=3, nb=2).fit(train)
    assert np.sort(np.abs(ours.poles))[-2:] == pytest.approx([1.0, 1.0], abs=1e-6)
    errors = [np.abs(m.simulate(test).error).max() for m in (ours, plain)]
    assert errors[0] < 0.2 * errors[1]


def test_bad_input_says_what_to_do():
    with pytest.raises(ParameterError, match="poles at 1"):
        IntegratedARX(na=1, nb=1)
    two = Dataset.from_arrays({"delta": np.ones(20)}, {"Y": np.zeros(20), "psi": np.zeros(20)}, 0.05)
    with pytest.raises(ParameterError, match="expected one"):
        IntegratedARX(na=2, nb=1).fit(two)
