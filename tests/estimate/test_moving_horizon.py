"""Moving horizon estimator: the linear filter on linear models, else least squares over the whole record."""

import pickle
from dataclasses import dataclass, fields, replace
from typing import Annotated

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares

import slipangle as sa
from slipangle.control.default_drive import default_estimator, driven_model
from slipangle.errors import ParameterError, SimulationError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.moving_horizon import MHE
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import SI, ParameterSet
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import stack
from slipangle.optimal.engine import Engine
from slipangle.optimal.realtime.parts import repeated_steps
from slipangle.optimal.solution import Solution, Status
from slipangle.simulate.sensors import Sensor, Sensors
from tests.estimate.test_ekf import Spring, SpringParams
from tests.estimate.test_observer import BICYCLE, LATE, NOISE, driven, model_named, oracle, settings_of

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")


def looking_back(settings, **more):
    """A moving horizon estimator with the settings of a filter."""
    return MHE(**{f.name: getattr(settings, f.name) for f in fields(settings)}, **more)


@dataclass(frozen=True, kw_only=True)
class PendulumParams(ParameterSet):
    pull: Annotated[float, SI("1/s2", "of gravity", 0.1, 100.0)] = 9.0


@dataclass(frozen=True, kw_only=True)
class Pendulum(OdeModel):
    """Far from linear; only the sine of its angle is measured."""

    states, inputs = ("angle", "rate"), ("torque",)
    params: PendulumParams

    def derivative(self, x, u):
        return stack([x[1], u[0] - self.params.pull * self.sine(x) - 0.3 * x[1]])

    @staticmethod
    def sine(x):
        return x[0] - x[0] ** 3 / 6 + x[0] ** 5 / 120

    def signals(self, x, u):
        return {"height": self.sine(x)}


PENDULUM = Pendulum(params=PendulumParams(), dt=0.1, outputs=("height",), substeps=2)
SWINGS = {"noise_std": {"height": 0.05}, "process_std": {"angle": 0.05, "rate": 0.3}}
SWINGS["state_std"] = {"angle": 0.8, "rate": 2.0}


def swung(n, seed):
    """Noisy heights and torques of a pendulum that starts far from where it is expected."""
    rng = np.random.default_rng(seed)
    x, u = np.array([1.2, -1.0]), 2.0 * rng.standard_normal((n, 1))
    y = []
    for k in range(n):
        y.append(PENDULUM.output(x, u[k]) + 0.05 * rng.standard_normal(1))
        x = PENDULUM.step(x, u[k]) + np.sqrt(0.1) * np.array([0.05, 0.3]) * rng.standard_normal(2)
    return np.array(y), u


def batch(step, output, x, L, Q, R, u, y, lower=None):
    """The whole record as one least-squares problem in SciPy: states at every sample that fit best.

    ``x`` is expected at the first with covariance ``L L'``; ``Q`` and ``R`` are standard deviations of what a step adds
    to the states and of the outputs; rows of ``y`` hold NaN where nothing was measured. States stand as unknowns
    themselves, so that ``lower`` bounds unknowns. J. B. Rawlings, D. Q. Mayne, M. M. Diehl, Model Predictive Control,
    2nd ed., 2017, sec. 4.2.
    """
    n, nx = len(u), len(x)

    def residuals(flat):
        states = flat.reshape(n, nx)
        parts = [np.linalg.solve(L, states[0] - x)]
        for k in range(n):
            if k:
                parts.append((states[k] - np.asarray(step(states[k - 1], u[k - 1])).ravel()) / Q)
            off = (y[k] - np.asarray(output(states[k], u[k])).ravel()) / R
            parts.append(off[np.isfinite(off)])
        return np.concatenate(parts)

    lowest = np.tile([-np.inf] * nx if lower is None else lower, n)
    start = np.maximum(np.tile(x, n), lowest + 1e-6)
    tight = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-12}
    return least_squares(residuals, start, bounds=(lowest, np.inf), x_scale="jac", **tight).x.reshape(n, nx)


