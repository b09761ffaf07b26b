"""Extended Kalman filter: equals the linear one, textbook step, consistent estimates of cornering stiffness."""

import tracemalloc
from dataclasses import dataclass, replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.data.public.sets import public
from slipangle.errors import MissingColumnError, NotFiniteError, ParameterError, SampleTimeError, SimulationError
from slipangle.estimate import filter as filter_
from slipangle.estimate.ekf import EKF
from slipangle.estimate.filter import Scales, filter_step
from slipangle.identify.judge.validate import validate
from slipangle.models import repeated
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import SI, Annotated, ParameterSet
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM, SOUSA_TABLE_7_2
from slipangle.models.wrappers.delayed import Delayed
from slipangle.ops import stack

BICYCLE = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("r", "a_y"))
NOISE = {"r": 0.01, "a_y": 0.2}


def drive(model, n, seed, *, process=(0.0, 0.0), noise=NOISE, speed=20.0):
    """Steering noise of low frequency at slowly varying speed, with process and measurement noise."""
    rng = np.random.default_rng(seed)
    delta = 0.06 * np.convolve(rng.standard_normal(n + 19), np.ones(20) / 4.5, "valid") / 4.5
    v_x = speed + 5 * np.sin(0.02 * np.arange(n))
    x, y = np.zeros(2), np.zeros((n, len(model.outputs)))
    std = np.array([noise[name] for name in model.outputs])
    step, output, _ = model.functions
    for k in range(n):
        u = np.array([delta[k], v_x[k]])
        y[k] = output(x, u).full()[:, 0] + std * rng.standard_normal(len(std))
        x = step(x, u).full()[:, 0] + np.array(process) * np.sqrt(model.dt) * rng.standard_normal(2)
    outputs = {name: y[:, i] for i, name in enumerate(model.outputs)}
    return Dataset.from_arrays({"delta": delta, "v_x": v_x}, outputs, model.dt)


def matrices(model, v_x):
    """Of the bicycle at one speed, from unit steps."""
    at = [np.array([d, v_x]) for d in (0.0, 1.0)]
    A = np.column_stack([model.step(e, at[0]) for e in np.eye(2)])
    C = np.column_stack([model.output(e, at[0]) for e in np.eye(2)])
    return A, model.step(np.zeros(2), at[1]), C, model.output(np.zeros(2), at[1])


def test_on_a_linear_system_it_is_the_kalman_filter():
    data = drive(BICYCLE, 150, 1)
    A, B, C, D = matrices(BICYCLE, 20.0)
    Q, R = np.diag([0.3, 0.1]) ** 2 * 0.05, np.diag([0.01, 0.2]) ** 2
    settings = EKF(
        start=BICYCLE,
        free=(),
        noise_std=NOISE,
        process_std={"v_y": 0.3, "r": 0.1},
        state_std={"v_y": 0.5, "r": 0.2},
    )
    estimate = settings.start_at(np.array([0.1, -0.2]))
    x, P = np.array([0.1, -0.2]), np.diag([0.25, 0.04])
    for k in range(data.n_samples):
        if k:
            x = A @ x + B * data["delta"][k - 1]
            P = A @ P @ A.T + Q
        S = C @ P @ C.T + R
        K = P @ C.T @ np.linalg.inv(S)
        e = data.y[k] - C @ x - D * data["delta"][k]
        x, P = x + K @ e, (np.eye(2) - K @ C) @ P
        found = estimate.update(data.y[k], np.array([data["delta"][k], 20.0]))
        assert found == pytest.approx(e, abs=1e-11)
        assert estimate.state == pytest.approx(x, abs=1e-11)
        assert estimate._P == pytest.approx(P, rel=1e-8, abs=1e-15)
        assert estimate._variance[0] == pytest.approx(S[0, 0], rel=1e-9)


