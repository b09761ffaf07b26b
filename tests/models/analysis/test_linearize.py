"""Linearisation against closed forms, against the model's own step, against SciPy."""

import sys
import types
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.errors import ConfigError, ModelWarning, ParameterError
from slipangle.models.analysis.linearize import linearize
from slipangle.models.model import FitInfo
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.on_ground import OnGround
from tests.models.all_models import ALL_MODELS
from tests.oracles import handling as oracle

CAR = {"mass": 1500.0, "inertia_z": 2500.0, "wheelbase": 2.7, "l_f": 1.2, "C_f": 9e4, "C_r": 1.1e5}
BICYCLE = Bicycle(params=BicycleParams(**CAR), dt=0.02, outputs=("r", "v_y", "a_y"))
# Models with a steady state: others are at random, with friction that never rests, or with an engine and gears.
NONE = ("NARX", "neural state space, feedthrough", "EMPS", "dual track", "ARX models blended", "hybrid, switched off")
NONE += ("continuous time",)  # its linear system is not that of its samples: test_delays
KINKED = "single track, neural tires"  # its friction ellipse has a tip where no tire slips
STEADY = {k: m for k, m in ALL_MODELS.items() if not k.startswith((*NONE, KINKED))}


def fitted(model=BICYCLE, names=("C_f", "C_r"), share=(0.02, 0.03), rho=0.6):
    values = np.array([model.value(n) for n in names])
    std = np.asarray(share) * values
    covariance = np.outer(std, std) * (np.eye(len(names)) + rho * (1 - np.eye(len(names))))
    info = FitInfo(names=names, values=values, covariance=covariance, noise_std=np.array([0.01]), n_samples=100)
    return replace(model, fit_info=info), covariance


@pytest.mark.parametrize("v", [8.0, 20.0, 35.0])
def test_poles_zero_and_gain_are_those_of_the_closed_form(v):
    linear = linearize(BICYCLE, v_x=v)
    omega, zeta = oracle.frequency_and_damping(CAR, v)
    assert np.prod(linear.poles).real == pytest.approx(omega**2, rel=1e-10)
    assert -np.sum(linear.poles).real == pytest.approx(2 * zeta * omega, rel=1e-10)
    assert linear.zeros("r", "delta") == pytest.approx([oracle.yaw_zero(CAR, v)], rel=1e-9)
    assert linear.gain("r", "delta").value == pytest.approx(oracle.yaw_gain(CAR, v), rel=1e-10)
    assert linear.gain("v_y", "delta").value / v == pytest.approx(oracle.sideslip_gain(CAR, v), rel=1e-9)
    assert linear.gain("a_y", "delta").value == pytest.approx(v * oracle.yaw_gain(CAR, v), rel=1e-9)
    s = 2j * np.pi * np.array([0.1, 1.0, 4.0])
    assert linear.bode("r", "delta", frequency=s.imag / 2 / np.pi).value == pytest.approx(
        oracle.yaw_response(CAR, v, s), rel=1e-10
    )


def test_damping_and_frequency_of_a_turning_pair():
    linear = linearize(BICYCLE, v_x=30.0)
    omega, zeta = oracle.frequency_and_damping(CAR, 30.0)
    assert linear.natural_frequency == pytest.approx([omega, omega], rel=1e-10)
    assert linear.damping == pytest.approx([zeta, zeta], rel=1e-10)
    sampled = linear.sampled(0.05)
    assert sampled.natural_frequency == pytest.approx([omega, omega], rel=1e-9)
    assert sampled.damping == pytest.approx([zeta, zeta], rel=1e-9)


