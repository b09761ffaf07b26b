"""Collocation finds the minimum of the free-run error, also where a free run from the start values goes astray."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from slipangle.data.dataset import Dataset
from slipangle.errors import IdentifiabilityWarning, ParameterError
from slipangle.identify.physics.collocation import Collocation
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.custom import Ode
from slipangle.models.vehicles.bicycle import Bicycle, bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.wrappers.delayed import Delayed
from tests.identify.physics.test_grey_box import CASES, drive
from tests.identify.physics.test_grey_box_experiments import CAR, OWN, STIFFNESS, three_drives

FREE = ("C_f", "C_r", "inertia_z")


def idle(p):
    """A constraint that never acts; with one, the solution is Ipopt's alone."""
    return -p.C_f


def quiet(settings, data):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        return settings.fit(data)


def assert_same(a, b, rel):
    assert a.fit_info.names == b.fit_info.names
    assert a.fit_info.values == pytest.approx(b.fit_info.values, rel=rel, abs=1e-9)
    assert a.fit_info.std == pytest.approx(b.fit_info.std, rel=10 * rel)


@pytest.mark.parametrize("constraints", [(), idle])
@pytest.mark.parametrize("case", ["bicycle", "bicycle with v_y"])
def test_it_agrees_with_gauss_newton(case, constraints):
    model, free = CASES[case]
    model = replace(model, method="radau", substeps=1)
    data = drive(model, n=200, noise=0.05)
    start = model.with_values(**{n: 1.2 * model.value(n) for n in free})
    newton = GreyBox(start=start, free=free).fit(data)
    assert_same(Collocation(start=start, free=free, at_most_zero=constraints).fit(data), newton, 1e-6)


@pytest.mark.parametrize("free_initial_state", [False, True])
def test_it_agrees_on_delays_and_parameters_of_every_recording(free_initial_state):
    data = three_drives(noise=0.02, n=120)
    late = Delayed(replace(CAR, method="radau", substeps=1), delays={"delta": 0.06}, longest=0.1)
    how = {
        "start": late,
        "free": (*STIFFNESS, "delay_delta"),
        "per_experiment": OWN,
        "free_initial_state": free_initial_state,
    }
    found = quiet(Collocation(at_most_zero=idle, **how), data)
    assert_same(found, quiet(GreyBox(**how), data), 1e-6)
    assert found.for_experiment(2).value("mass") == pytest.approx(2400, rel=0.1)


# ---- a car that spins ----------------------------------------------------------------------------------------------

SPINNER = Bicycle(
    params=BicycleParams(mass=1500.0, inertia_z=2200.0, wheelbase=2.7, l_f=1.6, C_f=1.1e5, C_r=6e4),
    dt=0.05,
    outputs=("v_y", "r"),
    method="radau",
)
FAST = 30.0  # m/s, above the critical speed


def caught(seed, n=400, noise=0.02):
    """20 s of the oversteering car above its critical speed, kept on the road by a driver."""
    rng = np.random.default_rng(seed)
    unit = np.eye(2)
    A = np.column_stack([SPINNER.derivative(e, np.array([0.0, FAST])) for e in unit])
    B = SPINNER.derivative(np.zeros(2), np.array([1.0, FAST]))[:, None]
    assert np.linalg.eigvals(A).max() > 2.5  # 1/s: e-folds in under 0.4 s
    gain = (B.T @ solve_continuous_are(A, B, np.diag([0.0, 0.05]), np.eye(1)))[0]
    x, rows = np.zeros(2), []
    for k in range(n):
        t = k * SPINNER.dt
        delta = 0.01 * np.sin(2 * np.pi * 0.4 * t) + 0.006 * np.sin(2 * np.pi * 1.1 * t + 1) - gain @ x
        rows.append([delta, *x])
        x = SPINNER.step(x, np.array([delta, FAST]))
    delta, v_y, r = np.array(rows).T
    seen = {
        name: y + noise * y.std() * rng.standard_normal(n) * (np.arange(n) > 0) for name, y in (("v_y", v_y), ("r", r))
    }
    return Dataset.from_arrays({"delta": delta, "v_x": np.full(n, FAST)}, seen, SPINNER.dt)


POOR = SPINNER.with_values(C_f=7e4, C_r=9e4, inertia_z=3000.0)  # understeers
TRUE = np.array([SPINNER.value(n) for n in FREE])


def test_an_unstable_car_is_found_from_poor_start_values():
    data = caught(0)
    shooting = quiet(GreyBox(start=POOR, free=FREE), data).fit_info
    assert np.abs(shooting.values / TRUE - 1).max() > 0.3
    with pytest.warns(IdentifiabilityWarning, match="because the motion is unstable"):
        found = Collocation(start=POOR, free=FREE).fit(data).fit_info
    assert np.abs(found.values / TRUE - 1).max() < 0.02
    assert (np.abs(found.values - TRUE) < 4 * found.std).all()


