"""Vehicle equations against limit cases that are known in closed form."""

import dataclasses
import warnings

import casadi as ca
import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import MissingColumnError, ModelWarning, ParameterError
from slipangle.models.tires.simple import LinearTire, MagicCurve, SimpleMagicFormula, slip_ratio
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM, SOUSA_TABLE_6_1, SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.kinematic import Kinematic
from slipangle.models.vehicles.longitudinal import Longitudinal, LongitudinalParams
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.units import deg


def steady_yaw_rate(p, v, delta):
    """Yaw rate gain with the understeer gradient, Rajamani 2012 eq. 3.9: r = v delta / (L + K v^2)."""
    understeer = p.mass / p.wheelbase * (p.l_r / p.C_f - p.l_f / p.C_r)
    return v * delta / (p.wheelbase + understeer * v * v)


@pytest.mark.parametrize("v", [5.0, 15.0, 30.0])
@pytest.mark.parametrize("params", [FERRARI_250LM, SOUSA_TABLE_7_2], ids=["Ferrari", "table 7.2"])
def test_bicycle_steady_state_is_the_understeer_gradient(params, v):
    n, delta = 2000, 0.01
    data = Dataset.from_arrays({"delta": np.full(n, delta), "v_x": np.full(n, v)}, {"r": np.zeros(n)}, 0.01)
    r = Bicycle(params=params, dt=0.01).simulate(data).y[-1, 0]
    assert r == pytest.approx(steady_yaw_rate(params, v, delta), rel=1e-6)


def test_bicycle_eigenvalues_are_the_corrected_matrix():
    """The A matrix of eqs. 3-19, 3-20 with the yaw damping -(C_f l_f^2 + C_r l_r^2) / (I_z v)."""
    p, v = SOUSA_TABLE_7_2, 20.0
    C_f, C_r, l_f, l_r, m, Iz = p.C_f, p.C_r, p.l_f, p.l_r, p.mass, p.inertia_z
    A = np.array(
        [
            [-(C_f + C_r) / (m * v), -(C_f * l_f - C_r * l_r) / (m * v) - v],
            [-(C_f * l_f - C_r * l_r) / (Iz * v), -(C_f * l_f**2 + C_r * l_r**2) / (Iz * v)],
        ]
    )
    model = Bicycle(params=p, dt=0.01)
    u = np.array([0.0, v])
    columns = [model.derivative(e, u) for e in np.eye(2)]
    assert np.column_stack(columns) == pytest.approx(A, rel=1e-12)


@pytest.mark.parametrize("v", [0.0, 0.15, 0.6, 8.0])
@pytest.mark.parametrize("kind", [SingleTrack, QuasiSteadySingleTrack])
def test_a_car_a_third_as_long_moves_alike_from_standstill_on(kind, v):
    """Lengths and speeds over 3, mass over 300: forces over 900, inertias and torques over 2700, the same angles."""
    p = SOUSA_TABLE_6_1
    small = dataclasses.replace(
        p,
        **{n: getattr(p, n) / 3 for n in ("wheelbase", "l_f", "radius")},
        **{n: getattr(p, n) / 2700 for n in ("inertia_z", "inertia_wheel_f", "inertia_wheel_r")},
        mass=p.mass / 300,
    )
    tire, soft = (LinearTire(C_alpha=6e4 / k, C_s=9e4 / k) for k in (1.0, 900.0))
    wheels = {"SingleTrack": (1.02 * v / p.radius, 0.9 * v / p.radius)}.get(kind.__name__, ())
    x = np.array([v, 0.1, 0.2, *wheels, 5.0, 2.0, 0.4])
    u, u_scale = np.array([0.08, 60.0, -40.0]), np.array([1.0, 2700.0, 2700.0])
    scale = np.array([3.0, 3.0, 1.0, *(1.0 for _ in wheels), 3.0, 3.0, 1.0])
    given = dict(dt=1e-3) | ({"grip": 1e3} if kind is QuasiSteadySingleTrack else {})
    rate = kind(params=p, tire_f=tire, tire_r=tire, **given).derivative(x, u)
    small_rate = kind(params=small, tire_f=soft, tire_r=soft, **given).derivative(x / scale, u / u_scale)
    assert scale * small_rate == pytest.approx(rate, rel=1e-12)