def test_step_is_that_of_the_closed_form():
    response = linearize(BICYCLE, v_x=30.0).step("r", "delta")
    exact = np.array([oracle.yaw_step(CAR, 30.0, t) for t in response.t])
    assert response.y == pytest.approx(exact, rel=1e-9, abs=1e-9)
    peak = oracle.yaw_peak(CAR, 30.0)
    assert response.peak_time == pytest.approx(peak, rel=1e-4)
    over = oracle.yaw_step(CAR, 30.0, peak) / oracle.yaw_gain(CAR, 30.0) - 1
    assert response.overshoot == pytest.approx(over, rel=1e-6)
    assert oracle.yaw_step(CAR, 30.0, response.rise_time) == pytest.approx(0.9 * response.final, rel=1e-4)


@pytest.mark.filterwarnings("ignore::scipy.signal.BadCoefficients")  # SciPy rounds a leading zero on its way
@pytest.mark.parametrize("dt", [0.0, 0.02])
def test_responses_are_those_of_scipy(dt):
    linear = linearize(BICYCLE, v_x=25.0)
    linear = linear.sampled(dt) if dt else linear
    theirs = linear.to_scipy()
    omega = np.array([0.5, 5.0, 30.0])
    if dt:
        _, value = signal.dfreqresp(
            signal.StateSpace(theirs.A, theirs.B[:, :1], theirs.C[:1], [[0.0]], dt=dt), omega * dt
        )
        _, (y, *_) = signal.dstep(theirs, n=50)
        _, (pulse, *_) = signal.dimpulse(theirs, n=50)
        mine, hit = linear.step("r", "delta", duration=49 * dt), linear.impulse("r", "delta", duration=49 * dt)
        assert hit.y == pytest.approx(pulse[:, 0] / dt, rel=1e-9, abs=1e-9)
    else:
        _, value = signal.freqresp((theirs.A, theirs.B[:, :1], theirs.C[:1], [[0.0]]), omega)
        mine, hit = linear.step("r", "delta", duration=1.0), linear.impulse("r", "delta", duration=1.0)
        single = (theirs.A, theirs.B[:, :1], theirs.C[:1], [[0.0]])
        y = signal.step(single, T=mine.t)[1][:, None]
        assert hit.y == pytest.approx(signal.impulse(single, T=hit.t)[1], rel=1e-6, abs=1e-6)
    assert linear.frequency_response(omega)[:, 0, 0] == pytest.approx(value, rel=1e-9)
    assert mine.y == pytest.approx(y[:, 0], rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("a_y", [0.0, 2.0])
@pytest.mark.parametrize("model", STEADY.values(), ids=STEADY.keys())
def test_it_moves_as_the_model_does_beside_its_trim(model, a_y):
    """A small move away from the steady state comes out of the model's own step as out of the matrices."""
    model = model.off_ground
    known = {*model.states, *model.inputs}
    v_x = 20.0 if "v_x" in known else None
    if a_y and not (v_x and "r" in known | {*model.outputs}):
        with pytest.raises(ParameterError, match="leave a_y out"):
            linearize(model, v_x=v_x, a_y=a_y)
        return
    linear = linearize(model, v_x=v_x, a_y=a_y, hold_speed=False)
    kept = [model.states.index(n) for n in linear.states]
    x, u = linear.trim.x, linear.trim.u
    move = model.step if linear.dt else model.derivative
    if a_y:
        r = x[model.states.index("r")] if "r" in model.states else model.output(x, u)[model.outputs.index("r")]
        assert r * v_x == pytest.approx(a_y, rel=1e-7)
    still = np.asarray(move(x, u)).ravel()[kept]
    assert still == pytest.approx(x[kept] if linear.dt else 0.0, rel=1e-5, abs=1e-5)
    rng = np.random.default_rng(1)
    for _ in range(3):
        dx, du = np.zeros(len(x)), 1e-5 * rng.standard_normal(len(u))
        dx[kept] = 1e-5 * rng.standard_normal(len(kept))
        change = np.asarray(move(x + dx, u + du)).ravel()[kept] - np.asarray(move(x - dx, u - du)).ravel()[kept]
        expected = (linear.A @ dx[kept] + linear.B @ du) / 1e-5
        assert change / 2e-5 == pytest.approx(expected, rel=1e-3, abs=1e-5 * np.abs(expected).max(initial=1.0))


def test_a_kink_is_said():
    with pytest.warns(ModelWarning, match="is not smooth in v_x, r"):
        linearize(ALL_MODELS[KINKED], v_x=20.0)


def test_a_steering_offset_is_part_of_the_steady_state():
    model = replace(BICYCLE, params=BICYCLE.params.with_values(steering_offset=0.02, steering_gain=0.5))
    linear = linearize(model, v_x=20.0, a_y=3.0)
    wanted = 0.02 + 3.0 / 20.0 / oracle.yaw_gain(CAR, 20.0) / 0.5
    assert linear.trim.u[0] == pytest.approx(wanted, rel=1e-9)
    assert linear.gain("r", "delta").value == pytest.approx(0.5 * oracle.yaw_gain(CAR, 20.0), rel=1e-9)


def test_a_turning_car_is_softer_than_a_straight_one():
    """Where tires saturate, stiffness falls with lateral acceleration, and with it the natural frequency."""
    params = NonlinearBicycleParams(**CAR, steering_lag=0.002)
    model = NonlinearBicycle(params=params, dt=0.02, outputs=("r",))
    sizes = [linearize(model, v_x=25.0, a_y=a).natural_frequency[0] for a in (0.0, 4.0, 7.0)]
    assert sizes[0] > sizes[1] > sizes[2]
    with pytest.raises(ParameterError, match="no steady state at v_x = 25 m/s and a_y = 30 m/s2"):
        linearize(model, v_x=25.0, a_y=30.0)


def test_what_holds_a_speed_is_named_as_the_model_names_it():
    car = DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001, outputs=("r",))
    with pytest.raises(ParameterError, match=r"no steady state at v_x = 15 m/s .* such as inputs=\{'throttle': "):
        linearize(car, v_x=15.0)