@pytest.mark.slow
def test_intervals_of_an_unstable_car_are_honest():
    fits = [quiet(Collocation(start=POOR, free=FREE), caught(seed)).fit_info for seed in range(60)]
    stated = np.mean([f.std for f in fits], axis=0)
    spread = np.std([f.values for f in fits], axis=0, ddof=1)
    assert (spread < 1.3 * stated).all()
    assert (spread > 0.6 * stated).all()  # what links the pieces is not counted, so the intervals are on the wide side


# ---- constraints ---------------------------------------------------------------------------------------------------

RATIO = 0.8  # C_f / C_r that the constraint asks for; the data's is 1
SLOW = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, method="radau")


def one_stiffness(x, u, p):
    car = SOUSA_TABLE_7_2.with_values(C_f=RATIO * p.C_r, C_r=p.C_r, inertia_z=p.inertia_z)
    return bicycle(x[0], x[1], u[0], u[1], car)


@pytest.mark.parametrize("kind", ["zero", "at_most_zero"])
def test_an_active_constraint_is_the_model_with_one_parameter_less(kind):
    data = drive(SLOW, n=300, noise=0.05)
    start = SLOW.with_values(C_f=6e4, C_r=1e5)
    limit = {kind: lambda p: p.C_f - RATIO * p.C_r}
    found = quiet(Collocation(start=start, free=FREE, **limit), data)
    reduced = Ode(
        f=one_stiffness,
        states=SLOW.states,
        inputs=SLOW.inputs,
        outputs=("r",),
        params={"C_r": (1e5, 1.0, 1e7), "inertia_z": (3000.0, 1.0, 1e6)},
        dt=SLOW.dt,
        method="radau",
    )
    other = GreyBox(start=reduced, free=("C_r", "inertia_z")).fit(data)
    info, expected = found.fit_info, other.fit_info
    assert found.value("C_f") == pytest.approx(RATIO * found.value("C_r"), rel=1e-6)
    assert info.values[1:] == pytest.approx(expected.values, rel=1e-5)
    assert info.std[1:] == pytest.approx(expected.std, rel=1e-3)
    assert info.std[0] == pytest.approx(RATIO * info.std[1], rel=1e-6)
    assert info.correlation[0, 1] == pytest.approx(1.0, abs=1e-9)


def test_a_car_that_must_understeer_does():
    """The data are of a car that oversteers a little; the constraint holds, and the fit says what it costs."""
    car = SLOW.with_values(C_f=1.35e5, C_r=1.05e5)
    assert car.params.C_f * car.params.l_f > car.params.C_r * car.params.l_r
    data = drive(car, n=300, noise=0.05)
    free = quiet(GreyBox(start=SLOW, free=FREE), data)
    held = quiet(Collocation(start=SLOW, free=FREE, at_most_zero=lambda p: p.C_f * p.l_f - p.C_r * p.l_r), data)
    assert held.params.C_f * held.params.l_f == pytest.approx(held.params.C_r * held.params.l_r, rel=1e-6)
    assert held.fit_info.noise_std > 1.01 * free.fit_info.noise_std


def test_states_keep_their_bounds():
    data = drive(SLOW, n=200)
    most = 0.9 * np.abs(data["r"]).max()
    found = quiet(Collocation(start=SLOW, free=FREE, state_bounds={"r": (-most, most)}), data)
    assert np.abs(found.simulate(data).y[1:]).max() <= most * (1 + 1e-6)
    wide = quiet(Collocation(start=SLOW, free=FREE, state_bounds={"r": (-3.0, 3.0)}), data)
    assert wide.params.C_f == pytest.approx(SLOW.params.C_f, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"state_bounds": {"yaw": (-1, 1)}}, "state_bounds names 'yaw'"),
        ({"at_most_zero": lambda p: p.mass - 1.0}, r"in at_most_zero does not depend on any of \['C_f'"),
    ],
)
def test_bad_settings_are_refused(change, said):
    with pytest.raises(ParameterError, match=said):
        Collocation(**({"start": SLOW, "free": FREE} | change)).fit(drive(SLOW))


@pytest.mark.slow
def test_five_thousand_samples():
    model, free = CASES["nonlinear bicycle"]
    data = drive(model, n=5000, noise=0.05)
    start = model.with_values(**{n: 1.3 * model.value(n) for n in free})
    assert_same(Collocation(start=start, free=free).fit(data), GreyBox(start=start, free=free).fit(data), 1e-6)
