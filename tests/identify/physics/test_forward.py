"""Free runs with their derivatives, beside differences of free runs without: every integrator, any count of columns."""

import numpy as np
import pytest

from slipangle.identify.physics import forward as module
from slipangle.identify.physics.forward import forward
from slipangle.identify.physics.forward_code import width
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.wrappers.delayed import Delayed

RATE = 0.05
PARAMETERS = (*("C_f", "C_r", "inertia_z", "mass", "l_f"), *("steering_offset", "steering_gain", "bias_r", "bias_a_y"))


def car(method="rk4"):
    return Bicycle(params=SOUSA_TABLE_7_2, dt=RATE, outputs=("v_y", "r", "a_y"), method=method, substeps=2)


def rows_of(model, n=40, seed=0):
    t, wide = RATE * np.arange(n), width(model)
    turns = 0.03 * np.sin(2.0 * t[:, None] + np.arange(wide - 1))
    return np.column_stack([turns, 20.0 + np.sin(t)]) if wide > 2 else np.column_stack([turns[:, 0], 20.0 + np.sin(t)])


@pytest.mark.parametrize("method", ["rk4", "euler", "radau"])
@pytest.mark.parametrize("count", [1, 2, 5, 9])
@pytest.mark.parametrize("starts", [False, True])
def test_derivatives_are_those_of_free_runs_beside(method, count, starts):
    model = car(method)
    free = PARAMETERS[:count]
    run, p = forward(model, free), np.array([model.value(name) for name in free])
    rows, x0 = rows_of(model), np.array([0.3, -0.1])
    S0 = np.hstack([np.zeros((2, count)), np.eye(2)]) if starts else np.zeros((2, count))
    full = run(x0, S0, rows, p)
    assert full.shape == (len(rows), 3, 1 + S0.shape[1])
    none = np.zeros((2, 0))
    assert full[:, :, 0] == pytest.approx(run(x0, none, rows, p)[:, :, 0], rel=1e-12, abs=1e-12)
    for j in range(S0.shape[1]):
        h = 1e-4 * max(abs(p[j]), 0.1) if j < count else 1e-4
        ends = [run(x0 + s * h * S0[:, j], none, rows, p + s * h * (np.arange(count) == j))[:, :, 0] for s in (1, -1)]
        slope = (ends[0] - ends[1]) / (2 * h)
        assert full[:, :, 1 + j] == pytest.approx(slope, rel=1e-5, abs=1e-5 * np.abs(slope).max() + 1e-12), free[j:]


def test_a_delay_that_is_free_is_among_them():
    model = Delayed(car(), delays={"delta": 0.08}, longest=0.3)
    free = ("C_f", "delay_delta")
    run, p = forward(model, free), np.array([model.value(name) for name in free])
    rows, x0 = rows_of(model), np.zeros(2)
    full = run(x0, np.zeros((2, 2)), rows, p)
    h = 1e-5
    late, early = (run(x0, np.zeros((2, 0)), rows, p + np.array([0.0, d]))[:, :, 0] for d in (h, -h))
    slope = (late - early) / (2 * h)
    assert np.abs(slope).max() > 0.01
    assert full[:, :, 2] == pytest.approx(slope, rel=1e-4, abs=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("free", [("delay_delta", "C_f"), ("C_f", "delay_v_x"), ("steering_offset", "l_f", "C_f")])
def test_any_order_and_any_of_two_delays_give_the_same_columns(free):
    model = Delayed(car(), delays={"delta": 0.08, "v_x": 0.03}, longest=0.3)
    every = ("C_f", "l_f", "steering_offset", "delay_delta", "delay_v_x")
    rows, x0 = rows_of(model), np.array([0.2, 0.1])
    S0 = np.random.default_rng(0).normal(size=(2, len(every)))

    def made(names):
        run, of_start = forward(model, names), S0[:, [every.index(n) for n in names]]
        return run(x0, np.hstack([of_start, np.eye(2)]), rows, np.array([model.value(n) for n in names]))

    full, some = made(every), made(free)
    columns = [0, *(1 + every.index(n) for n in free), len(every) + 1, len(every) + 2]
    assert np.abs(full[:, :, 1:]).max(axis=(0, 1)).min() > 0
    assert some == pytest.approx(full[:, :, columns], rel=1e-9, abs=1e-12)


def test_many_runs_at_once_are_each_to_the_last_bit(monkeypatch):
    monkeypatch.setattr(module, "_LONG", 1)
    monkeypatch.setattr("os.cpu_count", lambda: 4)
    model, free = car(), PARAMETERS[:3]
    run, p = forward(model, free), np.array([model.value(name) for name in free])
    given = [(np.array([0.1 * k, 0.0]), np.zeros((2, 3)), rows_of(model, 30 + k), p) for k in range(6)]
    for alone, beside in zip([run(*one) for one in given], run.many(given), strict=True):
        np.testing.assert_array_equal(alone, beside)
