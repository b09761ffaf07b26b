"""Comparison: ranked on the same unseen samples; initial states by least squares; cross-validation leaves out."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import MissingColumnError, ParameterError, SimulationError
from slipangle.identify.judge.compare import compare, cross_validate, horizon_errors
from slipangle.identify.judge.initial import free_run, initial_state
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from tests.models.all_models import ALL_MODELS
from tests.models.test_contracts import record

TRUE = ARXModel(A=[-1.5, 0.7], B=[0.3, 0.2], dt=0.05, inputs=("delta",), outputs=("r",))


def made(n=400, seed=0, noise=0.02, name="log", model=TRUE):
    """Output of the true model from rest plus white noise on the measurement."""
    rng = np.random.default_rng(seed)
    data = Dataset.from_arrays(
        {"delta": np.repeat(rng.normal(size=-(-n // 5)), 5)[:n]}, {"r": np.zeros(n)}, model.dt, name=name
    )
    y = model.simulate(data).channel("r")
    return data.with_channel("r", y + noise * rng.standard_normal(n))


def test_ranks_the_true_model_first_and_a_failure_last():
    data = made(2000)
    models = {
        "unstable": replace(TRUE, A=[-3.0, 0.7]),
        "static gain": replace(TRUE, A=[0.0], B=[2.5]),
        "true": TRUE,
        "one lag": ARX(na=1, nb=1).fit(made(seed=5, name="other")),
    }
    result = compare(models, data)
    assert result.best.name == "true"
    assert result.entries[-1].name == "unstable"
    assert "leaves the finite numbers at sample" in result.entries[-1].failure
    errors = [e.error for e in result.entries]
    assert errors == sorted(errors)
    assert list(result.trajectories) == [e.name for e in result.entries[:-1]]


def test_everyone_is_judged_on_the_same_samples():
    """The errors equal those computed by hand over the samples after the longest memory."""
    data = made(300)
    long = ARX(na=9, nb=4).fit(made(seed=7, name="other"))
    result = compare([TRUE, long], data)
    assert result.n_samples == 300 - 9
    y = data["r"][9:]
    for entry in result.entries:
        e = y - entry.model.simulate(data).channel("r")[9:]
        assert entry.error == pytest.approx(np.linalg.norm(e) / np.linalg.norm(y - y.mean()), rel=1e-12)
        assert entry.scores["r"].rmse == pytest.approx(np.sqrt(np.mean(e**2)), rel=1e-12)
        one = y - entry.model.predict(data).channel("r")[9:]
        assert entry.one_step_error == pytest.approx(np.linalg.norm(one) / np.linalg.norm(y - y.mean()), rel=1e-12)


def test_names_of_a_sequence():
    result = compare([TRUE, TRUE, ALL_MODELS["bicycle"]], made(100).with_channel("v_x", np.full(100, 20.0)))
    assert {e.name for e in result.entries} == {"ARXModel 1", "ARXModel 2", "Bicycle"}


def test_common_outputs_only():
    two = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))
    data = made(100).with_channel("v_x", np.full(100, 20.0)).with_channel("v_y", np.sin(np.arange(100.0)))
    assert compare({"a": TRUE, "b": two}, data).outputs == ("r",)
    assert compare({"b": two}, data).outputs == ("v_y", "r")
    with pytest.raises(MissingColumnError, match="'a' has no output 'v_y', only r"):
        compare({"a": TRUE, "b": two}, data, outputs=["v_y"])
    with pytest.raises(ParameterError, match=r"no output in common \('a' has r; 'c' has v_y\)"):
        compare({"a": TRUE, "c": replace(two, outputs=("v_y",))}, data)


def test_training_data_are_refused():
    data = made()
    model = ARX(na=2, nb=2).fit(data)
    for verdict in (lambda: compare([model], data), lambda: horizon_errors(model, data)):
        with pytest.raises(ParameterError, match="used to fit the model"):
            verdict()
    assert compare([model], data, on_training_data=True).n_samples == 398
    with pytest.raises(ParameterError, match="no model"):
        compare([], data)


# ---- initial state -------------------------------------------------------------------------------------------------


def test_least_squares_start_of_a_linear_model_is_the_closed_form():
    """Stack the model's response to each unit state: that is the whole problem, solved here in one go."""
    data = made(80, noise=0.3)
    m = TRUE.memory
    u = data.u[m - 1 :]
    base = TRUE.free_run(np.zeros(3), u)[:, 0]
    columns = np.column_stack([TRUE.free_run(e, u)[:, 0] - base for e in np.eye(3)])
    expected = np.linalg.lstsq(columns, data["r"][m:] - base, rcond=None)[0]
    found = initial_state(TRUE, data)
    fitted = [TRUE.free_run(x, u) for x in (found, expected)]
    assert fitted[0] == pytest.approx(fitted[1], abs=1e-7)
    run = free_run(TRUE, data, start="least squares")
    assert run.y[m:] == pytest.approx(fitted[1], abs=1e-7)
    assert np.array_equal(run.predicted, TRUE.simulate(data).predicted)
    assert run.kind == "free run, least-squares start"


