"""Friction curves: exact derivatives, recovery of known curves, intervals that cover, bad input."""

import warnings

import casadi as ca
import numpy as np
import pytest
from scipy.stats import t as student

from slipangle.errors import (
    ExcitationError,
    IdentifiabilityWarning,
    NotFiniteError,
    ParameterError,
    TooShortError,
    UnitError,
)
from slipangle.identify.tires.architecture import ArchitectureSearch
from slipangle.identify.tires.curves import (
    SOUSA_TABLE_6_7,
    MagicCurveFit,
    MLPCurveFit,
    RBFCurveFit,
    magic_regression,
)
from slipangle.models.black_box.networks import MLP, RBF
from slipangle.models.tires.simple import MagicCurve
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2, SOUSA_TABLE_6_8
from slipangle.numerics.multistart import (
    Effort,
    Optimum,
    Regression,
    covariance,
    fixed_cost,
    multistart,
    profile_interval,
)

SLIP = np.linspace(-1, 1, 200)
MU_X = SOUSA_TABLE_6_2.longitudinal(SLIP)
NAMES = ("B", "C", "D", "E", "S_h", "S_v")
QUICK = Effort(starts=6, carried=2, polish=60, finish=60)


def rig(curve, *, reach=0.21, n=322, noise=0.02, seed=0):
    slip = np.linspace(-reach, reach, n)
    return slip, curve(slip) + noise * np.random.default_rng(seed).standard_normal(n)


def regression(n_outputs=1, weight=1.0):
    x, theta = ca.SX.sym("x", 2), ca.SX.sym("theta", 3)
    y = ca.vertcat(theta[0] * ca.tanh(theta[1] * x[0]) + theta[2] * x[1] ** 2, ca.exp(theta[1] * x[1]) * theta[0])
    rng = np.random.default_rng(0)
    return Regression(
        y[:n_outputs],
        x,
        theta,
        samples=rng.normal(size=(40, 2)),
        target=rng.normal(size=(40, n_outputs)),
        weight=weight,
    )


@pytest.mark.parametrize("n_outputs", [1, 2])
def test_jacobian_is_the_derivative_of_the_residual(n_outputs):
    problem = regression(n_outputs, np.linspace(0.5, 2, n_outputs))
    theta = np.array([0.7, -0.4, 1.3])
    exact = problem.jacobian(theta)
    for j in range(3):
        h = np.eye(3)[j] * 1e-6
        difference = (problem.residual(theta + h) - problem.residual(theta - h)) / 2e-6
        assert exact[:, j] == pytest.approx(difference, abs=1e-8)


def test_compression_keeps_cost_gradient_and_curvature():
    problem = regression(2)
    theta = np.array([0.7, -0.4, 1.3])
    f, j = problem.residual(theta), problem.jacobian(theta)
    g, k = problem.compressed(theta)
    assert len(g) == 4
    assert g @ g == pytest.approx(f @ f)
    assert k.T @ g == pytest.approx(j.T @ f)
    assert k.T @ k == pytest.approx(j.T @ j)


def test_covariance_of_a_linear_problem_is_the_textbook_one():
    rng = np.random.default_rng(1)
    j, e = rng.normal(size=(50, 3)), rng.normal(size=50)
    got = covariance(Optimum(np.zeros(3), e, j, float(e @ e), np.array([1.0]), 1, True, np.zeros((1, 3))))
    assert got == pytest.approx(np.linalg.inv(j.T @ j) * (e @ e) / 47)


@pytest.mark.parametrize("name", ["longitudinal", "lateral"])
@pytest.mark.parametrize("seed", range(3))
def test_magic_curve_is_recovered_without_noise(name, seed):
    true = getattr(SOUSA_TABLE_6_8, name)
    slip, mu = rig(true, noise=0.0)
    found = MagicCurveFit(seed=seed).fit(slip, mu)
    assert [getattr(found, n) for n in NAMES] == pytest.approx([getattr(true, n) for n in NAMES], rel=1e-5, abs=1e-6)


def test_signs_of_the_rig_give_the_same_curve():
    """Negative B and C together, as in table 6.8, are the same curve as positive ones."""
    sae = MagicCurve(B=-10.8138, C=-1.6192, D=2.7166, E=0.4118, S_h=-0.0036, S_v=0.0694)
    slip, mu = rig(sae, noise=0.0)
    found = MagicCurveFit(lower=SOUSA_TABLE_6_7[0], upper=SOUSA_TABLE_6_7[1]).fit(slip, mu)
    assert (found.B, found.C, found.D) == pytest.approx((10.8138, 1.6192, 2.7166), rel=1e-5)
    assert found(slip) == pytest.approx(mu, abs=1e-7)


def test_a_falling_curve_has_negative_d():
    slip, mu = rig(MagicCurve(B=12.0, C=1.5, D=-1.3), noise=0.0)
    found = MagicCurveFit().fit(slip, mu)
    assert found.B > 0
    assert found.C > 0
    assert pytest.approx(-1.3, rel=1e-5) == found.D