def test_steering_left_turns_left():
    for model in (
        Bicycle(params=FERRARI_250LM, dt=0.01),
        Kinematic(params=FERRARI_250LM, dt=0.01, outputs=("r",)),
    ):
        rate = model.derivative(np.zeros(model.n_states), np.array([0.05, 20.0]))
        assert rate[-1] > 0


def test_kinematic_drives_a_circle():
    v, delta = 5.0, 0.2
    p = SOUSA_TABLE_7_2
    model = Kinematic(params=p, dt=0.01)
    slope = np.tan(delta) / p.wheelbase
    n = round(2 * np.pi / (v * slope) / 0.01)
    x = np.zeros(3)
    for _ in range(n):
        x = model.step(x, np.array([delta, v]))
    assert x[:2] == pytest.approx(0.0, abs=2 * v * 0.01)
    assert x[2] == pytest.approx(2 * np.pi, abs=0.01)


def test_longitudinal_top_speed_and_stop():
    p = LongitudinalParams(mass=1000.0, k_e=5000.0, k_d=80.0, k_r=0.015)
    model = Longitudinal(params=p, dt=0.05)
    x = np.array([1.0])
    for _ in range(3000):
        x = model.step(x, np.array([1.0]))
    assert x[0] == pytest.approx((5000.0 - 1000.0 * 9.81 * 0.015) / 80.0, rel=1e-4)
    for _ in range(4000):
        x = model.step(x, np.array([0.0]))
    assert x[0] == pytest.approx(0.0, abs=1e-6)


def single_track(tire, dt=0.001, **kwargs):
    return SingleTrack(params=SOUSA_TABLE_6_1, dt=dt, tire_f=tire, tire_r=tire, **kwargs)


def test_single_track_reduces_to_the_bicycle_at_small_angles():
    p, v, C = SOUSA_TABLE_6_1, 20.0, 6e4
    track = single_track(LinearTire(C_alpha=C, C_s=2e5))
    bicycle = BicycleParams(mass=p.mass, inertia_z=p.inertia_z, wheelbase=p.wheelbase, l_f=p.l_f, C_f=2 * C, C_r=2 * C)
    delta = 1e-4
    x, small = track.straight(v), np.zeros(2)
    model = Bicycle(params=bicycle, dt=0.001)
    for _ in range(1000):
        x = track.step(x, np.array([delta, 0.0, 0.0]))
        small = model.step(small, np.array([delta, v]))
    assert x[1:3] == pytest.approx(small, rel=1e-4)


def test_drive_torque_accelerates_and_brake_torque_slows():
    track = single_track(SOUSA_TABLE_6_2)
    for torque in (500.0, -500.0):
        x = track.straight(20.0)
        for _ in range(500):
            x = track.step(x, np.array([0.0, torque, 0.0]))
        # torque spins wheels and car together: m_eff = m + (I_f + I_r) / r^2
        p = SOUSA_TABLE_6_1
        mass = p.mass + (p.inertia_wheel_f + p.inertia_wheel_r) / p.radius**2
        assert x[0] - 20.0 == pytest.approx(torque / p.radius / mass * 0.5, rel=0.02)


def test_single_track_is_left_right_symmetric():
    track = single_track(SOUSA_TABLE_6_2)
    left = right = track.straight(25.0)
    for k in range(400):
        delta = 0.05 * np.sin(0.01 * k)
        left = track.step(left, np.array([delta, 200.0, 0.0]))
        right = track.step(right, np.array([-delta, 200.0, 0.0]))
    mirror = np.array([1, -1, -1, 1, 1, 1, -1, -1])
    assert left == pytest.approx(mirror * right, rel=1e-12, abs=1e-12)


