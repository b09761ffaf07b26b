"""ARX: Gram and QR agree with plain least squares, parameters come back, bad data are refused by name."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ParameterError, SimulationError, TooShortError
from slipangle.identify.linear import lags
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.colour import _residual
from slipangle.identify.linear.integrated import IntegratedARX
from slipangle.identify.linear.recursive import RLS
from slipangle.identify.networks.narx import NARX
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import Model


def record(n, nu=1, ny=1, seed=0, extra=False):
    """Random inputs and outputs of given counts, scaled very differently; ``extra`` puts a channel in between."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** np.arange(-3, -3 + nu + ny)
    u = {f"u{i}": size[i] * rng.standard_normal(n) for i in range(nu)}
    y = {f"y{i}": size[nu + i] * (0.5 + rng.standard_normal(n)) for i in range(ny)}
    if extra:
        data = Dataset.from_arrays({**u, "noise": rng.standard_normal(n)}, y, 0.1)
        return data.select(inputs=list(u))
    return Dataset.from_arrays(u, y, 0.1)


def dense(data, na, nb, nk, offset):
    """Regressors and targets, written down row by row."""
    m = max(na, nb + nk - 1)
    rows, targets = [], []
    for part in data.experiments:
        for k in range(m, part.n_samples):
            past = [part.y[k - i] for i in range(1, na + 1)] + [part.u[k - j] for j in range(nk, nk + nb)]
            rows.append(np.concatenate([*past, np.ones(int(offset))]))
            targets.append(part.y[k])
    return np.array(rows), np.array(targets)