@pytest.mark.parametrize("horizon", [1, 7])
def test_on_a_linear_model_it_is_the_kalman_filter_whatever_the_horizon(horizon):
    """With samples missing, outputs late and a sensor's offset."""
    _, y, u = driven(BICYCLE, 40, 1)
    y[::3, 0] = np.nan
    y[10:15] = np.nan
    u[:, 1] = 20.0
    settings = settings_of(BICYCLE, late={"v_y": 0.05}, bias_std={"r": 0.05})
    tracker = looking_back(settings, horizon=horizon).start_at()
    for k in range(len(u)):
        tracker.update([y[k - 1, 0] if k else np.nan, y[k, 1]], u[k])
        if k % 8 == 7:
            known = y[: k + 1].copy()
            known[k, 0] = np.nan
            x, P = oracle(BICYCLE, settings, u[: k + 1], known, offsets=("r",))
            assert np.append(tracker.state, tracker.biases) == pytest.approx(x[-1], abs=1e-7)
            assert tracker.state_covariance == pytest.approx(P[-1][:2, :2], abs=1e-7)
    assert tracker.failures == 0


def test_within_its_horizon_it_is_least_squares_over_the_whole_record():
    y, u = swung(12, 3)
    y[4:6] = np.nan
    tracker = MHE(start=PENDULUM, horizon=12, **SWINGS).start_at()
    size = np.sqrt(0.1) * np.array([0.05, 0.3])
    for k in range(12):
        tracker.update(y[k], u[k])
        if k in (5, 11):
            best = batch(
                PENDULUM.step, PENDULUM.output, np.zeros(2), np.diag([0.8, 2.0]), size, 0.05, u[: k + 1], y[: k + 1]
            )
            assert tracker.smoothed == pytest.approx(best, abs=2e-5)
    filtered = EKF(start=PENDULUM, **SWINGS).start_at()
    for k in range(12):
        filtered.update(y[k], u[k])
    assert np.abs(filtered.state - best[-1]).max() > 0.02  # the filter is another estimate here


def test_limits_hold_in_the_whole_window():
    y, u = swung(10, 5)
    tracker = MHE(start=PENDULUM, horizon=10, limits={"rate": (-1.0, np.inf)}, **SWINGS).start_at()
    for k in range(10):
        tracker.update(y[k], u[k])
    size = np.sqrt(0.1) * np.array([0.05, 0.3])
    lower = [-np.inf, -1.0]
    best = batch(PENDULUM.step, PENDULUM.output, np.zeros(2), np.diag([0.8, 2.0]), size, 0.05, u, y, lower=lower)
    free = MHE(start=PENDULUM, horizon=10, **SWINGS).start_at()
    for k in range(10):
        free.update(y[k], u[k])
    assert free.smoothed[:, 1].min() < -1.5  # the limit matters
    assert tracker.smoothed[:, 1].min() > -1.0 - 1e-6
    assert tracker.smoothed == pytest.approx(best, abs=2e-3)


def test_it_is_nearer_than_the_filter_where_the_model_is_far_from_linear():
    """Mean squared angle over eight drives, whose start is known badly."""
    errors = []
    for seed in range(8):
        rng = np.random.default_rng(100 + seed)
        x, u = np.array([2.0, 0.0]), np.zeros((25, 1))
        both = [kind(start=PENDULUM, **SWINGS, **more).start_at() for kind, more in ((EKF, {}), (MHE, {"horizon": 8}))]
        for k in range(25):
            y = PENDULUM.output(x, u[k]) + 0.05 * rng.standard_normal(1)
            for tracker in both:
                tracker.update(y, u[k])
            errors.append([(tracker.state[0] - x[0]) ** 2 for tracker in both])
            x = PENDULUM.step(x, u[k]) + np.sqrt(0.1) * np.array([0.05, 0.3]) * rng.standard_normal(2)
    filtered, ours = np.mean(errors, axis=0)
    assert ours < 0.8 * filtered


@pytest.mark.parametrize("name", ["late, on the ground", "ARX", "NARX", "hybrid"])
def test_any_model_is_observed_about_as_by_the_filter(name):
    model = model_named(name)
    _, y, u = driven(model, 30, 1)
    y[::3, 0] = np.nan
    if model.n_outputs > 2:
        y[np.arange(30) % 4 != 0, 2:] = np.nan
    settings = settings_of(model)
    tracker = looking_back(settings, horizon=4).start_at()
    for k in range(len(u)):
        tracker.update(y[k], u[k])
    x, P = oracle(model, settings, u, y)
    std = np.sqrt(np.diag(P[-1]))
    assert tracker.failures == 0
    assert (np.abs(tracker.state - x[-1]) < 0.05 * std + 1e-9).all()
    assert tracker.state_std == pytest.approx(std, rel=0.02)


