"""Recursive least squares: equals the batch, tracks, does not wind up, allocates nothing."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.codegen.compiler import compiler, sentence
from slipangle.data.dataset import Dataset
from slipangle.errors import (
    ExcitationError,
    IdentifiabilityWarning,
    MissingColumnError,
    NotFiniteError,
    ParameterError,
    SampleTimeError,
    SimulationError,
)
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.recursive import RLS
from slipangle.identify.linear.recursive_code import Recursion
from slipangle.models.black_box.arx import ARXModel

needs_compiler = pytest.mark.skipif(compiler() is None, reason=sentence())
ORDERS = pytest.mark.parametrize(
    ("na", "nb", "nk", "nu", "ny", "offset"),
    [
        (1, 1, 1, 1, 1, False),
        (1, 1, 0, 1, 1, False),  # no input of the past
        (2, 3, 1, 2, 1, True),
        (3, 1, 2, 1, 2, False),
        (2, 2, 3, 2, 3, True),
        (1, 3, 0, 2, 1, False),
    ],
)


def record(n, nu=1, ny=1, seed=0, noise=0.1):
    """Two experiments of random inputs and filtered outputs, scaled differently."""
    rng = np.random.default_rng(seed)
    u, y = rng.standard_normal((n, nu)), np.zeros((n, ny))
    for k in range(1, n):
        y[k] = 0.7 * y[k - 1] + u[k - 1].sum() * np.arange(1, ny + 1) + 0.3 + noise * rng.standard_normal(ny)
    size = 10.0 ** -np.arange(nu)
    inputs = {f"u{i}": size[i] * u[:, i] for i in range(nu)}
    data = Dataset.from_arrays(inputs, {f"y{i}": y[:, i] for i in range(ny)}, 0.1)
    return replace(data, starts=(0, n // 3), start_times=(0.0, 1e4))


def without_compiler(monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "none")


@pytest.mark.filterwarnings("ignore:the data have a level")  # which is part of what is compared
@ORDERS
@pytest.mark.parametrize("compiled", [True, False], ids=["C", "no compiler"])
def test_without_forgetting_it_is_batch_least_squares(monkeypatch, compiled, na, nb, nk, nu, ny, offset):
    if not compiled:
        without_compiler(monkeypatch)
    data = record(900, nu, ny)
    online = RLS(na=na, nb=nb, nk=nk, offset=offset, forgetting=1.0).fit(data)
    batch = ARX(na=na, nb=nb, nk=nk, offset=offset).fit(data)
    assert online.fit_info.names == batch.fit_info.names
    std = batch.fit_info.std
    size = np.maximum(np.abs(batch.fit_info.values), std)
    assert online.fit_info.values / size == pytest.approx(batch.fit_info.values / size, abs=1e-9)
    assert online.fit_info.noise_std == pytest.approx(batch.fit_info.noise_std, rel=1e-7)
    scale = np.outer(std, std)
    assert online.fit_info.covariance / scale == pytest.approx(batch.fit_info.covariance / scale, abs=1e-6)
    assert online.fit_info.n_samples == batch.fit_info.n_samples
    assert (online.A, online.B) == (pytest.approx(batch.A, rel=1e-7), pytest.approx(batch.B, rel=1e-7))


@needs_compiler
@ORDERS
@pytest.mark.parametrize("forget", ["directional", "everywhere"])
def test_c_equals_the_virtual_machine(monkeypatch, forget, na, nb, nk, nu, ny, offset):
    data = record(400, nu, ny)
    settings = RLS(na=na, nb=nb, nk=nk, offset=offset, forgetting=0.95, forget=forget)
    begin = {"inputs": data.inputs, "outputs": data.outputs, "dt": data.dt}
    fast = settings.start(**begin)
    assert fast._recursion.compiled
    without_compiler(monkeypatch)
    slow = settings.start(**begin)
    assert not slow._recursion.compiled
    one, two = fast.run(data), slow.run(data)
    later = fast.memory + 5 * len(fast.names) // ny
    assert one.theta[later:] == pytest.approx(two.theta[later:], rel=1e-6, abs=1e-8)
    assert one.error[later:] == pytest.approx(two.error[later:], rel=1e-6, abs=1e-8)
    assert fast.covariance == pytest.approx(slow.covariance, rel=1e-6, abs=1e-15)


def test_exponential_forgetting_is_weighted_least_squares():
    data = record(300).rows(100, 300)
    settings = RLS(na=2, nb=2, forgetting=0.95, forget="everywhere", threshold=0.0)
    model = settings.fit(data)
    y, u = data.y[:, 0], data.u[:, 0]
    phi = np.column_stack([y[1:-1], y[:-2], u[1:-1], u[:-2]])
    root = 0.95 ** (0.5 * np.arange(len(phi))[::-1])
    theta = np.linalg.lstsq(phi * root[:, None], y[2:] * root, rcond=None)[0]
    assert model.fit_info.values == pytest.approx(theta, rel=1e-7)


@pytest.mark.parametrize("compiled", [True, False], ids=["C", "no compiler"])
def test_directional_forgetting_follows_its_equation(monkeypatch, compiled):
    """Kulhavy: the variance of the prediction grows by a factor, nothing else is forgotten."""
    if not compiled:
        without_compiler(monkeypatch)
    data = record(200, nu=2).rows(0, 60)
    settings = RLS(na=1, nb=1, forgetting=0.9, threshold=0.0, prior=100.0)
    estimate = settings.start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
    information, theta, widened = np.eye(3) / 100.0, np.zeros(3), 0
    for k in range(data.n_samples):
        estimate.update(data.y[k], data.u[k])
        if k == 0:
            continue
        phi = np.concatenate([data.y[k - 1], data.u[k - 1]])
        r = phi @ np.linalg.solve(information, phi)
        kept = information - (1 - 0.9**3) / r * np.outer(phi, phi)
        assert phi @ np.linalg.solve(kept, phi) == pytest.approx(r / 0.9**3)
        widened += r < 1 - 0.9**3
        information = kept + np.outer(phi, phi)
        theta = theta + np.linalg.solve(information, phi) * (data.y[k, 0] - phi @ theta)
        assert estimate.gram_inverse == pytest.approx(np.linalg.inv(information), rel=1e-9)
        assert estimate.theta == pytest.approx(theta, rel=1e-9)
    assert 5 < widened < 55


def test_both_ways_forget_evenly_excited_data_alike():
    rng = np.random.default_rng(0)
    data = Dataset.from_arrays({"u": rng.standard_normal(20_000)}, {"y": rng.standard_normal(20_000)}, 0.1)
    sizes = []
    for forget in ("directional", "everywhere"):
        estimate = RLS(na=3, nb=3, forgetting=0.99, forget=forget).start(inputs="u", outputs="y", dt=0.1)
        estimate.run(data)
        sizes.append(np.trace(estimate.gram_inverse))
    assert sizes == pytest.approx([0.06, 0.06], rel=0.2)


def test_one_excited_direction_leaves_the_others_alone():
    """A steady bend: constant input and output for long."""
    rng = np.random.default_rng(3)
    u, y = np.concatenate([rng.standard_normal(1000), np.ones(50_000)]), np.zeros(51_000)
    for k in range(1, len(u)):
        y[k] = 0.6 * y[k - 1] + u[k - 1] + 0.01 * rng.standard_normal()
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.1)
    sizes = {}
    for forget in ("directional", "everywhere"):
        estimate = RLS(na=2, nb=2, forgetting=0.99, forget=forget).start(inputs="u", outputs="y", dt=0.1)
        estimate.run(data.rows(0, 1000))
        before = np.trace(estimate.gram_inverse)
        estimate.run(data.rows(1000, 51_000))
        sizes[forget] = np.trace(estimate.gram_inverse) / before
    assert sizes["directional"] < 2
    assert sizes["everywhere"] > 1e4


def test_one_sample_at_a_time_equals_the_run():
    data = record(200, nu=2, ny=2)
    settings = RLS(na=2, nb=1, offset=True, forgetting=0.98)
    begin = {"inputs": data.inputs, "outputs": data.outputs, "dt": data.dt}
    one, many = settings.start(**begin), settings.start(**begin)
    run = many.run(data)
    for part, start in zip(data.experiments, data.starts, strict=True):
        one.restart()
        for k in range(part.n_samples):
            error = one.update(part.y[k], part.u[k])
            assert np.array_equal(error, run.error[start + k])
            assert np.array_equal(one.theta, run.theta[start + k])
    assert run.names[0] == "y0: y0(k-1)"
    assert np.array_equal(run.parameter("y1: 1"), run.theta[:, -1])
    with pytest.raises(ParameterError, match="nearest are 'y1: 1'"):
        run.parameter("y1: 11")


def drifting(n, rng, noise=0.05):
    """One pole that wanders from 0.5 to 0.9 and a gain that jumps half-way."""
    a, b = np.linspace(0.5, 0.9, n), np.where(np.arange(n) < n // 2, 1.0, 2.0)
    u, y = rng.standard_normal(n), np.zeros(n)
    for k in range(1, n):
        y[k] = a[k] * y[k - 1] + b[k] * u[k - 1] + noise * rng.standard_normal()
    return Dataset.from_arrays({"u": u}, {"y": y}, 0.1), a, b


@pytest.mark.parametrize("forget", ["directional", "everywhere"])
def test_tracks_a_drift_and_a_jump(forget):
    data, a, b = drifting(4000, np.random.default_rng(1))
    settings = RLS(na=1, nb=1, forgetting=0.97, forget=forget)
    run = settings.start(inputs=("u",), outputs=("y",), dt=0.1).run(data)
    settled = np.r_[200:2000, 2200:4000]
    assert np.abs(run.parameter("y(k-1)") - a)[settled].max() < 0.08
    assert np.abs(run.parameter("u(k-1)") - b)[settled].max() < 0.08
    still = RLS(na=1, nb=1, forgetting=1.0).start(inputs=("u",), outputs=("y",), dt=0.1).run(data)
    assert np.abs(still.parameter("u(k-1)") - b)[-100:].max() > 0.3


def straight_road(noise, seed=2, n=100_000):
    """Bends, then a long straight road with sensor noise only, then bends again."""
    rng = np.random.default_rng(seed)
    u = np.concatenate([rng.standard_normal(2000), np.zeros(n), rng.standard_normal(500)])
    y = np.zeros(len(u))
    for k in range(2, len(u)):
        y[k] = 1.5 * y[k - 1] - 0.7 * y[k - 2] + u[k - 1] + 0.5 * u[k - 2]
    u += noise * rng.standard_normal(len(u))
    y += noise * rng.standard_normal(len(u))
    return Dataset.from_arrays({"u": u}, {"y": y}, 0.1)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_no_wind_up_on_a_straight_road(noise):
    data = straight_road(noise)
    before, after = data.rows(0, 2000), data.rows(2000, data.n_samples)
    settings = RLS(na=2, nb=2, forgetting=0.99)
    estimate = settings.start(inputs=("u",), outputs=("y",), dt=0.1)
    estimate.run(before)
    known, size = estimate.theta, np.trace(estimate.gram_inverse)
    run = estimate.run(after)
    assert np.trace(estimate.gram_inverse) < 2 * size
    assert np.abs(run.theta - known).max() < 0.02
    assert np.abs(run.error[-500:]).max() < 0.1
    bare = replace(settings, forget="everywhere", threshold=0.0)
    wound = bare.start(inputs=("u",), outputs=("y",), dt=0.1)
    wound.run(before)
    wound.run(after.rows(0, 90_000))
    assert np.trace(wound.gram_inverse) > 1e3 * size  # what the protection is for
    if noise:
        assert np.abs(wound.theta - known).max() > 0.5


def test_covariance_never_passes_the_prior():
    """Excitation that fades away slowly, so that forgetting goes on and on."""
    n, rng = 100_000, np.random.default_rng(0)
    fading = 10.0 ** np.linspace(0, -12, n)
    data = Dataset.from_arrays({"u": fading * rng.standard_normal(n)}, {"y": fading * rng.standard_normal(n)}, 0.1)
    for forget in ("directional", "everywhere"):
        estimate = RLS(na=2, nb=2, forgetting=0.98, forget=forget, prior=1e4, threshold=0.0).start(
            inputs=("u",), outputs=("y",), dt=0.1
        )
        for part in range(10):
            estimate.run(data.rows(part * n // 10, (part + 1) * n // 10))
            assert np.trace(estimate.gram_inverse) <= 4e4 * (1 + 1e-6)
            assert np.linalg.eigvalsh(estimate.gram_inverse)[0] > 0
        assert np.trace(estimate.gram_inverse) > 1e4


def test_a_million_samples_keep_the_covariance_positive():
    rng = np.random.default_rng(4)
    n = 300_000
    t = np.arange(n)
    u = np.sin(0.01 * t) + 1e-4 * rng.standard_normal(n)  # lags that are nearly alike
    data = Dataset.from_arrays({"u": u}, {"y": np.roll(u, 1) + 1e-4 * rng.standard_normal(n)}, 0.1)
    estimate = RLS(na=3, nb=3, forgetting=0.999).start(inputs=("u",), outputs=("y",), dt=0.1)
    run = estimate.run(data)
    assert np.isfinite(run.theta).all()
    assert np.linalg.eigvalsh(estimate.gram_inverse)[0] > 0
    assert np.std(run.error[1000:]) < 3e-4


def test_follows_a_batch_model_exactly():
    data = record(1200, nu=2, ny=2)
    first, rest = replace(data, starts=(0,), start_times=(0.0,)).split(0.5)
    settings = RLS(na=2, nb=1, offset=True, forgetting=1.0)
    start = ARX(na=2, nb=1, offset=True).fit(first)
    estimate = settings.follow(start)
    assert estimate.theta == pytest.approx(start.fit_info.values)
    assert estimate.gram_inverse == pytest.approx(start.fit_info.covariance[:7, :7] / start.fit_info.noise_std[0] ** 2)
    estimate.run(rest)
    both = Dataset(
        values=data.values,
        channels=data.channels,
        dt=data.dt,
        inputs=data.inputs,
        outputs=data.outputs,
        starts=(0, first.n_samples),
        start_times=(0.0, 1e3),
    )
    batch = ARX(na=2, nb=1, offset=True).fit(both)
    assert estimate.theta == pytest.approx(batch.fit_info.values, abs=1e-9)
    assert np.sqrt(np.diag(estimate.noise_covariance)) == pytest.approx(batch.fit_info.noise_std, rel=0.02)
    plain = settings.follow(replace(start, fit_info=None))
    assert plain.gram_inverse == pytest.approx(1e12 * np.eye(7))


def test_the_covariance_is_what_the_estimates_scatter_by():
    true = np.array([0.8, 0.5])
    errors = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        u, y = rng.standard_normal(400), np.zeros(400)
        for k in range(1, 400):
            y[k] = true[0] * y[k - 1] + true[1] * u[k - 1] + 0.2 * rng.standard_normal()
        info = RLS(na=1, nb=1, forgetting=1.0).fit(Dataset.from_arrays({"u": u}, {"y": y}, 1.0)).fit_info
        errors.append((info.values - true) / info.std)
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx([1.0, 1.0], abs=0.25)


def scattered(settings, n, seeds, excited):
    """Errors of the estimates of white data, over the standard deviations that are said; noise as said."""
    true, errors, noise = np.array([1.5, -0.7, 0.5, 0.3]), [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        u, e = excited(np.arange(n)) * rng.standard_normal(n), 0.1 * rng.standard_normal(n)
        y = lfilter([0, 0.5, 0.3], [1, -1.5, 0.7], u) + lfilter([1], [1, -1.5, 0.7], e)
        estimate = settings.start(inputs="u", outputs="y", dt=0.1)
        estimate.run(Dataset.from_arrays({"u": u}, {"y": y}, 0.1))
        errors.append((estimate.theta - true) / np.sqrt(np.diag(estimate.covariance)))
        noise.append(estimate.noise_covariance[0, 0])
    return np.array(errors), np.mean(noise)


def bends(k):
    """Bends and straights."""
    return np.where(k // 100 % 2, 0.05, 1.0)


@pytest.mark.parametrize(
    ("forgetting", "n", "excited", "forget"),
    [
        (1.0, 300, np.ones_like, "directional"),
        (0.98, 400, np.ones_like, "everywhere"),
        (0.98, 60, np.ones_like, "directional"),  # hardly anything is forgotten yet
        (0.98, 450, bends, "directional"),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                (1.0, 300, np.ones_like, "everywhere"),
                (0.995, 700, np.ones_like, "directional"),
                (0.995, 700, np.ones_like, "everywhere"),
                (0.98, 400, np.ones_like, "directional"),
                (0.98, 60, np.ones_like, "everywhere"),
                (0.98, 450, bends, "everywhere"),
            )
        ),
    ],
)
def test_intervals_hold_what_they_say_with_forgetting_too(forgetting, n, excited, forget):
    """Of 95 % intervals over 500 records 93 to 97 % hold the truth; the noise is said within a few percent."""
    settings = RLS(na=2, nb=2, forgetting=forgetting, forget=forget)
    errors, noise = scattered(settings, n, 500, excited)
    assert 0.93 <= np.mean(np.abs(errors) < 1.96) <= 0.97
    assert noise == pytest.approx(0.01, rel=0.04)


@pytest.mark.parametrize("forgetting", [0.97, 1.0])
def test_the_scatter_of_exponential_forgetting_is_that_of_its_weights(forgetting):
    """Weighted least squares by its formula: the weights of the errors enter squared."""
    data = record(200).rows(70, 200)
    settings = RLS(na=2, nb=2, forgetting=forgetting, forget="everywhere", threshold=0.0)
    estimate = settings.start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
    estimate.run(data)
    y, u = data.y[:, 0], data.u[:, 0]
    phi = np.column_stack([y[1:-1], y[:-2], u[1:-1], u[:-2]])
    weight = forgetting ** np.arange(len(phi))[::-1]
    inverse = np.linalg.inv(phi.T @ (weight[:, None] * phi))
    wanted = inverse @ phi.T @ (weight[:, None] ** 2 * phi) @ inverse
    assert estimate.gram_inverse == pytest.approx(inverse, rel=1e-6)
    assert estimate.covariance == pytest.approx(estimate.noise_covariance[0, 0] * wanted, rel=1e-6)


def test_what_was_never_excited_is_as_uncertain_as_at_the_start():
    """Where rounding is larger than what is known, no variance passes the prior or is negative."""
    rng = np.random.default_rng(0)
    twice = rng.standard_normal(3000)
    data = Dataset.from_arrays({"u": 1e4 * twice, "v": 1e4 * twice}, {"y": 1e4 * rng.standard_normal(3000)}, 0.1)
    for forget in ("directional", "everywhere"):
        estimate = RLS(na=1, nb=1, forgetting=0.995, forget=forget).start(inputs=("u", "v"), outputs="y", dt=0.1)
        estimate.run(data)
        at_most = estimate.noise_covariance[0, 0] * estimate.gram_inverse
        assert np.linalg.eigvalsh(estimate.covariance)[0] > -1e-9 * np.trace(at_most)
        assert (np.diag(estimate.covariance) <= np.diag(at_most) * (1 + 1e-9)).all()
        if forget == "directional":  # the other forgets nothing as long as a variance is at its bound
            assert estimate.covariance[0, 0] == pytest.approx(at_most[0, 0] / 1.995, rel=0.05)


@pytest.mark.parametrize("compiled", [True, False], ids=["C", "no compiler"])
def test_a_huge_sample_is_said_and_does_no_harm(monkeypatch, compiled):
    """The estimate is as before, goes on after as many samples as the lags take, and a run says where it stopped."""
    if not compiled:
        without_compiler(monkeypatch)
    data = record(400)
    estimate = RLS(na=2, nb=2).start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
    for k in range(100):
        estimate.update(data.y[k], data.u[k])
    for bad in ((1e154, 1.0), (1.0, -1e13), (1e300, 1e300)):
        known, noise, count = estimate.theta, estimate.noise_covariance, estimate.n_samples
        with pytest.raises(SimulationError, match=r"out of the finite numbers; expected measurements, at most 1e\+12"):
            estimate.update(*bad)
        assert np.array_equal(estimate.theta, known)
        assert np.array_equal(estimate.noise_covariance, noise)
        for k in range(140, 150):
            estimate.update(data.y[k], data.u[k])
        assert estimate.n_samples == count + 8
        assert not np.array_equal(estimate.theta, known)
    y = data["y0"].copy()
    y[300] = 1e200
    fresh = RLS(na=2, nb=2).start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
    with pytest.raises(SimulationError, match=r"sample 300 of 'data' holds y = \[1e\+200\]"):
        fresh.run(data.with_channel("y0", y))
    before = RLS(na=2, nb=2).start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
    before.run(data.rows(0, 300))
    assert np.array_equal(fresh.theta, before.theta)


def test_a_state_that_would_not_be_finite_is_refused(monkeypatch):
    """Numbers a channel can read, of a prior that none has."""
    for compiled in (True, False):
        if not compiled:
            without_compiler(monkeypatch)
        estimate = RLS(na=1, nb=1, prior=1e290, forgetting=1.0).start(inputs="u", outputs="y", dt=0.1)
        with pytest.raises(SimulationError, match="takes the estimate out of the finite numbers"):
            estimate.run(Dataset.from_arrays({"u": np.full(4, 1e11)}, {"y": np.full(4, 1e11)}, 0.1))
        assert np.isfinite(estimate.theta).all()
        assert np.isfinite(estimate.covariance).all()


@needs_compiler
def test_update_allocates_nothing():
    estimate = RLS(na=2, nb=2, forgetting=0.99).start(inputs=("u",), outputs=("y",), dt=0.1)
    y = np.random.default_rng(0).standard_normal((3000, 1))
    rows = list(y)
    for k in range(1000):
        estimate.update(rows[k], rows[k])
    tracemalloc.start()
    try:
        for k in range(1000, 2000):
            estimate.update(rows[k], rows[k])
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for k in range(2000, 3000):
            estimate.update(rows[k], rows[k])
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 200
    assert peak - before < 600  # a few numbers on their way to C, none kept


def test_bad_input_says_what_to_do():
    for bad, match in (
        ({"na": 0}, "na is 0"),
        ({"forgetting": 0.0}, r"forgetting is 0\.0; expected a number above 0"),
        ({"forgetting": 1.2}, "forgetting is 1.2"),
        ({"forget": "direction"}, "nearest are 'directional'"),
        ({"threshold": -1.0}, "threshold is -1.0"),
        ({"prior": 0.0}, "prior is 0.0; expected positive variances"),
    ):
        with pytest.raises(ParameterError, match=match):
            RLS(**({"na": 2, "nb": 2} | bad))
    settings = RLS(na=2, nb=2)
    with pytest.raises(ParameterError, match=r"prior has 2 variances; expected one, or 4.*y\(k-1\)"):
        replace(settings, prior=(1.0, 2.0)).start(inputs="u", outputs="y", dt=0.1)
    with pytest.raises(ParameterError, match="inputs are \\[\\]"):
        settings.start(inputs=(), outputs="y", dt=0.1)
    with pytest.raises(ParameterError, match="sample time is 0"):
        settings.start(inputs="u", outputs="y", dt=0)
    model = ARXModel(A=[-0.5], B=[1.0], dt=0.1, inputs=("u",), outputs=("y",))
    with pytest.raises(ParameterError, match=r"na, nb, nk = \(1, 1, 1\); expected \(2, 2, 1\)"):
        settings.follow(model)
    estimate = RLS(na=1, nb=1).start(inputs=("a", "b"), outputs="y", dt=0.1)
    with pytest.raises(ParameterError, match="a sample has 1 inputs; expected 2: a, b"):
        estimate.update(1.0, 2.0)
    single = RLS(na=1, nb=1).start(inputs="a", outputs="y", dt=0.1)
    for bad in (("a", 0.1), (0.1, "b"), ({}, 0.1)):
        with pytest.raises(ParameterError, match=r"the sample holds y = .*; expected numbers: one for each of y, a"):
            single.update(*bad)
    assert single.theta.shape == (2,) == (len(single.names),)
    assert single.theta.base is None  # a copy
    data = record(50)
    with pytest.raises(MissingColumnError, match="'a'"):
        estimate.run(data)
    with pytest.raises(SampleTimeError):
        estimate.run(replace(data, dt=0.2))


def test_what_the_samples_do_not_determine_is_named():
    data = record(300)
    twice = data.with_channel("v", -2 * data["u0"]).select(inputs=("u0", "v"))
    with pytest.raises(ExcitationError, match="v of 'data' are linear combinations of u0"):
        RLS(na=1, nb=1).fit(twice)
    estimate = RLS(na=1, nb=1).start(inputs=("u0", "v"), outputs="y0", dt=0.1)
    estimate.run(twice)
    assert "do not determine the coefficients of u0(k-1), v(k-1):" in estimate.model().fit_info.warnings[0]
    sine = Dataset.from_arrays({"u": np.sin(np.arange(200.0))}, {"y": np.cos(np.arange(200.0))}, 0.1)
    with pytest.warns(IdentifiabilityWarning, match="do not determine"):
        RLS(na=2, nb=2).fit(sine)
    assert RLS(na=1, nb=1, offset=True).fit(data).fit_info.warnings == ()


def test_a_sample_that_is_not_finite_changes_nothing():
    data = record(60)
    estimate = RLS(na=2, nb=2).start(inputs=data.inputs, outputs=data.outputs, dt=data.dt)
    estimate.run(data)
    known, lags = estimate.theta, estimate._recursion.arrays["past_y"].copy()
    with pytest.raises(NotFiniteError, match=r"y = nan.*restart\(\)"):
        estimate.update(np.nan, 1.0)
    assert np.array_equal(estimate.theta, known)
    assert np.array_equal(estimate._recursion.arrays["past_y"], lags)


def test_arrays_are_made_once():
    estimate = RLS(na=2, nb=2).start(inputs="u", outputs="y", dt=0.1)
    held = estimate._recursion
    assert isinstance(held, Recursion)
    places = {name: array.ctypes.data for name, array in held.arrays.items()}
    for k in range(20):
        estimate.update(np.sin(k), np.cos(k * k))
    assert estimate.n_samples > 0
    assert np.any(estimate.theta)
    assert {name: array.ctypes.data for name, array in held.arrays.items()} == places
    assert held.theta.ctypes.data == places["theta"]