@pytest.mark.parametrize(("n", "m"), [(40, 1), (57, 5), (64, 16), (65, 17), (1000, 30), (70001, 11)])
@pytest.mark.parametrize("names", [("u0", "y0"), ("y0",), ("u0", "u1", "y0")])
def test_lag_products_have_exact_ends(n, m, names):
    data = record(n, nu=2, extra=True)
    data = replace(data, starts=(0, n // 3), start_times=(0.0, 1e4))
    shift = np.full(len(names), 0.3)
    windows = lags.Windows(data=data, names=names, lags=m, shift=shift)
    z = np.column_stack([data[name] for name in names]) - shift
    pieces = [z[a : a + m].ravel() for s, e in zip(data.starts, data.stops, strict=True) for a in range(s, e - m + 1)]
    plain = np.array(pieces).reshape(-1, m * len(names))
    assert windows.count == len(plain)
    gram, sums = windows.gram()
    size = np.sqrt(np.diag(plain.T @ plain)) if len(plain) else 1.0
    assert gram / np.outer(size, size) == pytest.approx(plain.T @ plain / np.outer(size, size), abs=1e-12)
    assert sums / size == pytest.approx(plain.sum(axis=0) / size, abs=1e-10)


def test_block_qr_is_the_gram_matrix_root():
    data = record(9000, nu=2)
    windows = lags.Windows(data=data, names=("u1", "y0"), lags=4)
    r = lags.triangle(windows, [0, 3, 5], constant=True, scale=np.array([1.0, 2.0, 1.0, 1.0]))
    rows = np.vstack([np.column_stack([np.ones(len(w)), w[:, [0, 3, 5]]]) for w in windows.rows(700)])
    rows[:, 1] /= 2
    assert r.T @ r == pytest.approx(rows.T @ rows, rel=1e-11)
    assert np.tril(r, -1) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.filterwarnings("ignore:the data have a level")  # which is part of what is compared
@pytest.mark.parametrize("force_qr", [False, True], ids=["gram", "qr"])
@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize(
    ("na", "nb", "nk", "nu", "ny"),
    [(1, 1, 1, 1, 1), (2, 3, 1, 2, 1), (3, 1, 2, 1, 2), (2, 2, 3, 2, 2), (1, 3, 0, 2, 2), (2, 1, 0, 1, 1)],
)
def test_equals_plain_least_squares(monkeypatch, force_qr, offset, na, nb, nk, nu, ny):
    data = record(700, nu, ny, seed=na + nu)
    data = replace(data, starts=(0, 300), start_times=(0.0, 1e3))
    if force_qr:
        monkeypatch.setattr("slipangle.identify.linear.arx._Regression._from_gram", lambda *a: None)
    model = ARX(na=na, nb=nb, nk=nk, offset=offset).fit(data)
    phi, target = dense(data, na, nb, nk, offset)
    scale = np.linalg.norm(phi, axis=0)
    theta = np.linalg.lstsq(phi / scale, target, rcond=None)[0] / scale[:, None]
    error = target - phi @ theta
    sigma = error.T @ error / (len(phi) - phi.shape[1])
    info = model.fit_info
    inverse = np.linalg.inv((phi / scale).T @ (phi / scale)) / np.outer(scale, scale)
    assert ("QR" in info.method) == force_qr
    assert info.values * np.tile(scale, ny) == pytest.approx((theta * scale[:, None]).T.ravel(), rel=1e-8, abs=1e-9)
    assert info.noise_std == pytest.approx(np.sqrt(np.diag(sigma)), rel=1e-8)
    std = np.sqrt(np.diag(np.kron(sigma, inverse)))
    assert info.covariance / np.outer(std, std) == pytest.approx(np.kron(sigma, inverse) / np.outer(std, std), abs=1e-7)
    assert info.n_samples == len(phi)
    one_step = model.predict(data)
    if nk == 0:  # the prediction starts one sample later in each experiment
        error = np.delete(error, [0, 300 - max(na, nb - 1)], axis=0)
    assert one_step.error[one_step.predicted] == pytest.approx(error, rel=1e-6, abs=1e-9 * np.abs(target).max())


@pytest.mark.parametrize("offset", [False, True])
@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_recovers_the_model_that_made_the_data(offset, noise):
    rng = np.random.default_rng(5)
    true = ARXModel(
        A=np.array([[[-0.9, 0.1], [0.0, -0.8]], [[0.1, 0.0], [0.05, 0.2]]]),
        B=np.array([[[1.0, 0.2], [0.3, -0.1]]]),
        c=np.array([0.1, -0.2]) if offset else None,
        nk=2,
        dt=0.1,
        inputs=("a", "b"),
        outputs=("p", "q"),
    )
    n = 5_000 if noise else 300
    data = Dataset.from_arrays(
        {"a": rng.standard_normal(n), "b": 3 + rng.standard_normal(n)}, {"p": np.zeros(n), "q": np.zeros(n)}, 0.1
    )
    y = true.simulate(data).y.copy()
    if noise:
        x = np.zeros(true.n_states)
        for k in range(n):
            x = np.asarray(true.correct(x, data.u[k], true.output(x, data.u[k]) + noise * rng.standard_normal(2)))
            y[k] = true.output(x, data.u[k])
            x = true.step(x, data.u[k])
    data = data.with_channel("p", y[:, 0]).with_channel("q", y[:, 1])
    fitted = ARX(na=2, nb=1, nk=2, offset=offset).fit(data)
    want = np.concatenate([-true.A.transpose(1, 0, 2).reshape(2, -1), true.B.transpose(1, 0, 2).reshape(2, -1)], axis=1)
    want = np.hstack([want, true.c[:, None]]) if offset else want
    if noise:
        z = (fitted.fit_info.values - want.ravel()) / fitted.fit_info.std
        assert np.abs(z).max() < 4
        assert fitted.fit_info.noise_std == pytest.approx(noise, rel=0.03)
    else:
        assert fitted.fit_info.values == pytest.approx(want.ravel(), abs=1e-9)


def test_large_mean_costs_no_digits():
    rng = np.random.default_rng(2)
    u = 1e6 + rng.standard_normal(4000)
    y = np.zeros(4000)
    for k in range(1, 4000):
        y[k] = 0.8 * y[k - 1] + 0.5 * (u[k - 1] - 1e6) + 0.01 * rng.standard_normal()
    model = ARX(na=1, nb=1, offset=True).fit(Dataset.from_arrays({"u": u}, {"y": y + 5e5}, 0.1))
    assert -model.A[0, 0, 0] == pytest.approx(0.8, abs=1e-3)
    assert model.B[0, 0, 0] == pytest.approx(0.5, abs=1e-3)
    assert model.c[0] == pytest.approx(5e5 * 0.2 - 0.5e6, abs=600 * 3)


@pytest.mark.filterwarnings("ignore:the data have a level")  # which is part of what is compared
def test_experiments_are_not_joined():
    a, b = record(200, seed=1), record(150, seed=2)
    both = ARX(na=2, nb=2).fit(join(a, b))
    phi, target = dense(join(a, b), 2, 2, 1, False)
    assert both.fit_info.n_samples == len(phi) == 198 + 148
    assert both.fit_info.values == pytest.approx(np.linalg.lstsq(phi, target, rcond=None)[0].ravel(), rel=1e-6)


def test_collinear_regressors_are_named():
    data = record(300)
    later = data.with_channel("u1", 2 * np.roll(data["u0"], 1)).select(inputs=["u0", "u1"]).rows(1, 300)
    with pytest.raises(ExcitationError, match=r"rank 5.*u[01]\(k-[12]\) depend"):
        ARX(na=1, nb=2, offset=True).fit(later)
    with pytest.raises(ExcitationError, match=r"the inputs u1 .* combinations of u0 \(the correlation of u1 and u0 is"):
        ARX(na=1, nb=1, offset=True).fit(data.with_channel("u1", 2 * data["u0"]).select(inputs=["u0", "u1"]))


def test_constant_input_is_named():
    data = record(300).with_channel("u0", np.full(300, 4.0))
    with pytest.raises(ExcitationError, match=r"'u0'.*constant at 4"):
        ARX(na=1, nb=1).fit(data)


def test_fewer_samples_than_parameters():
    with pytest.raises(TooShortError, match="30 samples for 40 parameters"):
        ARX(na=20, nb=20).fit(record(30))
    short = replace(record(120), starts=tuple(range(0, 120, 12)), start_times=tuple(range(0, 1200, 120)))
    with pytest.raises(TooShortError, match="longer than the 12 samples"):
        ARX(na=12, nb=2).fit(short)
    with pytest.raises(TooShortError, match="20 equations for 20 parameters"):
        ARX(na=10, nb=10).fit(short)


@pytest.mark.parametrize(("name", "value"), [("na", 0), ("nb", 0), ("nk", -1)])
def test_orders_that_make_no_sense(name, value):
    with pytest.raises(ParameterError, match=f"{name} is {value}"):
        ARX(**{"na": 1, "nb": 1, name: value})


@pytest.mark.parametrize(
    ("na", "nb", "nk", "nu", "c"), [(1, 1, 1, 1, 0), (4, 2, 1, 1, 0), (2, 5, 3, 1, 1), (3, 1, 1, 2, 0), (3, 2, 2, 3, 2)]
)
def test_filter_free_run_equals_the_loop(na, nb, nk, nu, c):
    rng = np.random.default_rng(na)
    model = ARXModel(
        A=np.poly(0.9 * rng.uniform(-1, 1, na))[1:],
        B=rng.standard_normal((nb, 1, nu)),
        c=[float(c)],
        nk=nk,
        dt=0.1,
        inputs=tuple(f"u{i}" for i in range(nu)),
        outputs=("y0",),
    )
    data = record(900, nu)
    m = model.memory
    x0 = model.initial_state(data.head(m))
    slow = Model.free_run(model, x0, data.u[m - 1 :])
    assert model.free_run(x0, data.u[m - 1 :]) == pytest.approx(slow, rel=1e-10, abs=1e-10 * np.abs(slow).max())


def test_unstable_long_free_run_says_where():
    model = ARXModel(A=[-3.0], B=[1.0], dt=0.1, inputs=("u0",), outputs=("y0",))
    with pytest.raises(SimulationError, match=r"sample 6\d\d \(t = "):
        model.simulate(record(900))


@pytest.mark.parametrize("offset", [False, True])
def test_each_input_has_its_own_delay_and_count(offset):
    """Regressors written down row by row; lags between the inputs' own are exactly zero in the model."""
    data = record(600, nu=3, ny=2, seed=9)
    data = replace(data, starts=(0, 250), start_times=(0.0, 1e3))
    nb, nk = (2, 1, 3), (0, 5, 2)
    model = ARX(na=2, nb=nb, nk=nk, offset=offset).fit(data)
    used = [(0, 0), (1, 0), (2, 2), (3, 2), (4, 2), (5, 1)]
    rows, targets = [], []
    for part in data.experiments:
        y, u = part.y, part.u
        for k in range(5, part.n_samples):
            rows.append(np.concatenate([y[k - 1], y[k - 2], [u[k - j, i] for j, i in used], np.ones(int(offset))]))
            targets.append(y[k])
    phi, target = np.array(rows), np.array(targets)
    scale = np.linalg.norm(phi, axis=0)
    theta = np.linalg.lstsq(phi / scale, target, rcond=None)[0]
    assert model.fit_info.values * np.tile(scale, 2) == pytest.approx(theta.T.ravel(), rel=1e-7, abs=1e-9)
    assert model.fit_info.names[4:10] == tuple(
        f"y0: {n}" for n in ("u0(k)", "u0(k-1)", "u2(k-2)", "u2(k-3)", "u2(k-4)", "u1(k-5)")
    )
    assert (model.nk, model.nb) == (0, 6)
    free = {(j, i) for j in range(6) for i in range(3)} - set(used)
    assert all(not model.B[j, :, i].any() for j, i in free)
    error = model.predict(data).error
    clean = (target - phi / scale @ theta)[1:244]  # with feedthrough the first prediction is one sample later
    assert error[6:249] == pytest.approx(clean, rel=1e-6, abs=1e-9 * np.abs(target).max())
    with pytest.raises(ParameterError, match="nk has 2 entries for the inputs u0, u1, u2"):
        ARX(na=1, nb=1, nk=(1, 2)).fit(data)


def nearly_the_same(digits, lag=0, seed=0):
    """Two inputs of which one is the other times two plus one, to some digits, maybe later."""
    rng = np.random.default_rng(seed)
    u, y = rng.standard_normal(2000), np.zeros(2000)
    w = np.round(2 * np.roll(u, lag) + 1, digits)
    for k in range(1, 2000):
        y[k] = 0.8 * y[k - 1] + 0.9 * u[k - 1] + 0.05 * w[k - 1] + 0.01 * rng.standard_normal()
    return Dataset.from_arrays({"u": u, "w": w}, {"y": y}, 0.1)


@pytest.mark.parametrize(("digits", "lag", "nb"), [(4, 0, 1), (4, 0, 3), (6, 0, 1), (4, 1, 3)])
def test_inputs_that_are_nearly_one_are_named(digits, lag, nb):
    with warnings.catch_warnings(record=True, action="always") as caught:
        model = ARX(na=1, nb=nb, offset=True).fit(nearly_the_same(digits, lag))
    assert {w.category for w in caught} == {IdentifiabilityWarning}
    assert any("do not tell the effect of" in str(w.message) for w in caught)
    assert [str(w.message) for w in caught] == list(model.fit_info.warnings)
    assert 1 <= len(caught) <= 3
    assert any("move alike (correlation +" in str(w.message) for w in caught) == (lag == 0)


@pytest.mark.parametrize("case", ["told apart by their means", "by one digit", "the effect is large", "lags of one"])
def test_inputs_that_can_be_told_apart_are_not(case):
    data, offset, nb = nearly_the_same(1 if case == "by one digit" else 4), True, 1
    if case == "told apart by their means":
        offset = False  # then w has a mean of its own
    if case == "the effect is large":
        y = data["y"] * 1e-6 + np.r_[0.0, (data["w"] - 2 * data["u"] - 1)[:-1]] * 1e4
        data = data.with_channel("y", y)
    if case == "lags of one":
        slow = np.sin(0.001 * np.arange(2000)) + 1e-3 * np.random.default_rng(1).standard_normal(2000)
        data, nb = data.with_channel("u", slow).select(inputs=["u"]), 5
    with warnings.catch_warnings(action="ignore", category=IdentifiabilityWarning):
        said = ARX(na=1, nb=nb, offset=offset).fit(data).fit_info.warnings
    assert not any("do not tell the effect" in sentence for sentence in said)
    assert any("move alike" in s for s in said) == (case in ("by one digit", "the effect is large"))


@pytest.mark.parametrize("settings", [{"nb": 10**9}, {"na": 10**9}, {"nk": 10**9}, {"nb": 201}], ids=str)
def test_more_lags_than_samples_are_refused_before_they_are_counted_out(settings):
    with pytest.raises(TooShortError, match=r"has 200 samples for .* expected"):
        ARX(**{"na": 1, "nb": 1, **settings}).fit(record(200))


@pytest.mark.parametrize("estimator", [NARX, RLS, IntegratedARX])
def test_lags_per_input_may_be_given_where_they_are_the_same(estimator):
    assert estimator(na=2, nb=(3, 3), nk=(1, 1)) == estimator(na=2, nb=3, nk=1)
    with pytest.raises(
        ParameterError, match=rf"^nb is \(3, 1\); expected the same for every input in a {estimator.__name__}"
    ):
        estimator(na=2, nb=(3, 1))


def with_noise(colour, seed, n=1000):
    """An output of two poles plus noise: of the ARX model itself, white on the output, or AR(1) 0.9 on it."""
    rng = np.random.default_rng(seed)
    u, e = rng.standard_normal((2, n))
    poles = [1.0, -1.5, 0.7]
    v = {"its own": lfilter([0.1], poles, e), "output": 0.1 * e, "drift": lfilter([0.1], [1.0, -0.9], e)}[colour]
    return Dataset.from_arrays({"u": u}, {"y": lfilter([0.0, 0.2, 0.1], poles, u) + v}, 0.1)


@pytest.mark.parametrize("colour", ["its own", "output", "drift"])
def test_an_arx_model_says_when_coloured_noise_biases_it(colour):
    said = [ARX(na=2, nb=2).fit(with_noise(colour, seed)).fit_info.warnings for seed in range(40)]
    coloured = [any("the noise of y is coloured" in s for s in sentences) for sentences in said]
    assert sum(coloured) == (0 if colour == "its own" else 40)


@pytest.mark.parametrize("outputs", [1, 2])
def test_many_lags_that_whiten_the_noise_of_an_output_do_not_hide_its_bias(outputs):
    """With 8 lags the residual is white, as a test by its own past goes, and the gain still too small."""

    def said(colour, seed):
        pairs = [with_noise(colour, 10 * seed + i, 3000) for i in range(outputs)]
        names = range(outputs)
        data = Dataset.from_arrays(
            {f"u{i}": pairs[i]["u"] for i in names}, {f"y{i}": pairs[i]["y"] for i in names}, 0.1
        )
        return ARX(na=8, nb=8).fit(join(data.head(1200), data.rows(1200, 3000))).fit_info.warnings

    for colour, times in (("its own", 0), ("output", outputs)):
        for seed in range(15):
            sentences = said(colour, seed)
            assert sum("a free run of the model tells" in s or "is coloured" in s for s in sentences) == times
    assert sum("looks white" in s for seed in range(15) for s in said("output", seed)) > 5


def test_a_loop_around_noise_of_the_equation_is_no_noise_of_the_output():
    """A controller hands the noise on to later inputs; least squares stays unbiased, and nothing is said."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y, u = np.zeros(1500), np.zeros(1500)
        for k in range(2, 1500):
            y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + 0.2 * u[k - 1] + 0.1 * u[k - 2] + 0.1 * rng.standard_normal()
            u[k] = -0.8 * y[k] + rng.standard_normal()
        assert ARX(na=3, nb=3).fit(Dataset.from_arrays({"u": u}, {"y": y}, 0.1)).fit_info.warnings == ()


def test_experiments_too_short_for_the_lags_tell_no_colour():
    data = with_noise("drift", 0)
    short = join(*(data.rows(a, a + 2 + a % 3) for a in range(0, 200, 5)), data.rows(200, 800), data.rows(800, 805))
    assert any("is coloured" in s for s in ARX(na=2, nb=2).fit(short).fit_info.warnings)


def test_the_residual_that_is_looked_at_is_that_of_the_prediction():
    data = record(300, nu=2, ny=2)
    model = ARX(na=2, nb=3, nk=(0, 2), offset=True).fit(data)
    run = model.predict(data)
    predicted = run.error[run.predicted]
    np.testing.assert_allclose(_residual(model, data)[-len(predicted) :], predicted, rtol=1e-9, atol=1e-12)
    assert len(_residual(model, data.head(3))) == 0


def test_rounding_is_not_called_coloured_noise():
    data = with_noise("its own", 0)
    exact = data.with_channel("y", lfilter([0.0, 0.2, 0.1], [1.0, -1.5, 0.7], data["u"]))
    assert ARX(na=2, nb=2).fit(exact).fit_info.warnings == ()
