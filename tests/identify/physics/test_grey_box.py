"""Grey-box and ARX fits recover what made the data, and their intervals are honest."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.codegen import compiler as compiled
from slipangle.data.dataset import Dataset, join
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ParameterError, TooShortError
from slipangle.identify.linear.arx import ARX
from slipangle.identify.physics import forward
from slipangle.identify.physics.collocation import Collocation
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM, SOUSA_TABLE_6_1, SOUSA_TABLE_6_2, SOUSA_TABLE_7_2
from slipangle.models.vehicles.longitudinal import Longitudinal, LongitudinalParams
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.models.wrappers.delayed import Delayed
from tests.models.all_models import ALL_MODELS


def drive(model, n=600, seed=0, noise=0.0, name="drive"):
    """The model's own free run on smooth random inputs, plus white noise on the outputs."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * model.dt
    inputs = {}
    for channel in model.inputs:
        wave = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6.28)) for f in (0.13, 0.31, 0.72, 1.3)) / 2
        inputs[channel] = {
            "delta": 0.03 * wave,
            "v_x": 22 + 4 * wave,
            "pedal": 0.5 * wave + 0.2,
            "T_f": 400 * wave,
            "T_r": 0.0 * wave,
            "v_x_dot": 1.5 * wave,
        }.get(channel, wave)
    zeros = {o: np.zeros(n) for o in model.outputs}
    extra = {"v_x": np.full(n, 20.0)} if "v_x" in model.states and "v_x" not in zeros else None
    data = Dataset.from_arrays(inputs, zeros, model.dt, extra=extra, name=name)
    y = model.simulate(data).y
    scale = np.maximum(np.std(y, axis=0), 1e-9)
    for j, o in enumerate(model.outputs):
        clean = y[:, j] + noise * scale[j] * rng.standard_normal(n) * (np.arange(n) > 0)
        data = data.with_channel(o, clean)
    return data


CASES = {
    "bicycle": (Bicycle(params=SOUSA_TABLE_7_2, dt=0.05), ("C_f", "C_r", "inertia_z")),
    "bicycle with v_y": (
        Bicycle(params=FERRARI_250LM.with_values(steering_offset=0.01), dt=0.05, outputs=("v_y", "r")),
        ("C_f", "C_r", "inertia_z", "steering_gain", "steering_offset", "l_f"),
    ),
    "longitudinal": (
        Longitudinal(params=LongitudinalParams(mass=800.0, k_e=6000.0, k_d=60.0, k_r=0.02), dt=0.04),
        ("k_e", "k_d", "k_r"),
    ),
    "nonlinear bicycle": (
        NonlinearBicycle(
            params=NonlinearBicycleParams(
                mass=982.0, inertia_z=900.0, wheelbase=2.4, l_f=1.3, C_f=6e4, C_r=9e4, steering_lag=0.08
            ),
            dt=0.05,
            outputs=("v_y", "r"),
        ),
        ("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_lag"),
    ),
    "single track": (
        SingleTrack(
            params=SOUSA_TABLE_6_1,
            dt=0.05,
            tire_f=SOUSA_TABLE_6_2,
            tire_r=SOUSA_TABLE_6_2,
            method="radau",
            outputs=("v_x", "v_y", "r"),
        ),
        ("inertia_z", "l_f", "steering_gain"),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_parameters_are_recovered_from_noise_free_data(case):
    model, free = CASES[case]
    data = drive(model, n=200 if case == "single track" else 600)
    rng = np.random.default_rng(1)
    wrong = {n: getattr(model.params, n) * (1 + rng.uniform(-0.2, 0.2)) for n in free}
    found = GreyBox(start=_with(model, wrong), free=free).fit(data)
    for name in free:
        assert getattr(found.params, name) == pytest.approx(getattr(model.params, name), rel=1e-6, abs=1e-9), name
    assert found.fit_info.names == free


@pytest.mark.parametrize("case", ["bicycle with v_y", "single track"])
def test_compiled_and_interpreted_sensitivities_agree(case, monkeypatch):
    """Also through a delay, with derivatives by the initial state; start values are wrong, so errors are large."""
    model, free = CASES[case]
    late = Delayed(model, delays={"delta": 0.06}, longest=0.1)
    start = late.with_values(**{n: 1.1 * late.value(n) for n in free})
    data = drive(model, n=30)
    runs = []
    for compiler in ("", "none"):
        monkeypatch.setenv("SLIPANGLE_CC", compiler)
        forward._known_forward.cache_clear()
        problem = GreyBox(start=start, free=(*free, "delay_delta"), free_initial_state=True).problem(data)
        runs.append(problem.evaluate(problem.start))
        assert problem.run.compiled == (compiler == "" and compiled.compiler() is not None)
    for a, b in zip(*runs, strict=True):
        assert a == pytest.approx(b, rel=1e-7, abs=1e-7 * np.abs(b).max())


def _with(model, values):
    from dataclasses import replace

    return replace(model, params=model.params.with_values(**values))


def coverage(model, free, seeds, n=300, noise=0.1):
    """Share of parameters, over all seeds, that lie inside their own 95 % interval."""
    inside = []
    true = np.array([getattr(model.params, name) for name in free])
    for seed in seeds:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            found = GreyBox(start=model, free=free).fit(drive(model, n=n, seed=seed, noise=noise))
        low, high = found.fit_info.interval().T
        inside.append((low <= true) & (true <= high))
    return np.array(inside)


@pytest.mark.parametrize(
    ("case", "seeds", "noise"),
    [
        ("bicycle", 100, 0.1),
        ("longitudinal", 60, 0.1),
        ("bicycle with v_y", 30, 0.1),
        ("single track", 8, 0.01),
        pytest.param("bicycle", 200, 0.1, marks=pytest.mark.slow),
        pytest.param("longitudinal", 200, 0.1, marks=pytest.mark.slow),
        pytest.param("bicycle with v_y", 200, 0.1, marks=pytest.mark.slow),
        pytest.param("nonlinear bicycle", 200, 0.1, marks=pytest.mark.slow),
        pytest.param("single track", 200, 0.01, marks=pytest.mark.slow),
    ],
)
def test_intervals_hold_at_their_rate(case, seeds, noise):
    """Each parameter inside its 95 % interval: a binomial count, bounds at 4 standard deviations of that count.

    The noise is such that the data determine every parameter: the intervals are those of a linear neighbourhood.
    """
    model, free = CASES[case]
    inside = coverage(model, free, range(seeds), n=200 if case == "single track" else 300, noise=noise)
    for j, name in enumerate(free):
        assert inside[:, j].mean() == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / seeds)), name