def test_outliers_are_left_out_on_time_and_late():
    model = OnGround(BICYCLE)
    _, y, u = driven(model, 40, 4)
    X = model.outputs.index("X")
    settings = settings_of(model, gate=5.0, late={"X": 0.1}, patience=3)
    tracker, clean = (looking_back(settings, horizon=5).start_at() for _ in range(2))
    for k in range(40):
        arrived = y[k].copy()
        arrived[X] = y[k - 2, X] if k >= 2 else np.nan
        wrong = arrived.copy()
        wrong[X] += 5.0 * (k in (12, 20))
        wrong[1] += 1.0 * (k == 15)
        error = tracker.update(wrong, u[k])
        if k in (12, 20):
            assert error[X] == pytest.approx(5.0, abs=0.5)
            assert not tracker.taken[X]
        if k == 15:
            assert not tracker.taken[1]
        left_out = arrived.copy()
        left_out[X] = np.nan if k in (12, 20) else arrived[X]
        left_out[1] = np.nan if k == 15 else arrived[1]
        clean.update(left_out, u[k])
    assert tracker.state == pytest.approx(clean.state, abs=1e-9)
    assert tracker.taken.all()


def test_parameters_are_found_within_their_range():
    u = np.column_stack([np.repeat(0.03 * np.random.default_rng(1).standard_normal(24), 5), np.full(120, 20.0)])
    x, rng = np.zeros(2), np.random.default_rng(2)
    wrong = replace(BICYCLE, params=BICYCLE.params.with_values(C_f=0.7 * BICYCLE.params.C_f))
    settings = MHE(start=wrong, free=("C_f",), noise_std={n: NOISE[n] for n in ("v_y", "r")}, horizon=10)
    tracker = settings.start_at()
    for k in range(120):
        tracker.update(BICYCLE.output(x, u[k]) + rng.standard_normal(2) * [0.05, 0.01], u[k])
        x = BICYCLE.step(x, u[k])
    found = tracker.model()
    off = found.params.C_f - BICYCLE.params.C_f
    assert abs(off) < 3 * found.fit_info.std[0] < 0.1 * BICYCLE.params.C_f
    assert "moving horizon" in found.fit_info.method


def test_a_sample_that_leads_out_of_the_numbers_leaves_everything_as_it_was(monkeypatch):
    model = OnGround(BICYCLE)
    _, y, u = driven(model, 12, 7)
    settings = looking_back(settings_of(model, late={"X": 0.1}), horizon=4)
    tracker, other = settings.start_at(), settings.start_at()
    X = model.outputs.index("X")
    for k in range(12):
        arrived = y[k].copy()
        arrived[X] = y[max(k - 2, 0), X]
        if k == 9:
            before = tracker.state, tracker.state_covariance, tracker.smoothed
            with monkeypatch.context() as patch:
                patch.setattr(tracker, "_solve", lambda: tracker._z_new.fill(np.nan))
                with pytest.raises(SimulationError, match="at its sample 9"):
                    tracker.update(arrived + 3.0, u[k])
            for now, then in zip((tracker.state, tracker.state_covariance, tracker.smoothed), before, strict=True):
                assert np.array_equal(now, then)
        tracker.update(arrived, u[k])
        other.update(arrived, u[k])
        assert np.array_equal(tracker.state, other.state)


class Broken(Engine):
    """A solver that never has an answer, and its settings."""

    def build(self, ocp, deadline=None):
        return self

    def solve(self, start):
        nothing = np.full_like(start.guess_x, np.nan)
        return Solution(u=start.guess_u, x=nothing, status=Status.FAILED, cost=np.nan, iterations=0, violation=np.nan)


def test_without_a_solution_it_is_the_filter_through_the_window():
    _, y, u = driven(BICYCLE, 20, 8)
    u[:, 1] = 20.0
    settings = settings_of(BICYCLE)
    tracker = looking_back(settings, horizon=4, solver=Broken()).start_at()
    for k in range(20):
        tracker.update(y[k], u[k])
    x, P = oracle(BICYCLE, settings, u, y)
    assert (tracker.failures, tracker.status) == (20, Status.FAILED)
    assert tracker.state == pytest.approx(x[-1], abs=1e-7)
    assert tracker.state_covariance == pytest.approx(P[-1], abs=1e-7)


