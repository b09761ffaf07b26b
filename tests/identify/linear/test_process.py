"""Process models against SciPy's simulation on a finer grid, the named parameters, and the intervals' coverage."""

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ParameterError, TooShortError
from slipangle.identify.linear.process import ProcessModel

DT, N, FINE = 0.05, 400, 20
# Form, numerator, denominator, delay, and the parameters by name
SYSTEMS = {
    "P1D": ([2.0], [0.4, 1.0], 0.1225, {"K": 2.0, "T_p1": 0.4, "T_d": 0.1225}),
    "P2DU": ([1.5], [0.04, 0.12, 1.0], 0.17, {"K": 1.5, "T_w": 0.2, "zeta": 0.3, "T_d": 0.17}),
    "P2DZ": ([0.6, 2.0], [0.05, 0.6, 1.0], 0.08, {"K": 2.0, "T_p1": 0.5, "T_p2": 0.1, "T_z": 0.3, "T_d": 0.08}),
    "P1I": ([2.0], [0.3, 1.0, 0.0], 0.0, {"K": 2.0, "T_p1": 0.3}),
    "P3U": ([2.0], np.polymul([0.04, 0.12, 1.0], [0.5, 1.0]), 0.0, {"K": 2.0, "T_w": 0.2, "zeta": 0.3, "T_p1": 0.5}),
}


def log(form, seed=0, noise=0.0, level=0.7):
    """Steps held for six samples, through the system on a grid twenty times as fine, then noise."""
    num, den, delay, _ = SYSTEMS[form]
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal(N // 4), 4)
    late = round(delay * FINE / DT)
    fine = np.concatenate([np.full(late, u[0]), np.repeat(u, FINE)])[: N * FINE]
    system = signal.cont2discrete((num, den), DT / FINE)
    y = signal.lfilter(np.ravel(system[0]), system[1], fine - u[0] * (form[-1] != "I"))[::FINE]
    y = y + level * (form[-1] != "I") + noise * rng.standard_normal(N)
    return sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT, units={"delta": "rad", "r": "rad/s"})


@pytest.mark.parametrize("form", SYSTEMS)
def test_without_noise_the_parameters_are_found(form):
    data = log(form)
    model = ProcessModel(form=form, max_delay=0.4).fit(data)
    truth = SYSTEMS[form][3]
    assert dict(zip(model.fit_info.names, model.fit_info.values, strict=True)) == pytest.approx(
        truth, rel=2e-4, abs=1e-5
    )
    run = model.simulate(data)
    assert np.abs(run.error[run.predicted]).max() < 1e-3


def test_the_state_space_is_the_system_at_every_frequency():
    model = ProcessModel(form="P2DU", max_delay=0.4).fit(log("P2DU"))
    f = np.array([0.1, 0.5, 1.0, 2.0])
    found = sa.linearize(model).bode("r", "delta", frequency=f)
    s = 2j * np.pi * f
    exact = 1.5 / (0.04 * s**2 + 0.12 * s + 1) * np.exp(-0.17 * s)
    assert found.magnitude == pytest.approx(np.abs(exact), rel=1e-3)
    assert found.phase == pytest.approx(np.unwrap(np.angle(exact)), abs=1e-3)


def test_units_and_experiments():
    data = log("P1D", noise=0.02)
    both = sa.join(data.rows(0, 200), data.rows(220, 400), name="two")
    info = ProcessModel(form="P1D", max_delay=0.4).fit(both).fit_info
    assert info.units == ("-", "s", "s")
    assert np.abs(info.values - [2.0, 0.4, 0.1225]) == pytest.approx(np.zeros(3), abs=0.02)


GAIN, LAG, LATE = 3.0, 4.0, 0.55