def test_wheel_spin_mode_is_as_stiff_as_stated():
    """About -1500 1/s at 20 m/s on table 6.2's tires, growing as 1 / v_x."""
    track = single_track(SOUSA_TABLE_6_2)

    def fastest(v):
        x, h = track.straight(v), 1e-6
        u = np.zeros(3)
        columns = [(track.derivative(x + h * e, u) - track.derivative(x - h * e, u)) / (2 * h) for e in np.eye(8)]
        return np.linalg.eigvals(np.column_stack(columns)).real.min()

    p, curve = SOUSA_TABLE_6_1, SOUSA_TABLE_6_2.longitudinal
    stiffness = 2 * p.load_f * curve.slope  # N per unit slip, axle
    expected = stiffness / 20.0 * (p.radius**2 / p.inertia_wheel_f + 1 / p.mass)
    assert expected == pytest.approx(1500, rel=0.02)
    assert fastest(20.0) == pytest.approx(-expected, rel=0.01)
    assert fastest(10.0) == pytest.approx(2 * fastest(20.0), rel=0.01)


def test_one_radau_step_of_a_tenth_second_is_accurate():
    fine = single_track(SOUSA_TABLE_6_2, dt=0.1, substeps=400)
    coarse = single_track(SOUSA_TABLE_6_2, dt=0.1, method="radau", substeps=1)
    u = np.array([0.02, 300.0, 0.0])
    scale = np.array([20.0, 1.0, 0.2, 50.0, 50.0, 2.0, 1.0, 0.1])
    first = fine.step(fine.straight(20.0), u)
    # the first step holds the wheels' transient after the torque's step, the next is smooth
    assert (coarse.step(fine.straight(20.0), u) - first) / scale == pytest.approx(0.0, abs=1e-4)
    assert (coarse.step(first, u) - fine.step(first, u)) / scale == pytest.approx(0.0, abs=2e-5)


@pytest.mark.parametrize("omega", [0.0, 20.0, 55.0, 80.0, 207.0])
@pytest.mark.parametrize("torque", [0.0, 1500.0, -2500.0])
def test_radau_brings_locked_and_spinning_wheels_back(omega, torque):
    """Far past the peak of the tire, where undamped Newton steps diverge."""
    fine = single_track(SOUSA_TABLE_6_2, dt=0.1, substeps=400)
    coarse = single_track(SOUSA_TABLE_6_2, dt=0.1, method="radau", substeps=4)
    x = fine.straight(21.0)
    x[3] = omega
    u = np.array([0.01, torque, 0.0])
    scale = np.array([20.0, 1.0, 0.2, 50.0, 50.0, 2.0, 1.0, 0.1])
    assert (coarse.step(x, u) - fine.step(x, u)) / scale == pytest.approx(0.0, abs=0.01)


def test_one_radau_step_survives_any_wheel_speed():
    """Where its stages are not found, many short steps replace the one; the derivative goes through them too."""
    fine = single_track(SOUSA_TABLE_6_2, dt=1e-4, substeps=1).functions[0].fold(1000)
    coarse = single_track(SOUSA_TABLE_6_2, dt=0.1, method="radau").functions[0]
    x, u = ca.MX.sym("x", 8), ca.MX.sym("u", 3)
    slope = ca.Function("slope", [x, u], [ca.jacobian(coarse(x, u), u)])
    far = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        v = rng.uniform(5, 35)
        rolling = v / SOUSA_TABLE_6_1.radius * rng.choice([0, 0.3, 0.8, 1, 1.2, 2, 4], 2)
        state = np.array([v, rng.normal(0, 0.1 * v), rng.normal(0, 0.4), *rolling, 0, 0, 0])
        given = np.array([0.1, 2500.0, 2500.0]) * rng.uniform(-1, 1, 3)
        ends = [np.asarray(f(state, given)).ravel() for f in (coarse, fine)]
        far += np.abs((ends[0] - ends[1]) / (1 + np.abs(ends[1]))).max() > 0.02
        step = np.array([1e-6, 0, 0])  # small: the two ways differ by a jump
        difference = (np.asarray(coarse(state, given + step)) - np.asarray(coarse(state, given - step))).ravel() / 2e-6
        assert np.asarray(slope(state, given))[:, 0] == pytest.approx(difference, rel=1e-2, abs=1e-2), seed
    assert far <= 2  # one step whose stages are found is taken, however coarse