def test_least_squares_start_finds_the_state_of_a_nonlinear_model():
    model = ALL_MODELS["NARX"]
    data = record(model)
    x0 = np.array([0.2, -0.1, 0.03])
    y = np.vstack([data.y[: model.memory], model.free_run(x0, data.u[model.memory - 1 :])])
    own = data.with_channel("r", y[:, 0])
    assert free_run(model, own, start="least squares").error[model.memory :] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(free_run(model, own).error).max() > 1e-3


@pytest.mark.parametrize("name", [n for n in ALL_MODELS if "Radau" not in n and "dual" not in n])  # those take seconds
def test_least_squares_start_is_never_worse(name):
    model = ALL_MODELS[name]
    data = record(model, n=60)
    spread = data.select(outputs=model.outputs).y.std(axis=0)
    first, best = (free_run(model, data, start=start) for start in ("first samples", "least squares"))
    squares = [np.sum((run.error[run.predicted] / spread) ** 2) for run in (first, best)]
    assert squares[1] <= squares[0] * (1 + 1e-12)


def test_each_experiment_gets_its_own_state():
    data = join(made(100, seed=0, noise=0.3), made(60, seed=1, noise=0.3))
    whole = free_run(TRUE, data, start="least squares").y
    parts = [free_run(TRUE, part, start="least squares").y for part in data.experiments]
    assert np.array_equal(whole, np.vstack(parts))


def test_bad_starts():
    data = made(50)
    with pytest.raises(ParameterError, match=r"'least square'.*least squares"):
        free_run(TRUE, data, start="least square")
    with pytest.raises(ParameterError, match="2 start states for 1 experiments"):
        TRUE.simulate(data, start=[np.zeros(3), np.zeros(3)])
    with pytest.raises(SimulationError):
        free_run(replace(TRUE, A=[-50.0, 0.7]), made(400), start="least squares")


# ---- k steps ahead -------------------------------------------------------------------------------------------------


def test_horizon_errors_by_hand():
    data = made(120, noise=0.2)
    result = horizon_errors(TRUE, data, (3, 1, 500))
    assert result.horizons.tolist() == [1, 3]
    rows = slice(TRUE.memory + 2, None)  # those that three steps ahead can reach
    y, u = data["r"], data["delta"]
    three = []
    for k in range(TRUE.memory + 2, 120):
        past = [y[k - 3], y[k - 4]] if k >= 4 else None
        for j in range(k - 2, k + 1):
            past = [1.5 * past[0] - 0.7 * past[1] + 0.3 * u[j - 1] + 0.2 * u[j - 2], *past]
        three.append(past[0])
    assert result.rmse[1, 0] == pytest.approx(np.sqrt(np.mean((y[rows] - three) ** 2)), rel=1e-9)
    free = TRUE.simulate(data)
    assert result.free_run[0] == pytest.approx(np.sqrt(np.mean(free.error[rows] ** 2)), rel=1e-12)


def test_long_horizons_approach_the_free_run():
    result = horizon_errors(TRUE, made(800, noise=0.3), (1, 100, 300))
    assert result.rmse[-1] == pytest.approx(result.free_run, rel=1e-3)


def test_horizons_without_room():
    with pytest.raises(ParameterError, match=r"\[90\].*up to 48"):
        horizon_errors(TRUE, made(50), (90,))


# ---- cross-validation ----------------------------------------------------------------------------------------------