def test_one_step_is_the_textbook_one():
    """Augmented with two parameters, derivatives by finite differences."""
    settings = EKF(
        start=BICYCLE,
        free=("C_f", "C_r"),
        noise_std=NOISE,
        process_std={"v_y": 0.3},
        walk_std={"C_f": 0.05},
        prior_std={"C_f": 0.2, "C_r": 0.1},
        state_std={"v_y": 0.5, "r": 0.2},
    )
    p0 = np.array([BICYCLE.params.C_f, BICYCLE.params.C_r])

    def at(z):
        C_f, C_r = map(float, p0 * np.exp(z[2:]))
        return replace(BICYCLE, params=BICYCLE.params.with_values(C_f=C_f, C_r=C_r))

    def slope(f, z):
        return np.column_stack([(f(z + h) - f(z - h)) / 2e-6 for h in 1e-6 * np.eye(len(z))])

    def moved(u):
        return lambda z: np.concatenate([at(z).step(z[:2], u), z[2:]])

    data = drive(BICYCLE, 30, 2)
    estimate = settings.start_at()
    z, P = np.zeros(4), np.diag([0.5, 0.2, 0.2, 0.1]) ** 2
    for k in range(data.n_samples):
        u = data.u[k]
        if k:
            step = moved(data.u[k - 1])
            F = slope(step, z)
            z, P = step(z), F @ P @ F.T + 0.05 * np.diag([0.3, 0.0, 0.05, 0.0]) ** 2
        H = slope(lambda z, u=u: at(z).output(z[:2], u), z)
        S = H @ P @ H.T + np.diag([0.01, 0.2]) ** 2
        K = P @ H.T @ np.linalg.inv(S)
        z, P = z + K @ (data.y[k] - at(z).output(z[:2], u)), (np.eye(4) - K @ H) @ P
        estimate.update(data.y[k], u)
        assert estimate._z == pytest.approx(z, rel=1e-6, abs=1e-8)
        size = np.sqrt(np.diag(P))
        assert estimate._P / np.outer(size, size) == pytest.approx(P / np.outer(size, size), abs=1e-5)
    model = estimate.model()
    assert (model.params.C_f, model.params.C_r) == pytest.approx(p0 * np.exp(z[2:]), rel=1e-6)
    assert model.fit_info.std == pytest.approx(model.fit_info.values * np.sqrt(np.diag(P)[2:]), rel=1e-4)
    assert model.fit_info.units == ("N/rad", "N/rad")


def test_finds_the_cornering_stiffness_within_its_covariance():
    true = np.array([BICYCLE.params.C_f, BICYCLE.params.C_r])
    process = (0.05, 0.02)
    squares = []
    for seed in range(16):
        rng = np.random.default_rng(100 + seed)
        wrong = true * np.exp(0.3 * rng.standard_normal(2))
        params = BICYCLE.params.with_values(C_f=float(wrong[0]), C_r=float(wrong[1]))
        settings = EKF(
            start=replace(BICYCLE, params=params),
            free=("C_f", "C_r"),
            noise_std=NOISE,
            process_std={"v_y": process[0], "r": process[1]},
        )
        model = settings.fit(drive(BICYCLE, 300, seed, process=process))
        off = model.fit_info.values - true
        squares.append(off @ np.linalg.solve(model.fit_info.covariance, off))
        assert np.abs(off / true).max() < 0.15
    assert 0.9 < np.mean(squares) < 3.6  # chi-square with 2 degrees of freedom, mean of 16


def test_follows_a_tire_that_changes():
    softer = replace(BICYCLE, params=BICYCLE.params.with_values(C_f=0.6 * BICYCLE.params.C_f))
    first, second = drive(BICYCLE, 400, 3), drive(softer, 800, 4)
    settings = EKF(
        start=BICYCLE, free=("C_f", "C_r"), noise_std=NOISE, walk_std={"C_f": 0.1, "C_r": 0.1}, process_std={"r": 0.01}
    )
    estimate = settings.start_at()
    before, after = estimate.run(first), estimate.run(second)
    assert before.parameter("C_f")[-1] == pytest.approx(BICYCLE.params.C_f, rel=0.1)
    assert after.parameter("C_f")[-1] == pytest.approx(softer.params.C_f, rel=0.1)
    white = after.error[400:] / after.error_std[400:]
    assert np.std(white, axis=0) == pytest.approx([1.0, 1.0], abs=0.1)
    with pytest.raises(ParameterError, match="'C_a' was not free; nearest are 'C_r', 'C_f'"):
        after.parameter("C_a")


def test_an_output_that_is_not_measured_leaves_only_the_prediction():
    data = drive(BICYCLE, 60, 5)
    both = EKF(start=BICYCLE, free=("C_f",), noise_std=NOISE)
    one = EKF(start=replace(BICYCLE, outputs=("r",)), free=("C_f",), noise_std={"r": 0.01}).start_at()
    estimate, blind = both.start_at(), both.start_at(np.array([0.1, 0.2]))
    for k in range(data.n_samples):
        error = estimate.update(np.array([data["r"][k], np.nan]), data.u[k])
        assert error[1] == 0.0
        one.update(data["r"][k], data.u[k])
        assert estimate._z == pytest.approx(one._z, abs=1e-13)
        blind.update(np.array([np.nan, np.nan]), data.u[k])
    x = np.array([0.1, 0.2])
    for k in range(data.n_samples - 1):
        x = BICYCLE.step(x, data.u[k])
    assert blind.state == pytest.approx(x, abs=1e-12)
    assert blind.parameters == pytest.approx([BICYCLE.params.C_f])


