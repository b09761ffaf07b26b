"""Transfer functions against SciPy's simulation on a finer grid: Rao and Garnier's system and others, and coverage."""

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.errors import ExcitationError, ModelWarning, ParameterError, TooShortError
from slipangle.identify.linear.transfer_function import TransferFunction

DT, FINE = 0.05, 20
# Numerator, denominator, delay [s]; the first is that of G. P. Rao and H. Garnier
SYSTEMS = {
    "rao-garnier": ([-6400.0, 1600.0], [1.0, 5.0, 408.0, 416.0, 1600.0], 0.0),
    "one pole": ([2.0], [1.0, 2.5], 0.1225),
    "two poles and a zero": ([3.0, 40.0], [1.0, 3.0, 25.0], 0.17),
    "four poles and three zeros": ([1.0, 3.0, 50.0, 200.0], [1.0, 8.0, 60.0, 160.0, 500.0], 0.08),
    "an integrator": ([2.0], [1.0, 3.0, 0.0], 0.0),
}


def log(name, seed=0, noise=0.0, level=0.7, n=800):
    """Steps held for four samples, through the system on a grid twenty times as fine, then noise."""
    num, den, delay = SYSTEMS[name]
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(n // 4), 4)
    late = round(delay * FINE / DT)
    fine = np.concatenate([np.full(late, u[0]), np.repeat(u, FINE)])[: n * FINE]
    system = signal.cont2discrete((num, den), DT / FINE)
    y = signal.lfilter(np.ravel(system[0]), system[1], fine - u[0])[::FINE]
    y = y + level + noise * np.std(y) * rng.standard_normal(n)
    return sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT, units={"delta": "rad", "r": "rad/s"})


def settings(name, **other):
    num, den, _ = SYSTEMS[name]
    return TransferFunction(poles=len(den) - 1, zeros=len(num) - 1, **{"max_delay": 0.4, **other})


def truth(name):
    num, den, delay = SYSTEMS[name]
    return np.array([*den[:0:-1], *num[::-1], delay])


@pytest.mark.parametrize("name", [n for n in SYSTEMS if n != "an integrator"])
def test_without_noise_the_coefficients_are_found(name):
    data = log(name)
    model = settings(name).fit(data)
    assert model.fit_info.values == pytest.approx(truth(name), rel=1e-4, abs=1e-4)
    run = model.simulate(data)
    assert np.abs(run.error[run.predicted]).max() < 1e-3 * np.ptp(data["r"])


def test_an_integrator_is_a_pole_at_zero():
    data = log("an integrator", noise=0.01, level=0.0)
    info = settings("an integrator", delay=0.0).fit(data).fit_info
    assert info.names == ("a_0", "a_1", "b_0")
    assert np.abs(info.values - truth("an integrator")[:3]) == pytest.approx(np.zeros(3), abs=0.1)


def test_rao_garnier_in_noise():
    """Noise of a tenth of the output: least squares through filters alone would bias the fast poles."""
    info = settings("rao-garnier").fit(log("rao-garnier", noise=0.1, n=1600)).fit_info
    a, std = info.values[:4], info.std[:4]
    assert (np.abs(a - truth("rao-garnier")[:4]) < 3 * std).all()
    assert (std < 0.05 * np.abs(a)).all()


def test_the_state_space_is_the_system_at_every_frequency():
    name = "two poles and a zero"
    model = settings(name).fit(log(name))
    f = np.array([0.1, 0.5, 0.9, 2.0])
    found = sa.linearize(model).bode("r", "delta", frequency=f)
    s = 2j * np.pi * f
    num, den, delay = SYSTEMS[name]
    exact = np.polyval(num, s) / np.polyval(den, s) * np.exp(-delay * s)
    assert found.magnitude == pytest.approx(np.abs(exact), rel=1e-3)
    assert found.phase == pytest.approx(np.unwrap(np.angle(exact)), abs=1e-3)