def test_a_delay_lags_and_changes_no_gain():
    late = linearize(Delayed(BICYCLE, delays={"delta": 0.06}), v_x=20.0)
    plain = linearize(BICYCLE, v_x=20.0).sampled(0.02)
    f = np.array([0.5, 2.0])
    ratio = late.bode("r", "delta", frequency=f).value / plain.bode("r", "delta", frequency=f).value
    assert ratio == pytest.approx(np.exp(-2j * np.pi * f * 0.06), rel=1e-6)
    assert np.isinf(late.natural_frequency).sum() >= 1
    assert late.continuous().delay == pytest.approx([0.06, 0.0], abs=1e-9)


def test_to_discrete_time_and_back():
    linear = linearize(BICYCLE, v_x=20.0)
    back = linear.sampled(0.02).continuous()
    assert back.A == pytest.approx(linear.A, rel=1e-8)
    assert back.B == pytest.approx(linear.B, rel=1e-7, abs=1e-9)
    theirs = signal.cont2discrete((linear.A, linear.B, linear.C, linear.D), 0.02)
    assert linear.sampled(0.02).A == pytest.approx(theirs[0], rel=1e-12)
    assert linear.sampled(0.02).B == pytest.approx(theirs[1], rel=1e-12, abs=1e-12)


def test_bands_are_the_closed_form_moved_by_the_covariance():
    """Delta method by hand: slopes of the closed form by C_f and C_r, differences of the textbook's formulas."""
    model, covariance = fitted()
    linear = linearize(model, v_x=20.0)

    def std(get):
        slope = []
        for name in ("C_f", "C_r"):
            h = 1e-4 * CAR[name]
            slope.append((get({**CAR, name: CAR[name] + h}) - get({**CAR, name: CAR[name] - h})) / (2 * h))
        return np.sqrt(np.einsum("i...,ij,j...", np.array(slope), covariance, np.array(slope)))

    assert linear.gain("r", "delta").std == pytest.approx(std(lambda car: oracle.yaw_gain(car, 20.0)), rel=1e-4)
    f = np.array([0.3, 1.0, 3.0])
    curve = linear.bode("r", "delta", frequency=f)
    s = 2j * np.pi * f
    known = std(lambda car: np.log(np.abs(oracle.yaw_response(car, 20.0, s))))
    assert curve.magnitude_std == pytest.approx(known, rel=1e-4)
    assert curve.phase_std == pytest.approx(std(lambda car: np.angle(oracle.yaw_response(car, 20.0, s))), rel=1e-4)
    response = linear.step("r", "delta")
    k = [50, 200, 500]
    known = std(lambda car: np.array([oracle.yaw_step(car, 20.0, t) for t in response.t[k]]))
    assert response.std[k] == pytest.approx(known, rel=1e-3)
    size, damping = linear.pole_std()
    assert size[0] == pytest.approx(std(lambda car: oracle.frequency_and_damping(car, 20.0)[0]), rel=1e-4)
    assert damping[0] == pytest.approx(std(lambda car: oracle.frequency_and_damping(car, 20.0)[1]), rel=1e-4)
    low, high = linear.gain("r", "delta").interval()
    assert high - low == pytest.approx(2 * 1.959964 * linear.gain("r", "delta").std, rel=1e-6)
    assert "C_f, C_r" in linear.uncertainty


