"""A linear state space as a difference equation: the same free run, and little noise from the outputs it starts at."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ModelWarning
from slipangle.identify.networks.lag_form import in_scaled, lag_form, lag_forms, longest
from slipangle.identify.networks.narx import NARX, free_run_error
from slipangle.identify.networks.problem import Stage
from slipangle.identify.networks.windows import in_units
from slipangle.models.black_box.networks import Scaling
from slipangle.models.black_box.statespace import StateSpaceModel

LEVELS = {"u_offset": [0.5, -1.0], "y_offset": [2.0, 30.0]}
TWO = StateSpaceModel(
    A=[[0.8, 0.3, 0.0], [-0.3, 0.8, 0.1], [0.0, 0.0, 0.6]],
    B=[[1.0, 0.0], [0.5, 0.2], [0.0, 1.0]],
    C=[[1.0, 0.0, 0.5], [0.0, 2.0, -1.0]],
    dt=0.1,
    inputs=("u", "w"),
    outputs=("y", "z"),
    **LEVELS,
)


def record(model, n=300, noise=0.0, seed=0, late=(0, 0)):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((n, model.n_inputs)) + 1.0
    drive = np.column_stack([np.r_[np.zeros(k), u[: n - k, i]] for i, k in enumerate(late[: model.n_inputs])])
    y = np.vstack(
        [model.outputs_at(np.zeros((1, model.order)), drive[:1]), model.free_run(np.zeros(model.order), drive)]
    )
    noisy = y + noise * np.std(y, axis=0) * rng.standard_normal(y.shape)
    signals = [dict(zip(names, z.T, strict=True)) for names, z in ((model.inputs, u), (model.outputs, noisy))]
    return Dataset.from_arrays(*signals, model.dt, name="made"), y


@pytest.mark.parametrize("late", [(0, 0), (2, 7), (12, 12)])
@pytest.mark.parametrize("lags", [2, 3, 9, 14])
def test_the_difference_equation_runs_as_the_state_space_does(lags, late):
    data, _ = record(TWO, late=late)
    model = lag_form(TWO, lags, late)
    assert (model.na, model.nk, model.nb) == (lags, 1 + min(late), lags + max(late) - min(late))
    run = model.simulate(data)
    past = run.t > 4.0  # the record's first samples do not know the inputs before it
    assert np.abs(run.error[past]).max() < 1e-6 * np.std(data.y)


@pytest.mark.parametrize("lags", [2, 3, 9, 14])
def test_its_own_roots_fade(lags):
    poles = np.abs(lag_form(TWO, lags, (0, 0)).poles)
    assert poles.max() < np.abs(TWO.poles).max() + 1e-6


def test_many_lags_pass_on_less_of_the_noise_at_the_start():
    slow = replace(TWO, A=np.diag([0.97, 0.95, 0.9]))
    starts = [record(slow, noise=0.3, seed=s)[0] for s in range(20)]
    few, many = (
        np.mean([free_run_error(lag_form(slow, n, (0, 0)), d) / np.var(d.y, axis=0).mean() for d in starts])
        for n in (2, 12)
    )
    assert many < 0.2
    assert few > 2 * many


def test_the_most_lags_of_those_alike_are_taken_and_none_of_unlike_delays():
    forms = lag_forms(TWO, (0, 0))
    assert [m.na for m in forms] == [12, 7, 4, 2]
    assert [m.na for m in lag_forms(TWO, (0, 24))] == [4, 2]
    assert lag_forms(TWO, (0, 60)) == []
    assert longest(forms, [1.01, 1.0, 3.0, 9.0]) == 0
    assert longest(forms, [np.inf, 2.0, 1.0, 9.0]) == 2
    assert longest(forms, [np.inf] * 4) is None


def test_between_scaled_signals_it_is_the_same():
    data, _ = record(TWO)
    u, y = Scaling.standard(data.u), Scaling.standard(data.y)
    model = lag_form(TWO, 5, (0, 0))
    plain = model.simulate(data).y
    assert in_scaled(model, u, y).simulate(in_units(data, u, y)).y * y.factor + y.offset == pytest.approx(plain)


@pytest.mark.parametrize("late", [0, pytest.param(20, marks=pytest.mark.slow)])
def test_of_a_linear_system_with_noise_the_network_starts_from_the_best_linear_model(late):
    """Half as much noise as signal: ARX and output error of the lags that suit ARX lose several points."""
    one = StateSpaceModel(
        A=[[0.85, 0.35], [-0.35, 0.85]], B=[[1.0], [0.0]], C=[[1.0, 0.5]], dt=0.1, inputs=("u",), outputs=("y",)
    )
    data, _ = record(one, n=1500, noise=0.5, late=(late,))
    test, clean = record(one, n=1500, noise=0.5, late=(late,), seed=5)
    settings = NARX(hidden=(4,), stages=(Stage(horizon=1, epochs=2),))
    settled, chosen = settings.settled(data)
    assert "of a linear state space that ran freely better than models of na = " in chosen.said
    assert chosen.linear.na == settled.na
    assert abs(settled.nk - 1 - late) <= 4
    with pytest.warns(ModelWarning, match="is that linear one"):
        model = settings.fit(data)
    run, known = model.simulate(test), slice(60, None)
    assert np.std(run.y[known] - clean[known]) < 0.06 * np.std(clean)
    _, held = data.split(0.85)
    assert free_run_error(model, held) <= 1.001 * free_run_error(chosen.linear, held)
    assert NARX(na=5).settled(data)[1].linear is None
    assert replace(settings, linear_start=False).settled(data)[1].linear is None
