"""A filter that starts at the first sample's own measurement does not take it in again."""

import numpy as np
import pytest

import slipangle as sa

pytestmark = pytest.mark.filterwarnings("ignore:no C compiler")
MASS = sa.Ode(f=lambda x, u, p: [x[1], p.a * u[0] - x[0]], states=("z", "v"), inputs=("F",), params={"a": 1.0}, dt=0.05)
NOISE = {"z": 0.02, "v": 0.2}
MAKE = [sa.EKF, lambda **s: sa.MHE(horizon=4, **s)]


def driven(seed, n=8):
    """True states and measurements of them."""
    rng = np.random.default_rng(seed)
    x, u = rng.standard_normal(2), rng.standard_normal(n)
    states = np.empty((n, 2))
    for k in range(n):
        states[k] = x
        x = np.asarray(MASS.step(x, u[k : k + 1])) + [0.0, 0.02] * rng.standard_normal(2)
    return states, states + np.array([NOISE["z"], NOISE["v"]]) * rng.standard_normal((n, 2)), u


@pytest.mark.parametrize("make", MAKE)
def test_claimed_variances_are_those_of_the_errors_from_the_first_sample_on(make):
    settings, squares = make(start=MASS, noise_std=NOISE, process_std={"v": 0.1}), []
    tracker = settings.start_at()
    for seed in range(100):
        x, y, u = driven(seed)
        run = tracker.run(sa.Dataset.from_arrays({"F": u}, {"z": y[:, 0], "v": y[:, 1]}, MASS.dt))
        squares.append(((run.states - x) / run.states_std) ** 2)
    assert run.taken.all()
    assert run.states_std[0] == pytest.approx([0.02, 0.2], rel=1e-6)
    assert np.mean(squares, axis=0)[0] == pytest.approx([1, 1], abs=0.3)  # before: twice that
    assert np.mean(squares) == pytest.approx(1, abs=0.15)


@pytest.mark.parametrize("make", MAKE)
def test_begin_then_take_of_the_same_sample_is_one_measurement(make):
    tracker = make(start=MASS, noise_std=NOISE, process_std={"v": 0.1}).begin({"z": 1.0, "v": 2.0, "F": 0.0})
    assert tracker.take({"z": 1.0, "v": 2.0, "F": 0.0}) == pytest.approx([1.0, 2.0])
    assert tracker.state_std == pytest.approx([0.02, 0.2], rel=1e-6)
    assert tracker.take({"z": 1.1, "v": 2.1, "F": 0.0})[0] == pytest.approx(1.1, abs=0.02)
    assert tracker.state_std[0] < 0.02


def test_what_else_is_measured_then_is_taken_in():
    """Another reading of the same sample, a state whose spread is given, a sensor with an offset."""
    settings = {"start": MASS, "noise_std": NOISE}
    tracker = sa.EKF(**settings).begin({"z": 1.0, "F": 0.0})
    tracker.take({"z": 1.02, "v": 2.0, "F": 0.0})
    assert tracker.state == pytest.approx([1.01, 1.0])  # of v nothing was known but that it is about 0
    assert tracker.state_std == pytest.approx(np.array([0.02, 0.2]) / np.sqrt(2), rel=1e-6)
    told = {"z": 1.0, "v": 2.0, "F": 0.0}
    for more in ({"state_std": {"z": 1.0, "v": 1.0}}, {"bias_std": {"z": 0.1, "v": 0.1}}):
        tracker = sa.EKF(**settings, **more).begin(told)
        tracker.take(told)
        assert tracker.taken.all()