def test_experiments_keep_the_parameters_and_restart_the_state():
    data = drive(BICYCLE, 200, 6)
    two = replace(data, starts=(0, 120), start_times=(0.0, 100.0))
    settings = EKF(start=BICYCLE, free=("C_f", "C_r"), noise_std=NOISE)
    run = settings.start_at().run(two)
    estimate = settings.start_at()
    first, second = two.experiments
    estimate.run(first)
    known = estimate.parameters
    estimate.restart(BICYCLE.initial_state(second.head(1)))
    assert np.array_equal(estimate.parameters, known)
    assert np.array_equal(estimate.run(second).parameters, run.parameters[120:])


@dataclass(frozen=True, kw_only=True)
class SpringParams(ParameterSet):
    stiffness: Annotated[float, SI("N/m", "spring", 1.0, 50.0)]
    offset: Annotated[float, SI("N", "force at rest", -2.0, 2.0)]


@dataclass(frozen=True, kw_only=True)
class Spring(OdeModel):
    """Unit mass on a hardening spring with a bias of the force: a user's own equations."""

    states, inputs = ("x", "v"), ("force",)
    params: SpringParams

    def derivative(self, x, u):
        p = self.params
        return stack([x[1], u[0] + p.offset - p.stiffness * x[0] - x[0] ** 3 - 0.5 * x[1]])


@pytest.mark.parametrize("method", ["rk4", "radau"])
def test_any_ode_and_parameters_of_either_sign_within_their_range(method):
    true = Spring(params=SpringParams(stiffness=9.0, offset=-0.4), dt=0.05, outputs=("x",), method=method)
    rng = np.random.default_rng(0)
    n = 400
    u, x, y = 5 * rng.standard_normal((n, 1)), np.zeros(2), np.zeros(n)
    for k in range(n):
        y[k] = x[0] + 0.01 * rng.standard_normal()
        x = np.asarray(true.step(x, u[k])).ravel()
    data = Dataset.from_arrays({"force": u[:, 0]}, {"x": y}, 0.05)
    start = replace(true, params=SpringParams(stiffness=12.0, offset=0.5))
    settings = EKF(start=start, free=("stiffness", "offset"), noise_std={"x": 0.01})
    model = settings.fit(data)
    off = (model.fit_info.values - [9.0, -0.4]) / model.fit_info.std
    assert np.abs(off).max() < 4
    assert model.params.offset == pytest.approx(-0.4, abs=0.1)
    bounded = EKF(
        start=replace(true, params=SpringParams(stiffness=49.0, offset=0.0)),
        free=("stiffness",),
        noise_std={"x": 1e-4},
        prior_std={"stiffness": 3.0},
    ).start_at()
    for k in range(50):
        bounded.update(0.001 * (-1) ** k, 40.0)  # as if the spring were very stiff
    assert bounded.parameters[0] <= 50.0 + 1e-9


def test_update_allocates_nothing():
    data = drive(BICYCLE, 400, 7)
    rows = [(data.y[k], data.u[k]) for k in range(400)]
    estimate = EKF(start=BICYCLE, free=("C_f", "C_r"), noise_std=NOISE).start_at()
    for y, u in rows:
        estimate.update(y, u)
    tracemalloc.start()
    try:
        for y, u in rows:
            estimate.update(y, u)
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        for y, u in rows:
            estimate.update(y, u)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 200
    assert peak - before < 1000


