"""Free-run fits of nonlinear models: exact derivatives, recovered parameters, honest refusals."""

import casadi as ca
import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.lure.lure import Lure
from slipangle.identify.lure.starts import unit_states
from slipangle.identify.physics.free_run import FreeRun, FreeRunPoint
from slipangle.models.black_box.lure import LureModel

TRUE = LureModel(
    A=[[0.95, 0.25], [-0.25, 0.9]],
    B=[[0.1], [0.4]],
    C=[[1.0, 0.2]],
    D=[[0.0]],
    W=[[0.9, 0.3]],
    V=[[0.0]],
    E=[[0.0], [-0.3]],
    u_offset=[0.0],
    y_offset=[0.0],
    dt=0.1,
    inputs=("u",),
    outputs=("y",),
)


def record(n, seed, noise=0.0):
    rng = np.random.default_rng(seed)
    u = 1.5 * np.repeat(rng.standard_normal(-(-n // 3)), 3)[:n]
    data = Dataset.from_arrays({"u": u}, {"y": np.zeros(n)}, 0.1)
    x, y = rng.standard_normal(2), np.empty(n)
    for k in range(n):
        y[k] = TRUE.output(x, u[k : k + 1])[0] + noise * rng.standard_normal()
        x = TRUE.step(x, u[k : k + 1])
    return data.with_channel("y", y)


def problem(free_x0=(0, 1), prior=None):
    data = join(record(60, 1), record(40, 2))

    def step(x, u, p):
        return ca.vertcat(p[0] * x[0] + p[1] * ca.tanh(x[1]), p[2] * x[1] + u[0])

    return FreeRun(
        step,
        lambda x, u, p: ca.vertcat(x[0] + p[3] * u[0]),
        n_states=2,
        n_parameters=4,
        records=[(part.u, part.y) for part in data.experiments],
        error=np.array([0.7]),
        free_x0=free_x0,
        prior=prior,
    )


@pytest.mark.parametrize("prior", [None, (np.array([0.8, 0.2, 0.5, 0.0]), np.array([0.1, np.inf, 1.0, 0.3]))])
@pytest.mark.parametrize("free_x0", [(), (1,), (0, 1)])
def test_gradient_matches_finite_differences(free_x0, prior):
    fit = problem(free_x0, prior)
    p = np.array([0.8, 0.3, 0.6, 0.1])
    start = FreeRunPoint(p=p, x0=np.array([[0.3, -0.2], [0.1, 0.5]]))
    work = fit.linearise(start)
    if free_x0:  # at the best initial states their own gradient vanishes
        for _ in range(15):
            moved = start.x0.copy()
            moved[:, list(free_x0)] += work.solve_locals(np.zeros(4))
            start = FreeRunPoint(p=p, x0=moved)
            work = fit.linearise(start)
    gradient = -2 * work.shared[:, :4].T @ work.shared[:, 4]
    for i in range(4):
        h = 1e-6 * np.eye(4)[i]
        ahead, back = (fit.cost(FreeRunPoint(p=p + s * h, x0=start.x0)) for s in (1, -1))
        assert gradient[i] == pytest.approx((ahead - back) / 2e-6, rel=1e-5, abs=1e-5 * np.abs(gradient).max())


def test_prior_holds_what_the_data_do_not_tell():
    fit = problem(prior=(np.array([0.5, 0.1, 0.5, 0.25]), np.array([np.inf, np.inf, np.inf, 1e-6])))
    found = fit.fit(np.array([0.8, 0.3, 0.6, 0.2]), np.zeros((2, 2)))
    assert found.p[3] == pytest.approx(0.25, abs=1e-4)


def test_recovers_the_system_that_made_the_data():
    linear = StateSpace(order=2, focus="simulation", max_radius=1.0)
    train, test = join(record(250, 3), record(150, 4), name="train"), record(300, 5)
    straight = linear.fit(train)
    model = Lure(linear=linear).fit(train)
    runs = {name: validate(m, test).free_run_scores["y"] for name, m in (("line", straight), ("bent", model))}
    assert runs["line"].fit < 96
    assert runs["bent"].fit > 99.5
    assert "starts met in the minimum kept" in model.fit_info.method


def test_noise_level_is_found():
    data = record(900, 6, noise=0.05)
    linear = StateSpace(order=2, focus="simulation", max_radius=1.0)
    model = Lure(linear=linear).fit(data)
    assert model.fit_info.noise_std[0] == pytest.approx(0.05, rel=0.1)


@pytest.mark.filterwarnings("ignore::slipangle.errors.IdentifiabilityWarning")
def test_the_search_does_not_depend_on_the_basis_of_the_linear_start():
    data = record(300, 9, noise=0.2)
    start = StateSpace(order=2, focus="simulation", max_radius=1.0).fit(data)
    turn = np.array([[0.6, -3.0], [0.2, 0.5]])
    for T in (-np.eye(2), np.diag([1.0, -1.0]), turn):
        one, x0 = unit_states(start, data)
        other, x0_other = unit_states(start.transformed(T), data)
        np.testing.assert_allclose(other.A, one.A, atol=1e-8)
        np.testing.assert_allclose(other.B, one.B, atol=1e-8)
        np.testing.assert_allclose(x0_other, x0, atol=1e-7)
    fits = [Lure(linear=s, starts=100, carried=2).fit(data) for s in (start, start.transformed(turn))]
    assert fits[0].fit_info.noise_std[0] == pytest.approx(fits[1].fit_info.noise_std[0], rel=1e-4)
    assert fits[0].fit_info.noise_std[0] < start.fit_info.noise_std[0]


@pytest.mark.parametrize("curve", ["hardening", "saturation"])
@pytest.mark.filterwarnings("ignore::slipangle.errors.IdentifiabilityWarning")
@pytest.mark.filterwarnings("ignore:the free run of 'y' goes astray")  # a thousand times the input
@pytest.mark.filterwarnings("ignore:.*lie outside of the training data")
def test_no_bounded_input_makes_the_free_run_diverge(curve):
    """An integrating plant tempts a fit to leave the stable models: the limit holds, and bounds all free runs."""
    rng = np.random.default_rng(10)
    u = np.repeat(rng.standard_normal(60), 5)
    y = np.cumsum(0.1 * u + 0.02 * np.sinh(np.clip(np.cumsum(u), -4, 4)))
    data = Dataset.from_arrays({"u": u}, {"y": y}, 0.1)
    linear = StateSpace(order=2, focus="simulation", max_radius=0.999)
    model = Lure(linear=linear, curve=curve, max_radius=0.99, starts=50, carried=2, max_iterations=10).fit(data)
    assert model.radius <= 0.99 + 1e-9
    loud = Dataset.from_arrays({"u": 1e3 * np.tile(u, 20)}, {"y": np.tile(y, 20)}, 0.1)
    scale = 1e3 * np.abs(y).max()
    assert np.abs(model.simulate(loud).y).max() < 100 * scale


@pytest.mark.parametrize("compiled", [True, False])
def test_compiled_and_interpreted_runs_agree(compiled, monkeypatch):
    monkeypatch.setenv("SLIPANGLE_CC", "" if compiled else "none")
    fit, p, x0 = problem((1,)), np.array([0.8, 0.3, 0.6, 0.1]), np.array([0.3, -0.2])
    u = fit.records[0][0]
    seen, slopes = fit.sensitive(p, x0, u)
    np.testing.assert_allclose(seen, fit.run(p, x0, u), atol=1e-14)
    h = 1e-6
    for column, (dp, dx) in enumerate([*((h * row, 0.0) for row in np.eye(4)), (0.0, h * np.eye(2)[1])]):
        slope = (fit.run(p + dp, x0 + dx, u) - fit.run(p - dp, x0 - dx, u)) / (2 * h)
        np.testing.assert_allclose(slopes[:, :, column], slope, atol=1e-7)


def test_initial_state_comes_from_the_first_samples():
    data = record(200, 7)
    run = TRUE.simulate(data)
    assert run.error == pytest.approx(0.0, abs=1e-6)


def test_bad_settings_and_data():
    linear = StateSpace(order=2, focus="simulation")
    with pytest.raises(ParameterError, match="branches is 0; expected a whole number of at least 1"):
        Lure(linear=linear, branches=0)
    with pytest.raises(ParameterError, match="'hardenin'; nearest are 'hardening'"):
        LureModel(**{**{k: getattr(TRUE, k) for k in TRUE.__dataclass_fields__}, "curve": "hardenin"})
    with pytest.raises(TooShortError, match="13 windows of 8 samples for 16 rows"):
        Lure(linear=linear).fit(record(20, 8))