def test_the_single_track_says_so_where_noise_hides_its_inertia():
    """Ten times the noise: the inertia's interval is about its value, and every fit warns of it."""
    model, free = CASES["single track"]
    for seed in range(2):
        with pytest.warns(IdentifiabilityWarning, match="the data do not determine inertia_z"):
            GreyBox(start=model, free=free).fit(drive(model, n=200, seed=seed, noise=0.1))


def test_weights_settle_so_the_start_does_not_matter():
    """Outputs of unlike noise: solved and weighed again until nothing moves, from stiffnesses 20 % off either way."""
    model, free = CASES["bicycle with v_y"]
    data, rng = drive(model), np.random.default_rng(0)
    for name, noise in (("v_y", 0.3), ("r", 0.02)):
        data = data.with_channel(name, data[name] + noise * np.std(data[name]) * rng.standard_normal(len(data)))
    infos = []
    for share in (0.8, 1.2):
        start = _with(model, {n: share * getattr(model.params, n) for n in ("C_f", "C_r", "inertia_z")})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            infos.append(GreyBox(start=start, free=free).fit(data).fit_info)
    assert infos[0].values == pytest.approx(infos[1].values, rel=1e-5, abs=1e-7)
    assert infos[0].noise_std == pytest.approx(infos[1].noise_std, rel=1e-6)


@pytest.mark.parametrize("n_experiments", [1, 3])
def test_experiments_share_parameters_and_have_their_own_start(n_experiments):
    model, free = CASES["bicycle"]
    data = join(*[drive(model, n=250, seed=s) for s in range(n_experiments)])
    assert len(data.experiments) == n_experiments
    found = GreyBox(start=_with(model, {"C_f": 0.8e5}), free=free, free_initial_state=True).fit(data)
    assert found.params.C_f == pytest.approx(model.params.C_f, rel=1e-6)


def test_free_initial_state_finds_a_hidden_one():
    """v_y is not measured and does not start at zero: only a free initial state recovers the stiffness."""
    model, free = CASES["bicycle"]
    long = drive(model, n=400, seed=5)
    middle = long.rows(150, 400)
    read = GreyBox(start=model, free=free).fit(middle)
    free_start = GreyBox(start=model, free=free, free_initial_state=True).fit(middle)
    error = [abs(m.params.inertia_z / model.params.inertia_z - 1) for m in (read, free_start)]
    assert error[1] < 1e-6 < error[0]


