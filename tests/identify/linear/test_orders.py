"""Orders that ARX and MultiARX choose: by free run on what was held out, never unstable where a stable one exists."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, ModelWarning, ParameterError, TooShortError
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.multi_arx import MultiARX, chosen_speeds
from slipangle.identify.linear.order_trials import Trials, stretches
from slipangle.identify.linear.orders import Orders, choose
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.storage import load, save
from slipangle.models.wrappers.multi_arx import MultiARXModel
from slipangle.report.tables import orders_table
from slipangle.workflow.kinds import KINDS, check_entries

TRUE = ARXModel(A=[-1.5, 0.7], B=[0.5, 0.3], nk=3, dt=0.1, inputs=("u",), outputs=("y",))


def made(n=3000, seed=0, noise=0.05, model=TRUE, measured=0.0, parts=1):
    """A record of the model with equation noise and measurement noise, in one or several experiments."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((n, len(model.inputs)))
    y = np.zeros((n, 1))
    for k in range(model.memory, n):
        past = sum(-model.A[i, 0, 0] * y[k - 1 - i] for i in range(model.na))
        drive = sum(model.B[j] @ u[k - model.nk - j] for j in range(model.nb))
        y[k] = past + drive + model.c + noise * rng.standard_normal(1)
    y += measured * rng.standard_normal(y.shape)
    inputs = {name: u[:, i] for i, name in enumerate(model.inputs)}
    data = Dataset.from_arrays(inputs, {"y": y[:, 0]}, 0.1, name="made")
    cuts = np.linspace(0, n, parts + 1).astype(int)
    return data if parts == 1 else join(*(data.rows(a, b) for a, b in pairwise(cuts)))


def free_run_error(model, data):
    run = model.simulate(data)
    return float(np.sqrt(np.mean(run.error[run.predicted] ** 2)) / np.std(data.y))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("parts", [1, 8])
def test_true_orders_come_back(seed, parts):
    model = ARX().fit(made(seed=seed, parts=parts))
    assert (model.na, model.nb, model.nk) == (2, 2, 3)
    assert model.fit_info.method.startswith("na = 2, nb = 2, nk = 3, chosen of ")


@pytest.mark.parametrize("offset", [False, True])
def test_the_choice_is_as_good_on_unseen_data_as_the_best_of_fixed_orders(offset):
    model = replace(TRUE, c=np.array([2.0 * offset]))
    train, test = (made(seed=s, noise=0.0, measured=0.3, model=model) for s in (1, 2))
    chosen = free_run_error(ARX(offset=offset).fit(train), test)
    fixed = [free_run_error(ARX(na=n, nb=n, offset=offset).fit(train), test) for n in (1, 2, 3)]
    assert chosen <= min(fixed) + 0.01