def test_bands_do_not_hang_on_the_units_of_channels():
    """Of one record, logged in rad and m or in other units, gains and their bands go with the units."""
    rng = np.random.default_rng(0)
    u, e = rng.standard_normal((2, 800, 2))
    y1 = signal.lfilter([0, 0.4], [1, -0.7], u[:, 0]) + signal.lfilter([0, 0.2], [1, -0.8], u[:, 1]) + 0.1 * e[:, 0]
    y2 = signal.lfilter([0, 0.1], [1, -0.9], u[:, 0]) + 0.1 * e[:, 1]
    seen = []
    for a, b, c, d in ((1, 1, 1, 1), (1e-4, 1e5, 1e5, 1e-2), (1e-3, 1e6, 1e-6, 1e3)):
        data = sa.Dataset.from_arrays({"u1": a * u[:, 0], "u2": b * u[:, 1]}, {"y1": c * y1, "y2": d * y2}, 0.1)
        found = linearize(sa.ARX(na=2, nb=2).fit(data))
        gains = [
            (found.gain(y, n), up / down) for y, up in (("y1", c), ("y2", d)) for n, down in (("u1", a), ("u2", b))
        ]
        seen.append([(g.value / scale, g.std / scale) for g, scale in gains])
    np.testing.assert_allclose(seen[1], seen[0], rtol=1e-4)
    np.testing.assert_allclose(seen[2], seen[0], rtol=1e-4)


def test_bands_of_models_blended_by_speed_are_those_of_their_coefficients():
    """Beside 400 draws of all coefficients: yaw gain, poles and step response between two of its speeds."""
    rng = np.random.default_rng(5)
    n, car = 6000, ALL_MODELS["bicycle, three outputs"]
    u = np.column_stack([0.02 * np.sin(np.cumsum(0.02 + 0.3 * rng.random(n))), 17.0 + 7.0 * np.sin(np.arange(n) / 400)])
    x, y = np.zeros(2), []
    for row in u:
        y.append(np.asarray(car.output(x, row))[:2] + 1e-3 * rng.normal(size=2))
        x = np.asarray(car.step(x, row))
    seen = dict(zip(("v_y", "r"), np.array(y).T, strict=True))
    data = sa.Dataset.from_arrays({"delta": u[:, 0], "v_x": u[:, 1]}, seen, car.dt)
    model = sa.MultiARX(na=2, nb=2, speeds=(12.0, 18.0, 24.0)).fit(data)
    info = model.fit_info
    again = model.with_estimates(info.values)
    assert all(np.array_equal(a, b) for a, b in zip(again.coefficients, model.coefficients, strict=True))
    linear = linearize(model, v_x=16.0)
    draws = rng.multivariate_normal(info.values, info.covariance, 400)
    others = [linearize(replace(model.with_estimates(d), fit_info=None), v_x=16.0) for d in draws]
    gains = [o.gain("r", "delta").value for o in others]
    assert linear.gain("r", "delta").std == pytest.approx(np.std(gains), rel=0.15)
    k = [1, 5, 20]
    response = linear.step("r", "delta", duration=1.0)
    drawn = np.std([o.step("r", "delta", duration=1.0).y[k] for o in others], axis=0)
    assert response.std[k] == pytest.approx(drawn, rel=0.15)
    assert "standard deviations of v_y at 12 m/s: v_y(k-1)" in linear.uncertainty


