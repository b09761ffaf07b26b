"""The filter as an observer of any model: against plain NumPy, late, missing, offset, outliers, consistent."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.moving_horizon import MHE
from slipangle.estimate.observed import Observed
from slipangle.identify.linear.arx import ARX
from slipangle.models.black_box.narx import NARXModel
from slipangle.models.black_box.networks import MLP, Scaling
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from slipangle.models.wrappers.hybrid import HybridModel
from slipangle.models.wrappers.on_ground import OnGround
from tests.estimate.test_ekf import drive
from tests.oracles import kalman

BICYCLE = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05, outputs=("v_y", "r"))
LATE = Delayed(Steered(BICYCLE, steering_lag=0.05), delays={"delta": 0.07}, longest=0.1)
NOISE = {"v_y": 0.05, "r": 0.01, "X": 0.05, "Y": 0.05, "psi": 0.004}


def network():
    small = Scaling(offset=[0.0] * 2, factor=[0.05] * 2)
    return NARXModel(
        network=MLP.random((8, 6, 2), activation="tanh", seed=3, output_scaling=small),
        na=2,
        nb=2,
        dt=0.05,
        inputs=("delta", "v_x"),
        outputs=("v_y", "r"),
    )


def model_named(name):
    noise = {"v_y": 0.01, "r": 0.001}
    known = {
        "bicycle": lambda: BICYCLE,
        "late": lambda: LATE,
        "late, on the ground": lambda: OnGround(LATE),
        "ARX": lambda: ARX(na=2, nb=2).fit(drive(BICYCLE, 200, 11, noise=noise)),
        "NARX": network,
        "hybrid": lambda: HybridModel(base=BICYCLE, discrepancy=network(), gain=0.3),
    }
    return known[name]()


def driven(model, n, seed, x0=None, noise=NOISE):
    """True states, noisy outputs and inputs of a drive."""
    rng = np.random.default_rng(seed)
    u = np.column_stack([0.03 * np.sin(0.15 * np.arange(n)), np.full(n, 20.0) + np.sin(0.05 * np.arange(n))])
    x = np.zeros(model.n_states) if x0 is None else x0
    states, y = [], []
    step, output, _ = model.functions
    for k in range(n):
        states.append(x)
        size = np.array([noise[name] for name in model.outputs])
        y.append(output(x, u[k]).full()[:, 0] + size * rng.standard_normal(len(size)))
        x = step(x, u[k]).full()[:, 0]
    return np.array(states), np.array(y), u


def settings_of(model, **more):
    std = {name: 0.3 for name in model.states}
    given = {"noise_std": {n: NOISE[n] for n in model.outputs}, "process_std": dict.fromkeys(model.states, 0.02)}
    return EKF(start=model, **given, state_std=std, **more)


def oracle(model, settings, u, y, offsets=()):
    """The filter of tests.oracles.kalman with the same settings; ``offsets`` name outputs with a constant bias."""
    nx, nb = model.n_states, len(offsets)
    step, output, _ = model.functions
    places = [model.outputs.index(name) for name in offsets]

    def told(z, now):
        seen = output(z[:nx], now).full()[:, 0]
        seen[places] += z[nx:]
        return seen

    R = np.diag([settings.noise(n) ** 2 for n in model.outputs])
    Q = np.diag([settings.dt * 0.02**2] * nx + [0.0] * nb)
    P = np.diag([0.3**2] * nx + [settings.bias_std[n] ** 2 for n in offsets])

    def moved(z, now):
        return np.append(step(z[:nx], now).full()[:, 0], z[nx:])

    return kalman.run(moved, told, np.zeros(nx + nb), P, Q, R, u, y)


@pytest.mark.parametrize("name", ["bicycle", "late", "late, on the ground", "ARX", "NARX", "hybrid"])
def test_any_model_is_observed_as_by_a_filter_in_plain_numpy(name):
    """With samples missing and one channel slower than the others."""
    model = model_named(name)
    _, y, u = driven(model, 40, 1)
    y[::3, 0] = np.nan
    y[10:15] = np.nan
    if model.n_outputs > 2:
        y[np.arange(40) % 4 != 0, 2:] = np.nan
    settings = settings_of(model)
    tracker = settings.start_at()
    x, P = oracle(model, settings, u, y)
    for k in range(len(u)):
        tracker.update(y[k], u[k])
        assert tracker.state == pytest.approx(x[k], abs=1e-6)
        assert tracker.state_covariance == pytest.approx(P[k], abs=1e-6)


@pytest.mark.parametrize("late", [{"X": 0.1, "Y": 0.1, "psi": 0.1}, {"X": 0.15, "r": 0.05}])
def test_late_outputs_count_where_they_belong(late):
    """At every sample the filter is where one is that has all that arrived by then, in order."""
    model = OnGround(LATE)
    _, y, u = driven(model, 25, 2)
    settings = settings_of(model, late=late, bias_std={"r": 0.05})
    steps = [round(late.get(n, 0.0) / model.dt) for n in model.outputs]
    tracker = settings.start_at()
    for k in range(len(u)):
        arrived = np.array([y[k - d, i] if k >= d else np.nan for i, d in enumerate(steps)])
        error = tracker.update(arrived, u[k])
        assert (error[np.isnan(arrived)] == 0).all()
        if k % 6 == 5:
            known = np.array([[y[j, i] if j <= k - d else np.nan for i, d in enumerate(steps)] for j in range(k + 1)])
            x, _ = oracle(model, settings, u[: k + 1], known, offsets=("r",))
            assert np.append(tracker.state, tracker.biases) == pytest.approx(x[-1], abs=1e-6)


def test_offsets_of_sensors_are_found():
    model = OnGround(BICYCLE)
    _, y, u = driven(model, 200, 3)
    y[:, model.outputs.index("r")] += 0.03
    settings = EKF(start=model, noise_std=NOISE, bias_std={"r": 0.1, "v_y": 0.3}, process_std={"r": 0.002})
    tracker = settings.start_at()
    for k in range(len(u)):
        tracker.update(y[k], u[k])
    assert np.abs(tracker.biases - [0.03, 0.0]).max() < 4 * tracker.biases_std.max()
    assert tracker.biases_std[0] < 0.002
    assert tracker.biases[0] == pytest.approx(0.03, abs=4 * tracker.biases_std[0])


def test_outliers_are_left_out_until_there_are_too_many_in_a_row():
    _, y, u = driven(BICYCLE, 60, 4)
    y[20, 1] += 1.0
    y[30:50, 1] += 1.0
    settings = settings_of(BICYCLE, gate=4.0, patience=5)
    tracker, clean = settings.start_at(), settings.start_at()
    taken = []
    for k in range(60):
        tracker.update(y[k], u[k])
        clean.update(np.where([False, k == 20], np.nan, y[k]), u[k])
        taken.append(tracker.taken[1])
        if k < 30:
            assert tracker.state == pytest.approx(clean.state, abs=1e-12)
    error, std = tracker.innovation
    assert np.isfinite(error).all()
    assert (std > 0).all()
    assert not taken[20]
    assert taken[30:36] == [False] * 5 + [True]
    assert sum(taken[:20]) == 20


@pytest.mark.parametrize("gate", [5, np.float32(5.0)], ids=["int", "single"])
@pytest.mark.parametrize("kind", [EKF, MHE])
def test_a_gate_is_the_same_as_an_integer(kind, gate):
    y, u = driven(BICYCLE, 30, 4)[1:]
    noise, process = ({n: NOISE[n] for n in BICYCLE.outputs}, dict.fromkeys(BICYCLE.states, 0.02))
    common = {"start": BICYCLE, "noise_std": noise, "process_std": process}
    same = [kind(**common, gate=g).start_at() for g in (gate, 5.0)]
    for k in range(30):
        for tracker in same:
            tracker.update(y[k], u[k])
        assert same[0].taken.all()
        np.testing.assert_array_equal(same[0].state, same[1].state)


def gated(model, y, u, name):
    """A filter whose gate opens after five outliers, one without a gate, and when the former took an output in."""
    filters = [settings_of(model, gate=gate, patience=5).start_at() for gate in (4.0, None)]
    taken = []
    for k in range(len(u)):
        for tracker in filters:
            tracker.update(y[k], u[k])
        taken.append(bool(filters[0].taken[model.outputs.index(name)]))
    return *filters, taken


def test_a_gate_that_opened_stays_open_until_filter_and_sensor_agree():
    """A position that jumped is found as well as without a gate, and the gate guards it from then on."""
    model = OnGround(BICYCLE)
    _, y, u = driven(model, 150, 4)
    y[30:, model.outputs.index("X")] += 5.0
    guarded, open_, taken = gated(model, y, u, "X")
    assert taken[30:] == [False] * 5 + [True] * 115
    assert guarded.state == pytest.approx(open_.state, abs=0.01)
    assert guarded.n_outliers.sum() == 5
    assert open_.n_outliers.sum() == 0
    y[149, model.outputs.index("X")] += 1.0
    guarded, _, taken = gated(model, y, u, "X")
    assert not taken[149]
    assert guarded.n_outliers.sum() == 6


def test_values_to_both_sides_are_never_believed():
    """A broken sensor whose values jump about, for longer than any patience; the others go on."""
    _, y, u = driven(BICYCLE, 150, 4)
    y[30:, 1] += np.where(np.arange(120) % 4 < 3, 1e6, -1e6)
    blind = y.copy()
    blind[30:, 1] = np.nan
    guarded, _, taken = gated(BICYCLE, y, u, "r")
    spared, _, _ = gated(BICYCLE, blind, u, "r")
    assert not any(taken[30:])
    assert guarded.n_outliers.tolist() == [0, 120]
    assert guarded.state == pytest.approx(spared.state, abs=1e-12)


def test_errors_and_innovations_are_as_large_as_stated():
    """Squares over covariances, summed over 20 seeds, within the 99.9 % range of chi-square."""
    from scipy.stats import chi2

    model, size = OnGround(BICYCLE), 0.05
    process = {"v_y": size, "r": 0.5 * size}
    settings = EKF(start=model, noise_std=NOISE, process_std=process, state_std=dict.fromkeys(model.states, 0.05))
    square, innovations, count = 0.0, 0.0, 0
    step, output, _ = model.functions
    for seed in range(20):
        rng = np.random.default_rng(50 + seed)
        x, tracker = 0.05 * rng.standard_normal(5), settings.start_at()
        u = np.array([0.01, 20.0])
        for _ in range(25):
            y = output(x, u).full()[:, 0] + rng.standard_normal(5) * [NOISE[n] for n in model.outputs]
            if rng.uniform() < 0.3:
                y[2:] = np.nan
            tracker.update(y, u)
            error, std = tracker.innovation
            innovations += np.nansum((error[:1] / std[:1]) ** 2)
            count += 1
            shaken = x.copy()
            x = step(shaken, u).full()[:, 0]
            x[:2] += np.sqrt(model.dt) * size * rng.standard_normal(2) * [1.0, 0.5]
        off = shaken - tracker.state
        square += off @ np.linalg.solve(tracker.state_covariance, off)
    low, high = chi2.ppf([0.0005, 0.9995], 100)
    assert low < square < high
    low, high = chi2.ppf([0.0005, 0.9995], count)
    assert low < innovations < high


def test_parameters_behind_a_delay_and_on_the_ground_are_found():
    true = OnGround(LATE)
    _, y, u = driven(true, 300, 5)
    u = np.column_stack([np.repeat(0.03 * np.random.default_rng(1).standard_normal(60), 5), np.full(300, 20.0)])
    x, rows = np.zeros(true.n_states), []
    rng = np.random.default_rng(2)
    for k in range(300):
        rows.append(true.functions[1](x, u[k]).full()[:, 0] + rng.standard_normal(5) * [NOISE[n] for n in true.outputs])
        x = true.functions[0](x, u[k]).full()[:, 0]
    wrong = LATE.with_values(C_f=0.8 * LATE.value("C_f"), delay_delta=0.04)
    settings = EKF(start=OnGround(wrong), free=("C_f", "delay_delta"), noise_std=NOISE)
    tracker = settings.start_at()
    for y, now in zip(rows, u, strict=True):
        tracker.update(y, now)
    found = tracker.model()
    assert found.model.value("C_f") == pytest.approx(LATE.value("C_f"), rel=0.03)
    assert found.model.value("delay_delta") == pytest.approx(0.07, abs=0.006)
    assert found.fit_info.names == ("C_f", "delay_delta")


def test_channels_by_name_may_be_missing_or_held():
    model = OnGround(LATE)
    settings = settings_of(model)
    by_name, plain = settings.begin({"X": 3.0, "delta": 0.01, "v_x": 20.0}), settings.start_at()
    plain.restart(by_name.state)
    assert by_name.state[model.states.index("delta(k-2)")] == 0.01
    assert by_name.state[model.states.index("delta_s")] == 0.01
    assert by_name.state[model.states.index("X")] == 3.0
    nan = np.nan
    for measured, y in (
        ({"r": 0.1, "X": 3.1, "v_y": nan, "v_x": 20.0, "delta": 0.01}, [nan, 0.1, 3.1, nan, nan]),
        ({"r": 0.1, "X": 4.1, "v_x": nan}, [nan, nan, 4.1, nan, nan]),
        ({"r": 0.2, "X": 4.1, "psi": np.inf}, [nan, 0.2, nan, nan, nan]),
    ):
        by_name.take(measured)
        plain.update(y, [0.01, 20.0])
        assert by_name.state == pytest.approx(plain.state, abs=1e-14)
    by_name.hold({"delta": 0.02, "other": 1.0})
    assert by_name.inputs.tolist() == [0.02, 20.0]


def test_a_record_with_an_output_from_elsewhere():
    """It may have gaps, which data may not; without it the record is run as it is."""
    data = drive(BICYCLE, 40, 9, noise=NOISE)
    settings = settings_of(BICYCLE)
    slow = np.where(np.arange(40) % 5 == 0, data["v_y"], np.nan)
    run, tracker = settings.start_at().run(data, measured={"v_y": slow}), settings.start_at()
    tracker.restart(BICYCLE.initial_state(data.head(1)))
    for k in range(40):
        tracker.update([slow[k], data["r"][k]], [data["delta"][k], data["v_x"][k]])
        assert np.array_equal(run.states[k], tracker.state)
    whole = settings.start_at().run(data)
    assert np.array_equal(whole.states, settings.start_at().run(data, measured={"v_y": data["v_y"]}).states)
    with pytest.raises(ParameterError, match="measured names 'vy'; nearest are 'v_y'"):
        settings.start_at().run(data, measured={"vy": slow})
    with pytest.raises(ParameterError, match=r"measured\['v_y'\] has the shape \(39,\), the data 40 samples"):
        settings.start_at().run(data, measured={"v_y": slow[1:]})


def test_noise_is_that_of_the_fit():
    arx = model_named("ARX")
    assert EKF(start=arx).noise("r") == arx.fit_info.noise_std[1]
    assert EKF(start=OnGround(arx)).noise("X") == 0.02
    with pytest.raises(ParameterError, match="noise_std lacks the measured output 'v_y'"):
        EKF(start=BICYCLE)
    with pytest.raises(ParameterError, match="a HybridModel has no named parameters"):
        EKF(start=model_named("hybrid"), free=("C_f",), noise_std=NOISE)
    with pytest.raises(ParameterError, match="late names 'x'"):
        EKF(start=OnGround(BICYCLE), noise_std=NOISE, late={"x": 0.1})


def test_a_controller_asks_for_states_that_the_estimator_has():
    estimator = EKF(start=OnGround(LATE), noise_std=NOISE)
    with pytest.raises(ParameterError, match="does not know 'T_f'"):
        Observed(estimator, replace_states(BICYCLE, "T_f"), ("r",))
    with pytest.raises(ParameterError, match=r"is 0\.05 s ago in the estimator and 0\.1 s in the controller"):
        Observed(estimator, OnGround(LATE.resampled(0.1)), ("r",))
    with pytest.raises(ParameterError, match="none of the estimator's outputs"):
        Observed(estimator, OnGround(BICYCLE), ("v_x",))
    seen = Observed(estimator, OnGround(BICYCLE), ("r",))
    assert seen.begin({"v_y": 0.3, "Y": 1.0}).tolist() == [0.3, 0.0, 0.0, 1.0, 0.0]
    assert seen.pose == {"X": 0.0, "Y": 1.0}


def replace_states(model, *more):
    other = replace(model)
    object.__setattr__(other, "states", (*model.states, *more))
    return other