@pytest.mark.parametrize("name", ["longitudinal", pytest.param("lateral", marks=pytest.mark.slow)])
def test_intervals_cover_at_their_level(name):
    """A value lies in its profile interval when holding it there costs little enough."""
    true = getattr(SOUSA_TABLE_6_8, name)
    truth = np.array([getattr(true, n) for n in NAMES])
    lower, upper = (np.array([getattr(c, n) for n in NAMES]) for c in SOUSA_TABLE_6_7)
    fit = MagicCurveFit(effort=QUICK, level=None)
    inside = np.zeros(6)
    for seed in range(24):
        slip, mu = rig(true, noise=0.124 if name == "longitudinal" else 0.063, seed=seed)
        problem = magic_regression(slip[:, None], mu[:, None])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            found = fit.fit(slip, mu).fit_info.values
        best = float(np.sum(problem.residual(found) ** 2))
        limit = student.ppf(0.975, 316) ** 2 * best / 316
        for k in range(6):
            inside[k] += fixed_cost(problem, found, lower, upper, k, truth[k])[0] - best <= limit
    assert np.all(inside >= 18)  # of 24 at 95 %: fewer have a chance of 1e-4 per coefficient


def test_profile_interval_ends_where_the_cost_says():
    slip, mu = rig(SOUSA_TABLE_6_8.longitudinal, noise=0.05)
    curve = MagicCurveFit().fit(slip, mu)
    problem = magic_regression(slip[:, None], mu[:, None])
    lower, upper = (np.array([getattr(c, n) for n in NAMES]) for c in SOUSA_TABLE_6_7)
    best = curve.fit_info.values
    cost = float(np.sum(problem.residual(best) ** 2))
    limit = student.ppf(0.975, len(slip) - 6)
    for k in range(6):
        for end in curve.fit_info.interval()[k]:
            rise = fixed_cost(problem, best, lower, upper, k, end)[0] - cost
            assert np.sqrt(rise / (cost / (len(slip) - 6))) == pytest.approx(limit, rel=0.03)


def test_profile_of_a_linear_parameter_is_the_textbook_interval():
    x, theta = ca.SX.sym("x"), ca.SX.sym("theta", 2)
    samples = np.linspace(-1, 1, 30)[:, None]
    target = 2 * samples + 1 + 0.1 * np.random.default_rng(0).standard_normal((30, 1))
    problem = Regression(theta[0] * x + theta[1], x, theta, samples=samples, target=target)
    lower, upper = np.full(2, -10.0), np.full(2, 10.0)
    solution = multistart(problem, lower, upper, np.zeros((1, 2)), QUICK)
    std = np.sqrt(np.diag(covariance(solution)))
    for k in range(2):
        expected = solution.theta[k] + student.ppf(0.975, 28) * std[k] * np.array([-1, 1])
        assert profile_interval(problem, solution, lower, upper, k) == pytest.approx(expected, rel=2e-3)


def test_ipopt_agrees_with_least_squares():
    slip, mu = rig(SOUSA_TABLE_6_8.longitudinal)
    ours = MagicCurveFit(level=None).fit(slip, mu)
    few = Effort(starts=6, polish=300)
    reference = MagicCurveFit(solver="ipopt", effort=few, level=None).fit(slip, mu)
    assert [getattr(reference, n) for n in NAMES] == pytest.approx([getattr(ours, n) for n in NAMES], rel=1e-3)
    net = RBFCurveFit(neurons=2, solver="ipopt", effort=few).fit(SLIP, MU_X)
    assert net.fit_info.noise_std[0] == pytest.approx(
        RBFCurveFit(neurons=2).fit(SLIP, MU_X).fit_info.noise_std[0], rel=1e-3
    )


@pytest.mark.parametrize(
    ("fit", "limit"),
    [
        (RBFCurveFit(neurons=1), 0.7055),
        (RBFCurveFit(neurons=2), 0.1289),
        (MLPCurveFit(hidden=(1, 1)), 0.1628),
        (MLPCurveFit(hidden=(2, 2)), 0.0155),
    ],
    ids=lambda v: getattr(v, "label", ""),
)
@pytest.mark.parametrize("seed", [0, 7])
def test_networks_reach_the_printed_rmse(fit, limit, seed):
    curve = type(fit)(**{**{k: getattr(fit, k) for k in fit.__dataclass_fields__}, "seed": seed}).fit(SLIP, MU_X)
    error = curve(SLIP) - MU_X
    assert np.sqrt(np.mean(error**2)) <= limit
    assert curve.fit_info.noise_std[0] == pytest.approx(np.sqrt(np.mean(error**2)))


def test_bounds_are_kept():
    rbf = RBFCurveFit(neurons=3, effort=QUICK).fit(SLIP, MU_X).network
    mlp = MLPCurveFit(hidden=(2, 2), effort=QUICK).fit(SLIP, MU_X).network
    assert isinstance(rbf, RBF)
    assert isinstance(mlp, MLP)
    assert np.abs(rbf.centres).max() <= 1
    assert rbf.widths.min() >= 0.01
    assert rbf.widths.max() <= 7
    assert np.abs(rbf.weights).max() <= 80
    assert np.abs(mlp.parameters).max() <= 4


