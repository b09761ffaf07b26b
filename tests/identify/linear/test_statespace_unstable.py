"""Unstable systems under a controller are found as such, and nothing that only drifts is taken for one."""

import warnings

import numpy as np
import pytest

import slipangle as sa
from slipangle.data.dataset import Dataset, join
from slipangle.identify.linear.statespace_unstable import unstable_ahead
from tests.identify.car.test_identify_car import logs
from tests.identify.linear.test_statespace import record, system

SAID = "those of an unstable system"
SECOND = 0.6  # pole of what drives the system


def held(pole, noise, samples=1500, seed=0):
    """Records of a first-order system with that pole behind a lag, held by feedback of its measured output."""
    rng = np.random.default_rng(seed)
    A, B, x = np.array([[pole, 0.1], [0.0, SECOND]]), np.array([0.05, 0.5]), np.zeros(2)
    wanted, rows = np.repeat(rng.normal(size=samples // 20 + 1), 20), []
    for k in range(samples):
        y = x[0] + noise * rng.normal()
        u = wanted[k] - 1.12 * y
        rows.append((u, y))
        x = A @ x + B * u
    assert np.abs(rows).max() < 100
    return Dataset.from_arrays({"u": np.array(rows)[:, 0]}, {"y": np.array(rows)[:, 1]}, 0.1)


def fitted(settings, data):
    """The model, and whether its fit said that the system is unstable."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = settings.fit(data)
    return model, any(SAID in str(w.message) for w in caught)


@pytest.mark.parametrize("settings", [sa.StateSpace(order=2), sa.StateSpace()], ids=["order given", "order chosen"])
@pytest.mark.parametrize(("pole", "noise"), [(1.02, 0.001), (1.15, 0.001), (1.02, 0.05), (1.15, 0.05)])
def test_what_only_its_controller_holds_is_found_unstable(settings, pole, noise):
    """Free runs made stable models of these records, of poles 0.58 to 1."""
    model, said = fitted(settings, held(pole, noise))
    assert said
    assert np.abs(model.poles).max() == pytest.approx(pole, abs=2e-3)
    assert np.abs(np.abs(model.poles) - SECOND).min() < 0.05


def test_it_does_not_hang_on_the_rate_of_the_log():
    """An instability of 1 per s at 1 kHz, of which a sample shows next to nothing."""
    rng, dt, x, rows = np.random.default_rng(3), 0.001, 0.0, []
    for k in range(20_000):
        wanted = rng.normal() if k % 400 == 0 else rows[-1][2]
        y = x + 0.01 * rng.normal()
        u = wanted - 2.0 * y
        rows.append((u, y, wanted))
        x += dt * (x + u)
    table = np.array(rows)
    model, said = fitted(sa.StateSpace(order=1), Dataset.from_arrays({"u": table[:, 0]}, {"y": table[:, 1]}, dt))
    assert said
    assert np.log(np.abs(model.poles).max()) / dt == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("pole", "noise"), [(1.02, 0.001), (1.02, 0.05), (1.15, 0.05)])
def test_arx_of_chosen_orders_says_so(pole, noise):
    """With orders that are given it is fitted one step ahead, and unstable by itself."""
    data = held(pole, noise)
    model, said = fitted(sa.ARX(), data)
    assert said
    assert np.abs(model.poles).max() < 1
    assert not fitted(sa.ARX(na=2, nb=2), data)[1]


def at_speeds(data):
    """The same with the speed at which it was driven."""
    v_x = 15.0 + 5.0 * np.sin(0.004 * np.arange(data.n_samples))
    return Dataset.from_arrays({"u": data["u"], "v_x": v_x}, {"y": data["y"]}, data.dt)


@pytest.mark.parametrize(("pole", "noise"), [(1.02, 0.05), (1.15, 0.05), (0.9, 0.05), (1.0, 0.05)])
def test_arx_models_at_speeds_say_so_too(pole, noise):
    model, said = fitted(sa.MultiARX(), at_speeds(held(pole, noise)))
    assert said == (pole > 1)
    assert not said or all(np.abs(m.poles).max() < 1 for m in model.models)


def test_a_car_that_is_another_one_at_every_speed_is_not_unstable():
    data = join(*logs((8.0, 12.0, 16.0, 20.0, 24.0, 28.0), range(6), noise=0.3))
    assert not fitted(sa.MultiARX(), data.select(inputs=("delta", "v_x"), outputs=("v_y", "r")))[1]


def drifting(kind, samples, seed):
    """A stable system with something on its output that no input explains, three times its deviation."""
    data, _ = record(system(2, 1, 1, 90 + seed), samples, seed, noise=0.3)
    t, rng = np.linspace(0.0, 1.0, samples), np.random.default_rng(seed)
    more = {
        "random walk": np.cumsum(rng.normal(size=samples)) / np.sqrt(samples),
        "ramp": t,
        "step": (t > 0.5) * 1.0,
        "growing": np.exp(2 * t - 2),
        "level": np.ones(samples),
    }[kind]
    y = data.y[:, 0] + 3.0 * data.y.std() * more
    return Dataset.from_arrays({"u": data.u[:, 0]}, {"y": y}, data.dt)


@pytest.mark.parametrize(
    ("kind", "samples"),
    [
        ("random walk", 700),
        ("ramp", 700),
        ("step", 2000),
        ("growing", 700),
        ("level", 700),
        *(pytest.param(kind, 2000, marks=pytest.mark.slow) for kind in ("random walk", "ramp", "growing", "level")),
        pytest.param("step", 700, marks=pytest.mark.slow),
    ],
)
def test_what_drifts_is_not_taken_for_unstable(kind, samples):
    for seed in range(3):
        data = drifting(kind, samples, seed)
        assert not any(unstable_ahead(sa.StateSpace(), data, n) for n in (1, 2, 4))
    assert not fitted(sa.StateSpace(order=2), data)[1]


def test_stable_systems_under_a_controller_are_not_either():
    """Nor those whose poles are at the limit of stability."""
    for pole in (0.9, 1.0):
        model, said = fitted(sa.StateSpace(order=2), held(pole, 0.05))
        assert not said
        assert np.abs(model.poles).max() <= 1.001


def test_a_limit_on_poles_is_kept():
    model, said = fitted(sa.StateSpace(order=2, max_radius=0.99), held(1.15, 0.01))
    assert not said
    assert np.abs(model.poles).max() <= 0.99 + 1e-12