@pytest.mark.parametrize(("na", "nb", "nk"), [(1, 5, 2), (3, 3, 9), (5, 1, 6)])
def test_few_candidates_find_orders_between_the_levels(na, nb, nk):
    """Poles apart on a circle and distinct coefficients: no fewer lags explain the data."""
    poles = 0.7 * np.exp(1j * np.linspace(0.3, 2.8, na // 2))
    polynomial = np.real(np.poly([*poles, *poles.conj(), *[0.6] * (na % 2)]))
    B = np.linspace(1.0, -0.8, nb)[:, None, None]
    model = ARX().fit(made(model=replace(TRUE, A=polynomial[1:, None, None], B=B, nk=nk), noise=0.02))
    assert (model.na, model.nb, model.nk) == (na, nb, nk)
    assert len(model.fit_info.candidates) <= 80


def test_delays_are_found_for_each_input():
    B = np.zeros((6, 1, 2))
    B[0, 0, 0], B[5, 0, 1] = 1.0, 0.8
    model = ARX().fit(made(model=replace(TRUE, inputs=("u", "w"), B=B, nk=1)))
    lags = {name for name in model.fit_info.names}
    assert {"u(k-1)", "w(k-6)"} <= lags
    assert "w(k-2)" not in lags


def test_orders_that_are_given_are_fitted_as_ever_and_compare_nothing():
    data = made()
    assert ARX(na=2, nb=2) == ARX(na=2, nb=2, nk=1)
    assert ARX() == ARX(na="chosen", nb="chosen", nk="chosen")
    assert ARX(na=2, nb=2).fit(data).fit_info.candidates == ()
    open_delay = ARX(na=2, nb=2, nk="chosen").fit(data)
    given = ARX(na=2, nb=2, nk=3).fit(data)
    assert open_delay.nk == 3
    assert np.array_equal(open_delay.A, given.A)
    assert np.array_equal(open_delay.B, given.B)


def test_the_judged_free_run_is_the_models_own():
    """Held-out errors are those of models fitted without the stretch, run by their own code."""
    data = made(n=400, parts=4, measured=0.2)
    choice = choose(data, na=2, nb=2, nk=1, offset=True)
    trials = Trials(data, Orders(2, (2,), (1,)), True, (0.0,))
    squares, count = 0.0, 0
    spans = stretches(data, 2)
    groups = [[i for i in range(len(spans)) if i % trials.folds == f] for f in range(trials.folds)]
    measured = []
    for group in groups:
        train = join(*(data.rows(*spans[i]) for i in range(len(spans)) if i not in group))
        model = ARX(na=2, nb=2, offset=True).fit(train)
        for i in group:
            run = model.simulate(data.rows(*spans[i]))
            squares += np.sum(run.error[run.predicted] ** 2)
            count += run.predicted.sum()
            measured.append(run.measured[run.predicted])
    assert choice.candidates[0].error == pytest.approx(np.sqrt(squares / count) / np.std(np.vstack(measured)), rel=1e-4)


def drive_at_speeds(n, seed=0):
    """Two outputs by a model whose coefficients go with the speed, which wanders from 4 to 16 m/s."""
    rng = np.random.default_rng(seed)
    u, v_x = rng.standard_normal(n), 10 + 6 * np.sin(np.arange(n) / 57.0)
    y = np.zeros((n, 2))
    for k in range(2, n):
        gain = v_x[k - 1] / 10
        y[k, 0] = 1.2 * y[k - 1, 0] - 0.5 * y[k - 2, 0] + 0.1 * y[k - 1, 1] + gain * u[k - 1]
        y[k, 1] = 0.7 * y[k - 1, 1] + 0.3 * gain * u[k - 2]
    y += 0.1 * rng.standard_normal(y.shape)
    return Dataset.from_arrays({"u": u, "v_x": v_x}, {"y": y[:, 0], "z": y[:, 1]}, 0.1, name="at speeds")


@pytest.mark.parametrize("speeds", [(), (5.0, 9.0, 15.0)])
def test_candidates_run_alike_in_c_and_side_by_side(speeds, monkeypatch):
    """Stretches of unequal length, two outputs, one candidate that blows up."""
    data = drive_at_speeds(700)
    several = [Orders(2, (2,), (1,)), Orders(4, (1,), (2,)), Orders(1, (3,), (3,))]
    if not speeds:
        several = [replace(o, nb=(*o.nb, 1), nk=(*o.nk, 1)) for o in several]
    data = join(data.rows(0, 331), data.rows(331, 700))
    trials = Trials(data, replace(several[1], nb=several[2].nb, nk=several[2].nk), True, speeds)
    picks = [trials._pick(orders) for orders in several]
    theta = trials._solved(picks)[0][:, :-1]
    theta = theta.reshape(3, trials.folds, len(trials.speeds), trials.n_columns, 2)
    theta[2, 1, :, 0] = 1e3
    in_c = trials.stretches.squares(theta, picks)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    side_by_side = replace(trials.stretches).squares(theta, picks)
    assert np.isfinite(in_c[:2]).all()
    assert not np.isfinite(in_c[2, 0]) or in_c[2, 0] > 1e100
    assert in_c[:2] == pytest.approx(side_by_side[:2], rel=1e-9)


@pytest.mark.parametrize("speeds", [(), (5.0, 9.0, 15.0)])
def test_candidates_are_fitted_alike_in_c_and_side_by_side(speeds, monkeypatch):
    """Two outputs, candidates of several sizes, so that columns which are not theirs stay zero."""
    data, inputs = drive_at_speeds(700), 1 if speeds else 2
    several = [Orders(a, (b,) * inputs, (k,) * inputs) for a, b, k in ((2, 2, 1), (4, 1, 2), (1, 1, 3))]
    trials = Trials(data, Orders(4, (3,) * inputs, (3,) * inputs), True, speeds)
    picks = [trials._pick(orders) for orders in several]
    fits, *_ = trials._fits
    in_c = fits.of(picks)
    monkeypatch.setenv("SLIPANGLE_CC", "none")
    theta, rise = replace(fits).of(picks)
    assert in_c[0] == pytest.approx(theta, abs=1e-6 * np.abs(theta).max())
    assert in_c[1] == pytest.approx(rise, rel=1e-9)
    unseen = np.setdiff1d(np.arange(trials.n_columns), picks[1])
    assert not np.any(in_c[0][1][:, :, unseen])


@pytest.mark.parametrize("lags", [1, 3])
def test_models_that_last_are_those_whose_poles_are_inside(lags):
    """Reflection coefficients beside the roots of the polynomials, of which some are outside."""
    data = made(n=400)
    trials = Trials(data, Orders(4, (1,), (1,)), False, ())
    rng = np.random.default_rng(lags)
    theta = np.zeros((200, 1, trials.n_columns, 1))
    theta[:, 0, :lags, 0] = rng.uniform(-1.3, 1.3, (200, lags))
    edge = 10.0 ** (1.0 / trials.longest)
    inside = [bool(np.all(np.abs(np.roots([1.0, *-a])) < edge)) for a in theta[:, 0, :lags, 0]]
    assert 20 < sum(inside) < 180
    assert trials._lasting(theta).tolist() == inside


@pytest.mark.parametrize("offset", [False, True])
def test_normal_equations_of_speeds_are_those_of_the_blended_regression(offset):
    """Beside least squares on regressors written down one by one, three speeds, two outputs, two experiments."""
    data, speeds = drive_at_speeds(600), (5.0, 9.0, 15.0)
    data = join(data.rows(0, 250), data.rows(250, 600))
    model = MultiARX(na=2, nb=2, nk=1, speeds=speeds, offset=offset).fit(data)
    rows, targets = [], []
    for a, b in zip(data.starts, data.stops, strict=True):
        y, u, v_x = data.y[a:b], data["u"][a:b], data["v_x"][a:b]
        for k in range(2, b - a):
            one = [*y[k - 1], *y[k - 2], u[k - 1], u[k - 2], *([1.0] if offset else [])]
            w = [np.interp(v_x[k - 1], speeds, np.eye(3)[j]) for j in range(3)]
            rows.append(np.kron(w, one))
            targets.append(y[k])
    theta = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)[0].reshape(3, -1, 2)
    for own, part in zip(theta, model.models, strict=True):
        assert -np.vstack([part.A[0].T, part.A[1].T]) == pytest.approx(own[:4], rel=1e-6, abs=1e-9)
        assert part.B[:, :, 0] == pytest.approx(own[4:6], rel=1e-6, abs=1e-9)
        assert not offset or part.c == pytest.approx(own[6], rel=1e-6, abs=1e-9)


def test_criteria_are_those_of_the_literature():
    data = made(n=500)
    (candidate,) = choose(data, na=2, nb=2, nk=3, offset=False).candidates
    parts = [data.rows(a, b) for a, b in stretches(data, 4)]
    model = ARX(na=2, nb=2, nk=3).fit(join(*parts))
    info = model.fit_info
    n, d = info.n_samples, 4
    det = float(info.noise_std[0] ** 2) * (n - d) / n / np.std(data.y) ** 2
    assert candidate.aic == pytest.approx(n * np.log(det) + 2 * d)
    assert candidate.bic == pytest.approx(n * np.log(det) + d * np.log(n))
    assert candidate.fpe == pytest.approx(det * (1 + d / n) / (1 - d / n))


def test_unstable_candidates_lose():
    """One lag of a growing oscillation that the data hold back fits a pole outside the circle."""
    data = made(noise=0.0, measured=0.0)
    t = np.arange(3000)
    data = data.with_channel("y", data["y"] + 1e-3 * np.exp(0.004 * t))
    with pytest.warns(ModelWarning, match=r"an unstable system, by a pole of modulus 1\.004;"):  # it is
        model = ARX().fit(data)
    ranked = model.fit_info.candidates
    stable = [c.stable for c in ranked]
    assert False in stable
    assert True in stable
    assert stable[0]
    assert stable == sorted(stable, reverse=True)


def test_noiseless_data_give_the_smallest_orders_that_explain_them():
    model = ARX().fit(made(noise=0.0))
    assert (model.na, model.nb, model.nk) == (2, 2, 3)


@pytest.mark.parametrize("n", [9, 12])
def test_too_short_data_are_said_in_a_sentence(n):
    with pytest.raises(TooShortError, match=r"'made' has .* expected .*: record longer"):
        ARX().fit(made(n=n))


def test_short_data_are_given_fewer_candidates():
    assert ARX().fit(made(n=60)).na <= 3


def test_a_still_input_is_refused_by_name():
    data = made()
    with pytest.raises(ExcitationError, match="the input 'u'"):
        ARX().fit(data.with_channel("u", np.ones(3000)))


def test_one_input_twice_is_refused_rather_than_spread_over_lags():
    data = made()
    with pytest.raises(ExcitationError, match="the inputs w of 'made' are linear combinations of u"):
        ARX().fit(data.with_channel("w", 2 * data["u"]).select(inputs=("u", "w")))


def test_words_that_are_no_order_are_refused():
    with pytest.raises(ParameterError, match=r"^na is 'auto'; expected a whole number of at least 1"):
        ARX(na="auto")


def test_the_table_shows_every_criterion_and_the_choice_first(tmp_path):
    model = ARX().fit(made())
    table = orders_table(model.fit_info)
    assert [c.heading for c in table.columns][:3] == ["orders", "coefficients", "free run [%]"]
    assert table.rows[0].cells[0] == "na = 2, nb = 2, nk = 3"
    assert "AIC" in table.to_text()
    save(model, tmp_path / "model.json")
    assert load(tmp_path / "model.json").fit_info.candidates == model.fit_info.candidates
    with pytest.raises(ParameterError, match="compared no orders"):
        orders_table(ARX(na=1, nb=1).fit(made()).fit_info)


# ---- several speeds --------------------------------------------------------------------------------------------------


def driven(seed=0, noise=0.01, n=1500, speeds=(10.0, 20.0), varying=False):
    """Logs of a blended model with two lags, one experiment per speed, or one whose speed rises."""
    models = tuple(
        ARXModel(A=[-1.4, 0.5 + 0.01 * v], B=[0.01 * v, 0.005 * v], c=[0.1], dt=0.05, inputs=("delta",), outputs=("r",))
        for v in (10.0, 20.0)
    )
    truth = MultiARXModel(models=models, speeds=(10.0, 20.0))
    rng, parts = np.random.default_rng(seed), []
    for v in speeds:
        v_x = np.linspace(9.0, 21.0, n) if varying else np.full(n, v) + 0.02 * rng.standard_normal(n)
        u = np.column_stack([rng.standard_normal(n), v_x])
        x = np.zeros(len(truth.states))
        y = np.zeros(n)
        for k in range(n):
            y[k] = x[0]
            x = np.asarray(truth.step(x, u[k]))
            x[0] += noise * rng.standard_normal()
        parts.append(Dataset.from_arrays({"delta": u[:, 0], "v_x": v_x}, {"r": y}, 0.05, name="driven"))
    return truth, join(*parts)


@pytest.mark.parametrize("varying", [False, True], ids=["speed by speed", "a rising speed"])
def test_models_at_all_speeds_come_back(varying):
    truth, data = driven(varying=varying)
    found = MultiARX(na=2, nb=2, speeds=(10.0, 20.0)).fit(data)
    for ours, true in zip(found.models, truth.models, strict=True):
        assert ours.A == pytest.approx(true.A, abs=0.03)
        assert ours.B == pytest.approx(true.B, abs=0.01)
        assert ours.c == pytest.approx(true.c, abs=0.02)
    info = found.fit_info
    true = np.concatenate([np.r_[-m.A.ravel(), m.B.ravel(), m.c] for m in truth.models])
    assert info.names[0] == "r at 10 m/s: r(k-1)"
    assert np.all(np.abs(info.values - true) < 4.5 * info.std)


def test_at_one_speed_it_is_arx():
    data = made()
    data = data.with_channel("v_x", np.full(3000, 5.0), "m/s").select(inputs=("u", "v_x"))
    found = MultiARX(na=2, nb=2, nk=3, speeds=(5.0,)).fit(data)
    alone = ARX(na=2, nb=2, nk=3, offset=True).fit(data.select(inputs=("u",)))
    assert found.models[0].A == pytest.approx(alone.A, rel=1e-9)
    assert found.models[0].B == pytest.approx(alone.B, rel=1e-9)
    assert found.models[0].c == pytest.approx(alone.c, abs=1e-10)
    assert found.fit_info.covariance == pytest.approx(alone.fit_info.covariance, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("inputs", [("u", "v_x"), ("v_x", "u")])
def test_at_one_speed_lags_are_chosen_of_the_steering_alone(inputs):
    data = made()
    v_x = 5 + 0.05 * np.random.default_rng(1).standard_normal(3000)
    found = MultiARX().fit(data.with_channel("v_x", v_x, "m/s").select(inputs=inputs))
    alone = ARX(offset=True).fit(data)
    (model,) = found.models
    assert (model.inputs, model.na, model.nb, model.nk) == (("u",), alone.na, alone.nb, alone.nk)
    assert model.B == pytest.approx(alone.B, rel=1e-6)


def test_lags_are_chosen_for_all_speeds_at_once(tmp_path):
    _, data = driven()
    model = MultiARX().fit(data)
    assert model.speeds == pytest.approx((10.0, 20.0), rel=0.01)
    assert {(m.na, m.nb, m.nk) for m in model.models} == {(2, 2, 1)}
    assert len(model.fit_info.candidates) > 20
    save(model, tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.fit_info.candidates == model.fit_info.candidates


def test_speeds_stand_where_the_data_are():
    """Not in the gaps, where nothing would tell their coefficients."""
    rng = np.random.default_rng(0)
    v = np.concatenate([c + 0.1 * rng.standard_normal(3000) for c in (6.0, 11.6, 17.3, 23.0)])
    assert chosen_speeds(v) == pytest.approx((6.0, 11.6, 17.3, 23.0), abs=0.1)
    assert len(chosen_speeds(np.linspace(5, 30, 6000))) == 6
    assert len(chosen_speeds(np.linspace(5, 30, 1100))) == 2
    assert chosen_speeds(np.full(40, 7.0)) == (7.0,)
    ends = chosen_speeds(np.linspace(5, 30, 6000))
    assert (ends[0], ends[-1]) == pytest.approx((5, 30), abs=0.1)


def test_a_speed_that_was_not_driven_is_named():
    with pytest.raises(ExcitationError, match="coefficients at 40 m/s open"):
        MultiARX(na=2, nb=2, speeds=(10.0, 20.0, 40.0)).fit(driven()[1])


def test_inputs_speeds_and_lengths_that_do_not_suit_are_said():
    _, data = driven(n=300)
    with pytest.raises(ParameterError, match="expected one, such as delta, and v_x"):
        MultiARX().fit(data.select(inputs=("delta",)))
    with pytest.raises(ParameterError, match="expected rising ones"):
        MultiARX(speeds=(20.0, 10.0))
    with pytest.raises(ParameterError, match=r"^nk is 0; expected"):
        MultiARX(nk=0)
    with pytest.raises(TooShortError, match=r"driven.*expected"):
        MultiARX().fit(data.experiments[0].head(10))
    with pytest.raises(TooShortError, match=r"driven.*expected"):
        MultiARX(na=6, nb=6, speeds=(10.0, 15.0)).fit(data.experiments[0].head(30))


def test_jobs_need_no_orders():
    assert KINDS["arx"]() == ARX()
    assert KINDS["multi-arx"]() == MultiARX()
    entries = check_entries("multi-arx", json.loads('{"na": 1, "nb": 2, "speeds": [10, 20]}'), "model 1")
    assert KINDS["multi-arx"](**entries) == MultiARX(na=1, nb=2, speeds=(10.0, 20.0))
    assert KINDS["arx"](**check_entries("arx", {"nk": "chosen", "na": 2, "nb": 2}, "model 1")).nk == "chosen"