def running(seed, *, n_records=10, n=60, delay=LATE, dt=0.1):
    """Records of 6 s cut from a system that has been running for 20 s, measured with noise."""
    rng, cut = np.random.default_rng(seed), round(20 / dt)
    parts = []
    for _ in range(n_records):
        hold = round(0.8 / dt)
        u = np.repeat(rng.choice([-1.0, 1.0], (n + cut) // hold + 1), hold)[: n + cut]
        fine = np.concatenate([np.zeros(round(delay / dt * FINE)), np.repeat(u, FINE)])[: (n + cut) * FINE]
        a = np.exp(-dt / FINE / LAG)
        y = signal.lfilter([0, GAIN * (1 - a)], [1, -a], fine)[::FINE] + 0.05 * rng.standard_normal(n + cut)
        parts.append(sa.Dataset.from_arrays({"delta": u[cut:]}, {"r": y[cut:]}, dt))
    return sa.join(*parts)


@pytest.mark.parametrize(("form", "delay"), [("P1D", LATE), ("P1", 0.0)])
def test_records_cut_from_a_running_system(form, delay):
    """Nobody knows the input before them, and their first states tell of the lag."""
    truth = np.array([GAIN, LAG, delay][: 2 + ("D" in form)])
    infos = [ProcessModel(form=form).fit(running(seed, delay=delay)).fit_info for seed in range(4)]
    off = np.array([(info.values - truth) / info.std for info in infos])
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert {info.n_samples for info in infos} == {500 if "D" in form else 600}


def test_a_record_that_starts_at_rest_is_used_whole():
    """Its step in the first half second tells the delay only together with what was before."""
    u = (np.arange(300) >= 5).astype(float)
    y = 2 * np.clip(1 - np.exp(-(np.arange(300) * DT - 0.25 - 0.1225) / 0.4), 0, None)
    y += 0.02 * np.random.default_rng(0).standard_normal(300)
    info = ProcessModel(form="P1D").fit(sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT)).fit_info
    assert np.abs(info.values - [2.0, 0.4, 0.1225]) == pytest.approx(np.zeros(3), abs=0.03)
    assert info.n_samples == 300
    assert "the input before an experiment being its first sample" in info.method


def test_records_no_longer_than_the_delays_tried_are_refused():
    short = [running(k, n_records=1, n=12) for k in range(2)]
    with pytest.raises(TooShortError, match="12 samples beyond the first 6 of each experiment"):
        ProcessModel(form="P3DZU").fit(sa.join(*short))


@pytest.mark.slow
def test_intervals_cover_records_cut_from_a_running_system():
    truth = np.array([GAIN, LAG, LATE])
    infos = [ProcessModel(form="P1D").fit(running(seed)).fit_info for seed in range(60)]
    inside = np.mean([np.abs(info.values - truth) <= 1.96 * info.std for info in infos], axis=0)
    assert (inside >= 0.89).all()


@pytest.mark.slow
@pytest.mark.parametrize("form", ["P1D", "P2DU"])
def test_intervals_cover(form):
    truth = np.array([*SYSTEMS[form][3].values()])
    inside = []
    for seed in range(40):
        info = ProcessModel(form=form, max_delay=0.4).fit(log(form, seed, noise=0.05)).fit_info
        inside.append(np.abs(info.values - truth) <= 1.96 * info.std)
    assert 0.89 <= np.mean(inside) <= 0.99  # 120 and 160 cases, some of them correlated


def test_bad_input_is_said():
    for form in ("P4", "P1U", "P1DZ", "2PD", "P2ZD"):
        with pytest.raises(ParameterError, match="expected P1, P2 or P3"):
            ProcessModel(form=form)
    data = log("P1D")
    with pytest.raises(ParameterError, match="expected one of each"):
        ProcessModel().fit(data.select(inputs=["delta", "r"], outputs=["r"]))


@pytest.mark.parametrize("form", ["P1D", "P2DU", "P1"])
def test_what_holds_nothing_is_refused(form):
    data, one = log("P1D"), np.ones(N)
    for u, y, role in ((one, data["r"], "input"), (data["delta"], one, "output"), (0 * one, 0 * one, "input")):
        still = sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT)
        with pytest.raises(ExcitationError, match=f"the {role} .* is constant"):
            ProcessModel(form=form).fit(still)
    with pytest.raises(TooShortError, match=r"has 5 samples for \d parameters; expected at least"):
        ProcessModel(form=form).fit(data.rows(0, 5))


def test_what_the_record_does_not_tell_is_said():
    data = log("P1D", noise=0.02)
    with pytest.warns(IdentifiabilityWarning, match="T_d ended at the end of its range"):
        ProcessModel(form="P1D", max_delay=0.05).fit(data)