def test_bad_input_says_what_to_do():
    good = {"start": BICYCLE, "free": ("C_f",), "noise_std": NOISE}
    for bad, match in (
        ({"free": ("C_x",)}, "no parameter 'C_x'"),
        ({"noise_std": {"r": 0.01}}, "noise_std lacks the measured output 'a_y'"),
        ({"noise_std": {"r": 0.0, "a_y": 1.0}}, "noise_std of 'r' is 0.0; expected a positive number"),
        ({"process_std": {"vy": 1.0}}, "process_std names 'vy'; nearest are 'v_y'"),
        ({"walk_std": {"C_r": 1.0}}, "walk_std names 'C_r'"),
        ({"prior_std": {"C_f": np.nan}}, "prior_std of 'C_f' is nan"),
    ):
        with pytest.raises(ParameterError, match=match):
            EKF(**(good | bad))
    settings = EKF(**good)
    with pytest.raises(ParameterError, match="expected 2 finite numbers: v_y, r"):
        settings.start_at([0.0])
    estimate = settings.start_at()
    with pytest.raises(ParameterError, match="a sample has 1 outputs; expected 2: r, a_y"):
        estimate.update(0.1, [0.0, 20.0])
    known = estimate._z.copy(), estimate._P.copy()
    with pytest.raises(NotFiniteError, match=r"u = \[nan, 20.0\]"):
        estimate.update([0.1, 0.1], [np.nan, 20.0])
    with pytest.raises(SimulationError, match="at its sample 0"):
        estimate.update([1e308, 1e308], [1e308, 20.0])
    assert np.array_equal(estimate._z, known[0])
    assert np.array_equal(estimate._P, known[1])
    data = drive(BICYCLE, 60, 8)
    with pytest.raises(SampleTimeError):
        estimate.run(replace(data, dt=0.1))
    with pytest.raises(MissingColumnError, match="'a_y'"):
        estimate.run(drive(replace(BICYCLE, outputs=("r",)), 60, 8))


@pytest.mark.usefixtures("real_data")
def test_a_race_car_in_one_pass_is_as_good_as_the_batch_fit():
    """Yaw rate and side slip measured; free run over the last 30 %, which the filter has not seen."""
    data = public("ferrari-250lm").resample(0.05, cutoff=8.0).select(inputs=["delta", "v_x"], outputs=["r", "v_y"])
    train, test = data.split(0.7)
    start = Bicycle(params=FERRARI_250LM, dt=0.05, outputs=("r", "v_y"))
    settings = EKF(
        start=start,
        free=("C_f", "C_r"),
        noise_std={"r": 0.06, "v_y": 0.3},
        process_std={"v_y": 0.01, "r": 0.005},
    )
    model = settings.fit(train)
    found = validate(model, test).free_run_scores
    assert found["r"].fit > 78.5  # the batch fit of these two from yaw rate: 78.9
    assert found["v_y"].fit > 71
    assert (model.params.C_f, model.params.C_r) == pytest.approx((38e3, 82e3), rel=0.1)  # what the batch fit finds


def test_surprise_is_the_mean_square_of_innovations_and_one_for_the_right_model():
    data = drive(BICYCLE, 1500, 4, process=(0.3, 0.1))
    filter_ = EKF(
        start=BICYCLE, noise_std=NOISE, process_std={"v_y": 0.3, "r": 0.1}, state_std={"v_y": 0.3, "r": 0.1}
    ).start_at()
    heard = []
    for y, u in zip(data.y, data.u, strict=True):
        filter_.update(y, u)
        error, std = filter_.innovation
        assert filter_.surprise == pytest.approx(np.mean((error / std) ** 2))
        heard.append(filter_.surprise)
    assert np.mean(heard[100:]) == pytest.approx(1.0, abs=0.08)  # 2 800 squares of a standard normal
    filter_.update(np.array([np.nan, np.nan]), data.u[0])
    assert np.isnan(filter_.surprise)


@pytest.mark.parametrize("free", [(), ("stiffness", "offset")], ids=["states", "parameters"])
@pytest.mark.parametrize("method", ["rk4", "euler"])
def test_steps_that_are_repeated_are_those_written_out(monkeypatch, method, free):
    """Also where the inputs are late and parameters are estimated."""
    monkeypatch.setattr(repeated, "MOST_MORE", 10.0)
    spring = Spring(params=SpringParams(stiffness=30.0, offset=0.8), dt=0.1, method=method, substeps=12)
    model = Delayed(spring, delays={"force": 0.23})
    noise = dict.fromkeys(model.outputs, 0.02)
    settings = EKF(start=model, free=free, noise_std=noise, process_std={"v": 0.1})
    assert isinstance(filter_step(settings, Scales(settings)), repeated.Repeated)
    rng, estimates = np.random.default_rng(3), []
    y, u = rng.normal(0, 0.1, (60, model.n_outputs)), rng.normal(0, 3.0, (60, 1))
    for write_out in (False, True):
        if write_out:
            monkeypatch.setattr(filter_, "repeated", lambda *_, **__: None)
        tracker = settings.start_at(np.full(model.n_states, 0.1))
        for now, given in zip(y, u, strict=True):
            tracker.update(now, given)
        estimates.append([tracker.state, tracker.state_std, tracker.parameters, tracker.parameters_std])
    for one, other in zip(*estimates, strict=True):
        assert np.array(one) == pytest.approx(np.array(other), rel=1e-9, abs=1e-12)