def test_unidentifiable_parameters_are_named():
    model, _ = CASES["bicycle"]
    data = drive(model, noise=0.1)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = GreyBox(start=model, free=("C_f", "C_r", "inertia_z", "mass", "l_f")).fit(data)
    said = [str(w.message) for w in caught if w.category is IdentifiabilityWarning]
    assert said == list(found.fit_info.warnings)
    assert any(s.startswith("the data do not determine C_f:") for s in said)
    assert any("can hardly be told apart" in s and "C_f" in s for s in said)


def test_coloured_residuals_widen_the_interval():
    model, free = CASES["bicycle"]
    white = drive(model, noise=0.1)
    clean = drive(model)
    rng = np.random.default_rng(0)
    colour = np.zeros(len(clean))
    for k in range(1, len(colour)):
        colour[k] = 0.98 * colour[k - 1] + rng.standard_normal()
    colour *= 0.1 * np.std(clean["r"]) / np.std(colour)
    slow = clean.with_channel("r", clean["r"] + colour)
    std = {}
    for name, data in (("white", white), ("slow", slow)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", IdentifiabilityWarning)
            info = GreyBox(start=model, free=free).fit(data).fit_info
        std[name] = info.std
        assert name == "white" or "Newey-West" in info.method
    assert (std["slow"] > 1.5 * std["white"]).sum() >= 2


def test_bad_settings_are_refused():
    model, _ = CASES["bicycle"]
    with pytest.raises(ParameterError, match="no parameter 'Cf'; nearest are"):
        GreyBox(start=model, free=("Cf",))
    with pytest.raises(ParameterError, match="no parameter is free"):
        GreyBox(start=model, free=())
    with pytest.raises(ParameterError, match="start model is ARXModel; expected an ODE"):
        GreyBox(start=ARX_CASES["SISO"], free=("A",))
    car = ALL_MODELS["dual track, front drive"]
    with pytest.raises(ParameterError, match=r"DualTrack has a step of its own.*GreyBox"):
        Collocation(start=car, free=("mass",))
    still = drive(model).with_channel("delta", np.zeros(600))
    with pytest.raises(ExcitationError, match=r"input 'delta'.*constant at 0"):
        GreyBox(start=model, free=("C_f",)).fit(still)
    with pytest.raises(TooShortError, match="4 samples for 3 parameters"):
        GreyBox(start=model, free=("C_f", "C_r", "inertia_z")).fit(drive(model).head(4))


def test_a_car_with_a_step_of_its_own_is_fitted():
    """The dual track sticks, shifts and stops between its steps: derivatives go through those steps themselves."""
    car = replace(ALL_MODELS["dual track, front drive"], dt=0.002, substeps=1, outputs=("v_x", "v_y", "r"))
    n = 300
    t = car.dt * np.arange(n)
    inputs = {
        "delta": 0.03 * np.sin(8 * t),
        "throttle": 0.3 + 0 * t + 0.1 * np.sin(5 * t),
        "brake": 0 * t + 1e-3 * np.sin(t),
    }
    data = Dataset.from_arrays(inputs, {"v_x": np.full(n, 20.0), "v_y": np.zeros(n), "r": np.zeros(n)}, car.dt)
    run = car.simulate(data)
    data = Dataset.from_arrays(inputs, {o: run.channel(o) for o in car.outputs}, car.dt)
    true = {"mass": car.params.mass, "inertia_z": car.params.inertia_z}
    start = car.with_values(mass=1.1 * true["mass"], inertia_z=0.85 * true["inertia_z"])
    fitted = GreyBox(start=start, free=tuple(true)).fit(data)
    assert {n: fitted.value(n) for n in true} == pytest.approx(true, rel=1e-5)


ARX_CASES = {
    "SISO": ARXModel(A=[-1.5, 0.7], B=[0.1, 0.2, 0.05], dt=0.05, inputs=("delta",), outputs=("r",)),
    "MIMO, delay, constant": ARXModel(
        A=np.array([[[-0.9, 0.1], [0.0, -0.8]], [[0.1, 0.0], [0.05, 0.2]]]),
        B=np.array([[[1.0, 0.2], [0.3, -0.1]], [[0.5, 0.0], [0.1, 0.1]]]),
        c=np.array([0.1, -0.2]),
        nk=3,
        dt=0.1,
        inputs=("delta", "a"),
        outputs=("v_y", "r"),
    ),
}


@pytest.mark.parametrize("case", ARX_CASES)
def test_arx_recovers_its_coefficients(case):
    model = ARX_CASES[case]
    rng = np.random.default_rng(2)
    n = 400
    inputs = {name: rng.standard_normal(n) for name in model.inputs}
    data = Dataset.from_arrays(inputs, {o: np.zeros(n) for o in model.outputs}, model.dt)
    run = model.simulate(data)
    data = Dataset.from_arrays(inputs, {o: run.channel(o) for o in model.outputs}, model.dt)
    settings = ARX(na=model.na, nb=model.nb, nk=model.nk, offset=bool(model.c.any()))
    # the simulated start holds zeros that the recursion did not make: leave it out
    found = settings.fit(data.rows(20, n))
    assert found.A == pytest.approx(model.A, abs=1e-8)
    assert found.B == pytest.approx(model.B, abs=1e-8)
    assert found.c == pytest.approx(model.c, abs=1e-8)


def test_arx_intervals_hold_at_their_rate():
    """Equation noise, 200 seeds: each coefficient inside its 95 % interval at the binomial rate."""
    true = np.array([-1.2, 0.5, 0.3, 0.1])
    inside = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        u, e = rng.standard_normal(400), 0.2 * rng.standard_normal(400)
        y = lfilter([0.0, 0.3, 0.1], [1.0, -1.2, 0.5], u) + lfilter([1.0], [1.0, -1.2, 0.5], e)
        found = ARX(na=2, nb=2).fit(Dataset.from_arrays({"u": u}, {"y": y}, 0.1))
        low, high = found.fit_info.interval().T
        sign = np.array([-1, -1, 1, 1])  # fit_info holds the coefficients of the regressors
        inside.append((low <= sign * true) & (sign * true <= high))
    assert np.array(inside).mean(axis=0) == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 200))