@pytest.mark.parametrize("shares", [(2.1, 3.9), (0.0, 4.0), (0.3, 0.0)])
def test_wheels_that_spin_or_lock_straight_ahead_leave_the_car_straight(shares):
    """Lateral states are rounding errors of rounding errors there, down to 1e-155, which must not become NaN."""
    model = single_track(SOUSA_TABLE_6_2, dt=0.1, method="radau")
    x = model.straight(24.4)
    x[3:5] *= shares
    after = model.step(x, np.zeros(3))
    assert after[[1, 2, 6, 7]] == pytest.approx(0.0, abs=1e-12)
    assert after[5] == pytest.approx(2.44, abs=0.15)


@pytest.mark.parametrize("method", ["euler", "rk4", "radau"])
def test_integrators_have_their_order(method):
    order = {"euler": 1, "rk4": 4, "radau": 5}[method]
    exact = Bicycle(params=SOUSA_TABLE_7_2, dt=0.2, method="radau", substeps=64)
    x, u = np.array([0.3, 0.2]), np.array([0.05, 20.0])
    steps = (16, 32) if method == "euler" else ((8, 16) if method == "rk4" else (1, 2))
    errors = [
        np.abs(Bicycle(params=SOUSA_TABLE_7_2, dt=0.2, method=method, substeps=n).step(x, u) - exact.step(x, u)).max()
        for n in steps
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.6)


def test_magic_formula_matches_the_printed_equation():
    """Values worked out by hand from eqs. 3-16, 3-17 with table 6.2's lateral coefficients at 4 degrees."""
    B, C, D, E, x = 0.154, 1.3, 5367.9, -1.464, 4.0
    phi = (1 - E) * x + E / B * np.arctan(B * x)
    force = D * np.sin(C * np.arctan(B * phi))
    load = 2500 * 9.81 / 4
    assert SOUSA_TABLE_6_2.forces(0.0, deg(x), load).F_y == pytest.approx(force, rel=1e-12)


def test_tire_signs_and_combined_ellipse():
    curve = MagicCurve(B=10.0, C=1.5, D=1.0)
    tire = SimpleMagicFormula(longitudinal=curve, lateral=curve, combined="ellipse")
    for s in np.linspace(-1, 1, 21):
        for a in np.linspace(-0.5, 0.5, 21):
            f = tire.forces(s, a, 1000.0)
            assert np.hypot(f.F_x, f.F_y) <= 1000.0 * (1 + 1e-9)
            assert f.F_x * s >= 0
            assert f.F_y * a >= 0
    pure = SimpleMagicFormula(longitudinal=curve, lateral=curve)
    assert tire.forces(0.05, 0.0, 1000.0).F_x == pytest.approx(pure.forces(0.05, 0.0, 1000.0).F_x, rel=1e-6)


def test_slip_ratio_sign_and_standstill():
    assert slip_ratio(20.0, 22.0, 1.0) == pytest.approx(2.0 / 22.0, rel=1e-3)
    assert slip_ratio(20.0, 18.0, 1.0) == pytest.approx(-2.0 / 20.0, rel=1e-3)
    assert slip_ratio(0.0, 0.0, 1.0) == 0.0
    assert np.isfinite(slip_ratio(-5.0, 3.0, 0.3))