@pytest.mark.parametrize("kernel", ["gaussian", "cubic", "thin plate", "multiquadric"])
def test_every_kernel_follows_a_tire_curve(kernel):
    curve = RBFCurveFit(neurons=4, kernel=kernel, effort=QUICK).fit(SLIP, MU_X)
    assert curve.fit_info.noise_std[0] < (0.2 if kernel == "cubic" else 0.12)  # the cubic has no width


def test_load_as_an_input():
    rng = np.random.default_rng(0)
    slip, load = rng.uniform(-0.3, 0.3, 400), rng.uniform(1000, 6000, 400)
    mu = (1.3 - 0.08 * load / 1000) * np.sin(1.5 * np.arctan(12 * slip))
    curve = MLPCurveFit(hidden=(3, 3), effort=QUICK).fit(slip, mu, load=load)
    assert curve.inputs == ("slip", "load")
    assert np.sqrt(np.mean((curve(slip, load) - mu) ** 2)) < 0.01
    alone = MLPCurveFit(hidden=(3, 3), effort=QUICK).fit(slip, mu)
    assert np.sqrt(np.mean((alone(slip) - mu) ** 2)) > 0.05


def test_search_takes_the_smallest_that_is_good_enough():
    slip, mu = rig(MagicCurve(B=10.0, C=1.3, D=1.2), noise=0.05, n=160)
    candidates = [MLPCurveFit(hidden=h, effort=QUICK) for h in ((3, 3), (1, 1), (2, 2))] + [
        RBFCurveFit(neurons=1, effort=QUICK)
    ]
    result = ArchitectureSearch(candidates=tuple(candidates), tolerance=0.05, folds=3).fit(slip, mu)
    assert [c.n_parameters for c in result.candidates] == [3, 6, 13, 22]
    best = min(c.rmse for c in result.candidates)
    assert result.chosen.rmse <= 1.05 * best
    assert all(c.rmse > 1.05 * best for c in result.candidates if c.n_parameters < result.chosen.n_parameters)
    assert result.candidates[0].rmse > 0.2  # one radial function is no tire
    assert result.chosen.fit.label == "MLP {1 1}"
    generous = ArchitectureSearch(candidates=tuple(candidates), enough=10.0, folds=2).fit(slip, mu)
    assert generous.chosen.n_parameters == 3


def test_same_seed_same_curve():
    a, b = (MLPCurveFit(hidden=(2, 2), seed=5, effort=QUICK).fit(SLIP, MU_X) for _ in range(2))
    assert np.array_equal(a.network.parameters, b.network.parameters)


def test_undetermined_coefficients_are_named():
    slip = np.linspace(-0.02, 0.02, 60)
    mu = 20 * slip + 0.01 * np.random.default_rng(0).standard_normal(60)
    with pytest.warns(IdentifiabilityWarning) as said:
        MagicCurveFit(effort=QUICK).fit(slip, mu)
    assert any("do not determine" in str(w.message) for w in said)


@pytest.mark.parametrize(
    ("slip", "mu", "error", "message"),
    [
        (np.linspace(0, 0.2, 50), np.ones(50), ExcitationError, "one side of zero only; expected both signs"),
        (np.linspace(-10, 10, 50), np.ones(50), UnitError, "slip reaches 10; expected a ratio or radians"),
        (np.linspace(-1, 1, 50), np.linspace(-4e3, 4e3, 50), UnitError, "friction reaches 4000"),
        (np.linspace(-1, 1, 50), np.ones(49), ParameterError, "50 samples of slip and 49 of friction"),
        (np.linspace(-1, 1, 5), np.ones(5), TooShortError, "5 samples cannot determine 6 parameters"),
        (np.linspace(-1, 1, 50), np.full(50, np.nan), NotFiniteError, "NaN"),
    ],
)
def test_bad_data_get_one_sentence(slip, mu, error, message):
    with pytest.raises(error, match=message):
        MagicCurveFit().fit(slip, mu)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: RBFCurveFit(neurons=0), "neurons is 0"),
        (lambda: MLPCurveFit(hidden=()), "at least one layer"),
        (lambda: MLPCurveFit(hidden=(2,), weight=(1, -1)), "the lower one first"),
        (lambda: Effort(starts=0), "starts is 0"),
        (lambda: ArchitectureSearch(candidates=()), "no candidate"),
        (lambda: MagicCurveFit().fit(SLIP, MU_X, load=np.ones(200)), "depends on slip alone"),
        (lambda: RBFCurveFit(neurons=1, solver="adam").fit(SLIP, MU_X), "solver is 'adam'; there are"),
    ],
)
def test_bad_settings_get_one_sentence(make, message):
    with pytest.raises(ParameterError, match=message):
        make()


def test_constant_load_is_no_input():
    with pytest.raises(ExcitationError, match="leave it out"):
        RBFCurveFit(neurons=1).fit(SLIP, MU_X, load=np.full(200, 5e3))