def test_arx_names_collinear_regressors():
    rng = np.random.default_rng(0)
    u = rng.standard_normal(200)
    data = Dataset.from_arrays({"a": u, "b": 2 * u}, {"y": np.convolve(u, [0.0, 1.0, 0.5])[:200]}, 0.1)
    with pytest.raises(ExcitationError, match=r"b of 'data' .* of a .*correlation"):
        ARX(na=2, nb=1).fit(data)


@pytest.mark.parametrize("bad", [{"na": 0, "nb": 1}, {"na": 1, "nb": 0}, {"na": 1, "nb": 1, "nk": -1}])
def test_arx_orders_are_checked(bad):
    with pytest.raises(ParameterError, match=r"is (0|-1); expected a whole number of at least (0|1)"):
        ARX(**bad)


@pytest.mark.skipif(compiled.compiler() is None, reason="there is no C compiler")
def test_compiled_radau_steps_are_the_models_own_however_wheels_spin():
    """One step of 0.1 s from locked to fourfold wheel speeds, where some have no solution and shorter ones follow."""
    car = SingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, method="radau")
    step, free = car.functions[0], ("inertia_z", "l_f")
    run = forward.forward(car, free)
    p = np.array([car.value(n) for n in free])
    worst = 0.0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        v = rng.uniform(5, 35)
        rolling = v / SOUSA_TABLE_6_1.radius * rng.choice([0, 0.3, 0.8, 1, 1.2, 2, 4], 2)
        x = np.array([v, rng.normal(0, 0.1 * v), rng.normal(0, 0.4), *rolling, 0, 0, 0])
        u = np.array([0.1, 2500.0, 2500.0]) * rng.uniform(-1, 1, 3)
        full = run(x, np.zeros((8, 2)), np.array([u, u]), p)
        later = np.asarray(step(x, u)).ravel()
        worst = max(worst, np.abs((full[1, :, 0] - later) / (1 + np.abs(later))).max())
        h = 1e-8  # small: the two ways differ by a jump
        ends = [run(x, np.zeros((8, 2)), np.array([u, u]), p * (1 + s * h * np.eye(2)[1]))[1, :, 0] for s in (-1, 1)]
        slope = (ends[1] - ends[0]) / (2 * h * p[1])
        assert full[1, :, 2] == pytest.approx(slope, rel=1e-2, abs=1e-2 * (1 + np.abs(slope).max())), seed
    assert worst < 1e-6