def test_it_stands_where_the_filter_does():
    """By channels and in a loop; copies are as good."""
    car = OnGround(LATE)
    path = sa.double_lane_change(18.0)
    law = sa.PreviewLQR(params=BICYCLE.params, dt=0.05, horizon=20)
    plant = sa.Plant(sa.OnGround(replace(BICYCLE, dt=0.001, outputs=("v_y", "r"))), seed=1)
    estimator = MHE(
        start=car,
        noise_std=NOISE,
        process_std={"v_y": 0.1, "r": 0.05},
        horizon=5,
    )
    copy = pickle.loads(pickle.dumps(estimator))
    runs = [sa.closed_loop(plant, law, path, estimator=e, duration=3.0) for e in (estimator, copy)]
    assert np.array_equal(runs[0].e_y, runs[1].e_y)
    assert np.abs(runs[0].e_y).max() < 0.5


def test_bad_settings_say_what_to_do():
    good = {"start": OnGround(BICYCLE), "noise_std": NOISE}
    for bad, match in (
        ({"horizon": 0}, "horizon is 0; expected a whole number of at least 1"),
        ({"limits": {"vy": 1.0}}, "limits names 'vy'; nearest are 'v_y'"),
        ({"late": {"X": 1.0}}, r"'X' is 1 s late and the horizon 0\.5 s long; expected a horizon of at least 20 steps"),
        ({"solver": "osqp"}, 'the solver is \'osqp\'; expected "realtime" or "ipopt"'),
        ({"noise_std": {}}, "noise_std lacks the measured output 'v_y'"),
    ):
        with pytest.raises(ParameterError, match=match):
            MHE(**(good | bad))


def test_both_solvers_find_the_same_states():
    y, u = swung(8, 9)
    both = [MHE(start=PENDULUM, horizon=4, solver=s, **SWINGS).start_at() for s in ("realtime", "ipopt")]
    for k in range(8):
        for tracker in both:
            tracker.update(y[k], u[k])
        assert both[0].smoothed == pytest.approx(both[1].smoothed, abs=1e-6)


@pytest.mark.slow
def test_a_driver_drives_with_it_as_with_the_filter():
    """Pose 100 ms late at 10 Hz: eleven states, of which seven wander."""
    whole, late = driven_model(LATE, 0.02), dict.fromkeys(("X", "Y", "psi"), 0.1)
    filtered = default_estimator(whole, {"v_y": 0.05, "r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001}, late)
    sensors = Sensors(**{n: Sensor(noise=0.001, interval=0.1, delay=0.1) for n in late})
    model = OnGround(replace(BICYCLE, dt=0.001))
    errors = []
    for estimator in (filtered, looking_back(filtered, horizon=8)):
        plant = sa.Plant(model, sensors=sensors, seed=1, delay=sa.Values(delta=0.02), lag=sa.Values(delta=0.05))
        driver = sa.Driver(LATE, sa.double_lane_change(20.0), estimator=estimator)
        run = sa.drive(plant, driver, channels=("r", "v_x", *late), duration=4.0)
        errors.append(run.rmse("y"))
    assert errors[1] < 1.2 * errors[0] < 0.05


@pytest.mark.parametrize("free", [(), ("stiffness", "offset")], ids=["states", "parameters"])
def test_a_windows_steps_that_are_repeated_are_those_written_out(free):
    """And their derivatives, by the states, what stands for parameters and offsets, and what wanders."""
    spring = Spring(params=SpringParams(stiffness=30.0, offset=0.8), dt=0.1, substeps=7)
    model = Delayed(spring, delays={"force": 0.23})
    noise, wander = dict.fromkeys(model.outputs, 0.02), {"v": 0.1, "x": 0.02}
    settings = MHE(start=model, horizon=4, free=free, noise_std=noise, process_std=wander, bias_std={"x": 0.1})
    ocp, rng = settings.window.ocp, np.random.default_rng(1)
    steps, values = (repeated_steps(ocp, derivatives=d) for d in (True, False))
    assert steps is not None
    assert values is not None
    given = [rng.normal(size=ocp.dynamics.size1_in(i)) for i in range(3)]
    x, u, w = (ca.MX.sym(n, len(v)) for n, v in zip("xuw", given, strict=True))
    later = ocp.dynamics(x, u, w)
    wanted = ca.Function("wanted", [x, u, w], [later, ca.jacobian(later, x), ca.jacobian(later, u)])(*given)
    for one, other in zip(steps.whole("steps")(*given), wanted, strict=True):
        assert np.array(ca.DM(one)) == pytest.approx(np.array(ca.DM(other)), rel=1e-11, abs=1e-13)
    assert np.array(values.whole("values")(*given)) == pytest.approx(np.array(ca.DM(wanted[0])), rel=1e-13, abs=1e-15)
