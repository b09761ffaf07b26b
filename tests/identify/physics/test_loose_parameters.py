"""Of parameters that only act together none has a narrow interval; what they make together keeps its own."""

import json
import math

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle import Ode, linearize, load, save
from slipangle.commands import models as commands
from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ParameterError
from slipangle.files import or_null
from slipangle.identify.physics.advise import advise
from slipangle.identify.physics.collocation import Collocation
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.model import FitInfo
from slipangle.numerics.covariance import loose_directions, unlimited
from slipangle.report.diagnostics import forest
from slipangle.report.parameters import correlation_table, parameter_table
from slipangle.workflow import job
from tests.identify.physics.test_grey_box import CASES, drive

A, GAIN, DT = 0.7, 6.0, 0.1
pytestmark = pytest.mark.filterwarnings("ignore::slipangle.errors.IdentifiabilityWarning")


def lag(k1=1.0, k2=1.0):
    """``x' = -a x + k1 k2 u``, and a parameter that does nothing."""
    return Ode(
        f=lambda x, u, p: [-p.a * x[0] + p.k1 * p.k2 * u[0]],
        states=("x",),
        inputs=("u",),
        outputs=("x",),
        params={"a": (1.0, 0.01, 10.0), "k1": (k1, 0.01, 100.0), "k2": (k2, 0.01, 100.0), "idle": (1.0, 0.0, 9.0)},
        dt=DT,
    )


def record(seed=0, n=500):
    rng = np.random.default_rng(seed)
    u, keep = rng.standard_normal(n), math.exp(-A * DT)
    x = lfilter([0, GAIN / A * (1 - keep)], [1, -keep], u)
    noise = 0.05 * rng.standard_normal(n)
    return Dataset.from_arrays({"u": u}, {"x": x + noise * (np.arange(n) > 0)}, DT)


@pytest.mark.parametrize("start", [(1.0, 1.0), (1.0, 10.0), (50.0, 0.02)])
@pytest.mark.parametrize("estimator", [GreyBox, Collocation])
def test_a_product_alone_is_known(start, estimator):
    if estimator is Collocation and start[0] > 1:
        start = (2.0, 5.0)
    info = estimator(start=lag(*start), free=("a", "k1", "k2")).fit(record()).fit_info
    a, k1, k2 = info.values
    assert k1 * k2 == pytest.approx(GAIN, rel=0.02)
    assert np.isfinite(info.std[0])
    assert np.isinf(info.std[1:]).all()
    assert (info.interval()[1:] == [-np.inf, np.inf]).all()
    assert info.std_of([0.0, 0.0, 0.0]) == 0.0
    assert np.isinf(info.std_of([0.0, 1.0, 0.0]))
    plain = GreyBox(start=lag(*start).with_values(k2=k2), free=("a", "k1")).fit(record()).fit_info
    assert a == pytest.approx(plain.values[0], rel=1e-5)
    assert info.std[0] == info.std_of([1.0, 0.0, 0.0]) == pytest.approx(plain.std[0], rel=1e-2)
    assert info.std_of([0.0, k2, k1]) == pytest.approx(k2 * plain.std[1], rel=1e-2)
    assert any(s.startswith("k1, k2 can hardly be told apart") for s in info.warnings)
    assert any(s.startswith("the data do not determine k1:") for s in info.warnings)


def test_what_does_nothing_may_have_any_value():
    info = GreyBox(start=lag(), free=("a", "k1", "idle")).fit(record()).fit_info
    assert np.isfinite(info.std[:2]).all()
    assert np.isinf(info.std[2])
    assert info.warnings == ("the outputs do not depend on idle; expected an influence: fix it",)


def test_a_tie_to_the_initial_state_counts():
    """Without an input the output's scale and the state's start are one."""
    model = Ode(
        f=lambda x, u, p: [-p.a * x[0] + 0.0 * u[0]],
        more=lambda x, u, p: {"y": p.scale * x[0]},
        states=("x",),
        inputs=("u",),
        outputs=("y",),
        params={"a": (1.0, 0.01, 10.0), "scale": (2.0, 0.1, 10.0)},
        dt=DT,
    )
    t = DT * np.arange(200)
    u = np.random.default_rng(0).standard_normal(200)
    noise = 0.01 * np.random.default_rng(1).standard_normal(200)
    data = Dataset.from_arrays({"u": u}, {"y": 3 * np.exp(-A * t) + noise}, DT, extra={"x": 1.5 * np.exp(-A * t)})
    info = GreyBox(start=model, free=("a", "scale"), free_initial_state=True).fit(data).fit_info
    assert info.std[0] < 0.05 * A
    assert np.isinf(info.std[1])


@pytest.fixture(scope="module")
def bicycle():
    """Stiffnesses, mass and inertia, of which only ratios show."""
    model, _ = CASES["bicycle"]
    data = drive(model, noise=0.05)
    with pytest.warns(IdentifiabilityWarning):
        return GreyBox(start=model, free=("C_f", "C_r", "inertia_z", "mass")).fit(data), data


def test_infinite_intervals_are_kept_and_shown(bicycle, tmp_path):
    model, data = bicycle
    info = model.fit_info
    assert np.isinf(info.std).all()
    assert np.isinf(info.condition)
    ratio = [1 / info.values[3], 0.0, 0.0, -info.values[0] / info.values[3] ** 2]
    assert info.std_of(ratio) < 0.2 * info.values[0] / info.values[3]
    save(model, tmp_path / "car.json")
    again = load(tmp_path / "car.json").fit_info
    assert (again.covariance == info.covariance).all()
    assert again.std_of(ratio) == info.std_of(ratio)
    assert np.abs(info.correlation) == pytest.approx(1.0)
    assert [row.tone for row in parameter_table(info).rows] == ["poor"] * 4
    assert len(correlation_table(info).rows) == 4
    assert forest(info).data
    for table in (job._parameters(model), commands._parameters(info)):
        json.loads(json.dumps(table, allow_nan=False))
    assert or_null(1.5) == 1.5
    assert or_null(np.inf) is or_null(np.nan) is None
    assert "∞" in commands._estimates(info)[0]
    best = advise(model, data)[0]
    assert best.before == np.inf
    assert not best.helps
    assert "no bands" in linearize(model, v_x=20.0).uncertainty


def test_directions_that_move_nothing():
    rng = np.random.default_rng(0)
    one, two, three = rng.standard_normal((3, 100))
    jacobian = np.column_stack([one, 3 * one, two, three, 0 * one, two + three])
    loose = loose_directions(jacobian)
    assert loose.shape == (6, 3)
    assert loose.any(axis=1).all()
    assert np.abs(jacobian @ loose).max() < 1e-12
    assert loose_directions(jacobian[:, [0, 2, 3]]).shape == (3, 0)
    some = unlimited(np.eye(6), loose)
    assert np.isinf(np.diag(some)).all()
    assert some[0, 1] == -np.inf
    assert some[2, 3] == np.inf
    assert some[0, 2] == some[0, 4] == 0.0


def test_derivatives_are_one_each():
    info = FitInfo(names=("a",), values=np.ones(1), covariance=np.eye(1), noise_std=np.ones(1), n_samples=9)
    with pytest.raises(ParameterError, match="expected one each"):
        info.std_of([1.0, 2.0])