class Spy:
    """Fits ARX and remembers what it was shown."""

    def __init__(self):
        self.seen = []

    def fit(self, data):
        self.seen.append(data)
        return ARX(na=2, nb=2).fit(data)


def test_each_experiment_is_left_out_once_and_never_seen():
    data = join(*(made(100 + 20 * i, seed=i) for i in range(3)))
    spy = Spy()
    result = cross_validate(spy, data)
    assert len(result.folds) == 3
    for held, rest, fold in zip(data.experiments, spy.seen, result.folds, strict=True):
        assert rest.n_samples == data.n_samples - held.n_samples
        assert len(rest.experiments) == 2
        assert not np.isin(held["r"], rest["r"]).any()
        alone = ARX(na=2, nb=2).fit(rest).simulate(held)
        e = alone.error[alone.predicted, 0]
        y = held["r"][alone.predicted]
        assert fold.error == pytest.approx(np.linalg.norm(e) / np.linalg.norm(y - y.mean()), rel=1e-12)
    assert result.error == pytest.approx(np.mean([f.error for f in result.folds]))
    assert result.fit("r") == pytest.approx([100 * (1 - f.error) for f in result.folds])


def test_one_record_is_cut_into_folds():
    data = made(403)
    spy, told = Spy(), []
    result = cross_validate(spy, data, folds=4, progress=lambda share, what: told.append(share))
    assert [s.n_samples for s in spy.seen] == [302, 302, 303, 302]
    assert [len(s.experiments) for s in spy.seen] == [1, 2, 2, 1]
    assert sum(403 - s.n_samples for s in spy.seen) == 403
    assert result.folds[1].spans == ((pytest.approx(101 * 0.05), pytest.approx(201 * 0.05)),)
    assert told == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_failed_fold_says_why():
    class Bad:
        def fit(self, data):
            return replace(TRUE, A=[-30.0, 0.7])

    result = cross_validate(Bad(), made(1200), folds=2)
    assert result.error == np.inf
    assert "leaves the finite numbers" in result.folds[0].failure
    assert np.isnan(result.fit("r")).all()


def test_a_fold_without_motion_fails_alone():
    """Its output is constant, so that there is no score; the others have theirs."""
    data = made(1200)
    r = data["r"].copy()
    r[300:600] = 0.0
    result = cross_validate(Spy(), data.with_channel("r", r), folds=4)
    assert [bool(fold.failure) for fold in result.folds] == [False, True, False, False]
    assert "constant" in result.folds[1].failure
    assert result.error == np.inf


@pytest.mark.parametrize("folds", [None, 1, 500, "a", 2.5, np.nan, True, [3]])
def test_too_few_folds(folds):
    with pytest.raises(ParameterError, match="expected"):
        cross_validate(Spy(), made(200), folds=folds)


@pytest.mark.filterwarnings("error")
def test_no_more_folds_than_a_free_run_has_room_for():
    """Every stretch has two samples after those that the model begins with; or it is said how many there may be."""
    data, taken = made(200), TRUE.memory
    most = 200 // (taken + 2)
    result = cross_validate(Spy(), data, folds=np.int64(most))
    assert len(result.folds) == most
    assert all(fold.scores or fold.failure for fold in result.folds)
    for folds in (most + 1, 100):
        with pytest.raises(ParameterError, match=f"folds is {folds}, and a model takes {taken} .*at most {most}:"):
            cross_validate(Spy(), data, folds=folds)
    short = replace(data, starts=(0, 100, 200 - taken), start_times=(0.0, 1e3, 2e3))
    fold = cross_validate(Spy(), short).folds[2]
    assert f"its longest experiment has {taken} samples" in fold.failure
    failed = replace(result, folds=(fold, fold))
    assert str(failed).count("nan") == 0
    assert "2 folds, all failed: its longest experiment" in str(failed)


def test_cross_validated_order_of_the_true_system():
    """With noise on the measurement and few samples, two lags beat one out of sample."""
    data = join(*(made(150, seed=i) for i in range(4)))
    errors = [cross_validate(ARX(na=n, nb=n), data).error for n in (1, 2)]
    assert errors[1] < 0.5 * errors[0]


def test_validate_agrees_with_compare():
    data = made(200)
    entry = compare([TRUE], data).best
    assert validate(TRUE, data).free_run_scores["r"] == entry.scores["r"]