def test_units_experiments_and_a_known_delay():
    data = log("two poles and a zero", noise=0.02)
    both = sa.join(data.rows(0, 380), data.rows(420, 800), name="two")
    info = settings("two poles and a zero", delay=0.17).fit(both).fit_info
    assert info.names == ("a_0", "a_1", "b_0", "b_1")
    assert info.units == ("1/s2", "1/s", "1/s2", "1/s")
    assert (np.abs(info.values - truth("two poles and a zero")[:4]) < 3.5 * info.std).all()


def test_records_cut_from_a_running_system():
    """Nobody knows the input before them, and their first states tell of the poles."""
    name = "one pole"
    truth = np.array([2.5, 2.0, 0.1225])
    off = []
    for seed in range(3):
        whole = log(name, seed, noise=0.05)
        cut = sa.join(*[whole.rows(a + 48, a + 98) for a in range(0, 800, 100)])
        info = settings(name).fit(cut).fit_info
        assert info.n_samples == 8 * (50 - 8)
        off.append((info.values - truth) / info.std)
    assert np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two poles and a zero", "four poles and three zeros"])
def test_intervals_cover(name):
    inside = []
    for seed in range(40):
        info = settings(name).fit(log(name, seed, noise=0.05)).fit_info
        inside.append(np.abs(info.values - truth(name)) <= 1.96 * info.std)
    assert 0.88 <= np.mean(inside) <= 0.99


def first_order(a, gain, seed, dt=0.05, n=1200):
    """``y' = -a y + gain u`` behind a steering of five tones that is held, with noise; and y without it."""
    rng = np.random.default_rng(seed)
    t, decay = dt * np.arange(n), np.exp(-a * dt)
    phases = rng.uniform(0, 2 * np.pi, 5)
    u = sum(0.012 * np.sin(2 * np.pi * f * t + p) for f, p in zip((0.11, 0.23, 0.47, 0.71, 1.1), phases, strict=True))
    y = signal.lfilter([0.0, gain * (1 - decay) / a], [1.0, -decay], u)
    measured = y + 0.01 * rng.standard_normal(n)
    return sa.Dataset.from_arrays({"u": u}, {"y": measured}, dt, name=f"{seed}"), y


@pytest.mark.parametrize("seed", [2, 6, 9])
def test_a_pole_too_many_is_no_unstable_one(seed):
    """It all but cancels with the zero too many, wherever they are: where they grow, no free run stays."""
    model = TransferFunction(delay=0.0).fit(first_order(16.0, 68.0, seed)[0])
    other, y = first_order(16.0, 68.0, seed + 100)
    run = model.simulate(other)
    assert np.roots([1.0, model.fit_info.values[1], model.fit_info.values[0]]).real.max() <= 0
    assert np.std(run.y[50:, 0] - y[50:]) < 0.1 * np.std(y)


def test_an_unstable_system_is_found_unstable():
    with pytest.warns(ModelWarning, match="the model is unstable"):
        info = TransferFunction(poles=1, delay=0.0).fit(first_order(-0.1, 5.0, 0)[0]).fit_info
    assert info.values[0] == pytest.approx(-0.1, abs=3e-4)


def test_bad_input_is_said():
    with pytest.raises(ParameterError, match="expected fewer zeros than poles"):
        TransferFunction(poles=2, zeros=2)
    data = log("one pole")
    with pytest.raises(ParameterError, match="expected one of each"):
        TransferFunction().fit(data.select(inputs=["delta", "r"], outputs=["r"]))
    with pytest.raises(TooShortError, match="has 12 samples for 7 parameters"):
        TransferFunction(poles=3).fit(data.rows(0, 12))
    still = sa.Dataset.from_arrays({"delta": np.zeros(400)}, {"r": data["r"][:400]}, DT)
    with pytest.raises(ExcitationError, match="constant"):
        TransferFunction().fit(still)
