"""ARMAX, output-error, Box-Jenkins: true coefficients inside their intervals, ARX as a special case, refusals."""

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.identify.arx import ARX
from slipangle.identify.polynomial import ARMAX, BoxJenkins, OutputError, Polynomial
from slipangle.models.polynomial import PolynomialModel, one

ARMAX_TRUE = {"A": [-1.5, 0.7], "B": [[1.0, 0.5], [0.3]], "C": [0.6], "D": [], "F": [[], []]}
OE_TRUE = {"A": [], "B": [[1.0, 0.5], [0.3]], "C": [], "D": [], "F": [[-1.5, 0.7], [-0.8]]}
BJ_TRUE = {"A": [], "B": [[1.0, 0.5], [0.3]], "C": [0.5], "D": [-0.9], "F": [[-1.5, 0.7], [-0.8]]}
CASES = {
    "ARMAX": (ARMAX(na=2, nb=(2, 1), nc=1, nk=(1, 2)), ARMAX_TRUE),
    "OE": (OutputError(nb=(2, 1), nf=(2, 1), nk=(1, 2)), OE_TRUE),
    "BJ": (BoxJenkins(nb=(2, 1), nf=(2, 1), nc=1, nd=1, nk=(1, 2)), BJ_TRUE),
}


def record(true, n, seed, noise, level=0.0):
    """The difference equation itself, filter by filter."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((n + 100, 2)), noise * rng.standard_normal(n + 100)
    inner = lfilter(one(true["C"]), one(true["D"]), e)
    for i, nk in enumerate((1, 2)):
        inner = inner + lfilter(np.r_[np.zeros(nk), true["B"][i]], one(true["F"][i]), u[:, i])
    y = lfilter([1.0], one(true["A"]), inner)[100:] + level
    return Dataset.from_arrays({"u0": u[100:, 0], "u1": u[100:, 1]}, {"y": y}, 0.1)


def vector(true):
    return np.concatenate([true["A"], *true["B"], *true["F"], true["C"], true["D"]])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", range(3))
def test_true_coefficients_inside_their_intervals(case, seed):
    estimator, true = CASES[case]
    model = estimator.fit(record(true, 3000, seed, 0.5))
    info = model.fit_info
    assert np.abs((info.values - vector(true)) / info.std).max() < 4
    assert info.std.max() < 0.15
    assert info.noise_std[0] == pytest.approx(0.5, rel=0.05)
    assert len(info.names) == len(vector(true))


@pytest.mark.parametrize("case", CASES)
def test_clean_data_give_the_exact_system(case):
    estimator, true = CASES[case]
    model = estimator.fit(record(true, 400, 7, 0.0))
    response = []
    for polynomials in (true, {k: getattr(model, k) for k in "ABCDF"}):
        pulse = np.eye(1, 60)[0]
        for i, nk in enumerate((1, 2)):
            both = np.convolve(one(polynomials["A"]), one(polynomials["F"][i]))
            response.append(lfilter(np.r_[np.zeros(nk), polynomials["B"][i]], both, pulse))
    assert response[2] == pytest.approx(response[0], abs=1e-6)
    assert response[3] == pytest.approx(response[1], abs=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_realisation_is_the_difference_equation(case):
    _, true = CASES[case]
    model = PolynomialModel(**true, nk=(1, 2), dt=0.1, inputs=("u0", "u1"), outputs=("y",))
    data = record(true, 500, 3, 0.3)
    run = model.predict(data)
    u, y = data.u, data.y[:, 0]
    shape = one(true["C"]), one(true["D"])
    inner = lfilter(one(true["A"]), [1.0], y)
    for i, nk in enumerate((1, 2)):
        inner = inner - lfilter(np.r_[np.zeros(nk), true["B"][i]], one(true["F"][i]), u[:, i])
    residual = lfilter(shape[1], shape[0], inner)
    assert run.error[200:, 0] == pytest.approx(residual[200:], abs=1e-6)  # both have forgotten how they started


def test_arx_is_the_special_case():
    data = join(record(ARMAX_TRUE, 300, 1, 0.5), record(ARMAX_TRUE, 200, 2, 0.5))
    plain = ARX(na=2, nb=2).fit(data)
    same = Polynomial(na=2, nb=2).fit(data)
    assert same.A == pytest.approx(plain.A[:, 0, 0], abs=1e-6)
    assert np.array(same.B) == pytest.approx(plain.B[:, 0, :].T, abs=1e-6)


def test_offset_is_estimated():
    estimator = BoxJenkins(nb=(2, 1), nf=(2, 1), nc=1, nd=1, nk=(1, 2), offset=True)
    model = estimator.fit(record(BJ_TRUE, 3000, 4, 0.2, level=50.0))
    assert model.y_offset == pytest.approx(50.0, abs=5 * model.fit_info.std[-1] + 0.3)
    assert model.fit_info.names[-1] == "y_offset[y]"
    assert model.A.size == 0


def test_output_error_minimises_the_free_run():
    train, test = record(OE_TRUE, 1500, 5, 1.5).split(0.6)
    runs = {}
    for name, estimator in {"ARX": ARX(na=2, nb=2), "OE": OutputError(nb=2, nf=2, max_radius=1.0)}.items():
        run = estimator.fit(train).simulate(test)
        runs[name] = np.sqrt(np.mean(run.error[run.predicted] ** 2))
    assert runs["OE"] < runs["ARX"]


def test_pole_limit_holds():
    true = {**OE_TRUE, "F": [[-1.9, 0.905], [-0.8]]}
    model = OutputError(nb=(2, 1), nf=(2, 1), nk=(1, 2), max_radius=0.9).fit(record(true, 400, 6, 1.0))
    assert np.abs(model.poles).max() <= 0.9 + 1e-9


def test_bad_orders_and_data():
    data = record(OE_TRUE, 300, 8, 0.1)
    with pytest.raises(ParameterError, match="nb is 0"):
        Polynomial(nb=0)
    with pytest.raises(ParameterError, match="nf has 3 entries for the inputs u0, u1"):
        OutputError(nb=1, nf=(1, 1, 1)).fit(data)
    with pytest.raises(ParameterError, match="outputs y, u0; expected one"):
        OutputError(nb=1, nf=1).fit(data.select(inputs=["u1"], outputs=["y", "u0"]))
    with pytest.raises(ExcitationError, match=r"'u1'.*constant"):
        OutputError(nb=1, nf=1).fit(data.with_channel("u1", np.ones(300)))
    with pytest.raises(ExcitationError, match="rank"):
        OutputError(nb=1, nf=1).fit(data.with_channel("u1", 2 * data["u0"]))
    with pytest.raises(TooShortError, match="20 samples for 12 parameters"):
        OutputError(nb=3, nf=3).fit(data.head(20))