@pytest.mark.parametrize(
    "model", [single_track(SOUSA_TABLE_6_2), Bicycle(params=FERRARI_250LM, dt=0.01)], ids=["st", "b"]
)
def test_standstill_and_reverse_are_finite(model):
    for v in (0.0, 0.1, -3.0):
        x = model.straight(v) if isinstance(model, SingleTrack) else np.zeros(2)
        u = np.array([0.3, 0.0, 0.0]) if isinstance(model, SingleTrack) else np.array([0.3, v])
        for _ in range(200):
            x = model.step(x, u)
        assert np.isfinite(x).all()


@pytest.mark.parametrize(
    ("mass", "wheelbase"), [(0.04, 0.062), (1.5, 0.257), (165.0, 1.05), (1500.0, 2.7), (40000.0, 6.6)]
)
def test_every_size_of_car_is_one_and_a_mass_in_grams_or_tonnes_is_named(mass, wheelbase):
    """From a 1:43 model to a full truck; nobody who reads the sentence has to guess the unit."""
    arm, load = 0.5 * wheelbase, 9.81 * mass
    own = dict(wheelbase=wheelbase, l_f=arm, inertia_z=mass * arm * arm, C_f=5 * load, C_r=6 * load)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        BicycleParams(mass=mass, **own)
    for factor, unit in ((1e-3, "t"), (1e3, "g")):
        wrong = factor * mass
        if 1e-3 <= wrong <= 1e5:
            with pytest.warns(ModelWarning, match=f"mass is .* kg at a wheelbase of .* {unit} are {mass:.5g} kg"):
                BicycleParams(mass=wrong, **own)
        else:
            with pytest.raises(ParameterError, match=r"\(vehicle mass\) is .* check the value and its unit"):
                BicycleParams(mass=wrong, **own)


@pytest.mark.parametrize("l_f", [2.7, 3.0, 12.0])
def test_a_centre_of_gravity_behind_the_rear_axle_is_said(l_f):
    known = dict(mass=1500, wheelbase=2.7, inertia_z=2500, C_f=8e4, C_r=9e4)
    with pytest.warns(ModelWarning, match=f"l_f is {l_f:g} m and the wheelbase 2.7 m; .* between the axles"):
        BicycleParams(l_f=l_f, **known)
    BicycleParams(l_f=2.69, **known)


def test_parameters_out_of_range_say_so():
    with pytest.raises(ParameterError, match=r"mass \(vehicle mass\) is -1 kg; expected 0.001 to 100000 kg"):
        FERRARI_250LM.with_values(mass=-1.0)
    with pytest.raises(ParameterError, match="no parameter 'C_F'; nearest are 'C_f'"):
        FERRARI_250LM.with_values(C_F=1.0)
    with pytest.raises(ParameterError, match="no output 'yaw_rate'"):
        Bicycle(params=FERRARI_250LM, dt=0.01, outputs=("yaw_rate",))
    data = Dataset.from_arrays(
        {"delta": np.zeros(5), "T_f": np.zeros(5), "T_r": np.zeros(5)}, {"r": np.zeros(5)}, 0.001
    )
    with pytest.raises(MissingColumnError, match="no channel 'v_x'"):
        single_track(SOUSA_TABLE_6_2, outputs=("r",)).simulate(data)


@pytest.mark.parametrize("substeps", [2.5, -1, True, "2", None])
def test_substeps_are_counted(substeps):
    with pytest.raises(ParameterError, match=r"substeps is .*; expected a whole number of at least 1, or 0"):
        single_track(SOUSA_TABLE_6_2, dt=0.1, substeps=substeps)
    assert single_track(SOUSA_TABLE_6_2, dt=0.1, substeps=np.int64(3)).substeps == 3


@pytest.mark.parametrize("wrong", ["1500", None, [1500.0]])
def test_a_parameter_that_is_no_number_is_named(wrong):
    own = dict(wheelbase=2.7, l_f=1.3, inertia_z=2500, C_f=8e4, C_r=9e4)
    with pytest.raises(ParameterError, match=r"mass \(vehicle mass\) is .*1500.*|is None; expected a number, "):
        BicycleParams(mass=wrong, **own)