def test_without_a_fit_there_are_no_bands_and_it_says_why():
    linear = linearize(BICYCLE, v_x=20.0)
    assert np.isnan(linear.step("r", "delta").std).all()
    assert linear.uncertainty == "no bands: it is no fit"
    broken, _ = fitted(share=(np.inf, 0.1))
    assert linearize(broken, v_x=20.0).uncertainty == "no bands: the covariance of the fit is not finite"


def test_a_disturbance_that_nothing_moves_leaves_the_gain_alone():
    pushed = ALL_MODELS["bicycle pushed by a wind"]
    alone = linearize(pushed.model, v_x=20.0).gain("r", "delta").value
    assert linearize(pushed, v_x=20.0).gain("r", "delta").value == pytest.approx(alone, rel=1e-6)


def test_the_ground_is_left_out():
    linear = linearize(OnGround(BICYCLE), v_x=20.0)
    assert linear.states == ("v_y", "r")


def test_an_integrator_has_no_steady_gain():
    linear = linearize(ALL_MODELS["single track, linear tires"], v_x=20.0, hold_speed=False)
    with pytest.raises(ParameterError, match="without end"):
        linear.gain("v_x", "T_f")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "expected v_x, such as"),
        ({"v_x": -3.0}, "v_x is -3 m/s; expected a positive speed"),
        ({"v_x": 20.0, "a_y": np.nan}, "a_y is nan"),
        ({"v_x": 20.0, "inputs": {"dleta": 0.1}}, "no input 'dleta'; nearest are 'delta'"),
        ({"v_x": 20.0, "outputs": ("yaw",)}, "no output or state 'yaw'"),
    ],
)
def test_bad_input_gets_a_sentence(given, said):
    with pytest.raises(ParameterError, match=said):
        linearize(BICYCLE, **given)


def test_bad_questions_get_a_sentence():
    linear = linearize(BICYCLE, v_x=20.0)
    with pytest.raises(ParameterError, match="has no output 'rr'; nearest are 'r'"):
        linear.step("rr")
    with pytest.raises(ParameterError, match="duration is -1 s"):
        linear.step(duration=-1.0)
    with pytest.raises(ParameterError, match="at most 25 Hz"):
        linear.sampled(0.02).bode(frequency=np.array([1.0, 30.0]))
    with pytest.raises(ParameterError, match=r"sampled at 0.02 s already"):
        linear.sampled(0.02).sampled(0.01)
    with pytest.raises(ParameterError, match="knows no speed"):
        linearize(ALL_MODELS["ARX"], v_x=20.0)


def test_python_control_gets_matrices_and_names(monkeypatch):
    linear = linearize(BICYCLE, v_x=20.0)
    given = {}
    fake = types.ModuleType("control")
    fake.ss = lambda *matrices, **names: given.update(names, n=len(matrices)) or "system"
    monkeypatch.setitem(sys.modules, "control", fake)
    assert linear.to_control() == "system"
    assert given == {"states": ["v_y", "r"], "inputs": ["delta", "v_x"], "outputs": ["r", "v_y", "a_y"], "n": 4}
    assert linear.sampled(0.02).to_control() == "system"
    assert given["n"] == 5
    monkeypatch.setitem(sys.modules, "control", None)
    with pytest.raises(ConfigError, match="pip install control"):
        linear.to_control()
