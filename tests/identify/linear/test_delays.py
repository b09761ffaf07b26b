"""Delays beyond the first search and inputs that act at once: found where they are, not where they are not."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.errors import TooShortError
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.delays import delayed, first_effects
from slipangle.identify.linear.multi_arx import MultiARX
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.waiting import waiting

B, A = (1.0, 0.4), (1.0, -1.5, 0.7)


def made(delays, *, seed=0, n=1500, noise=0.2, colour=0.0, smooth=0.0, level=0.0, parts=1):
    """An oscillating second-order response to each input, so much later, with noise on the output; and without it."""
    rng = np.random.default_rng(seed)
    u = lfilter([1.0], [1.0, -smooth], rng.standard_normal((n, len(delays))), axis=0)
    u /= np.std(u, axis=0)
    clean = np.zeros(n)
    for i, k in enumerate(delays):
        clean[k:] += lfilter(np.array(B) * (1 + i), A, u[:, i])[: n - k] / 3
    e = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.standard_normal(n))
    inputs = {f"u{i}": u[:, i] + level for i in range(len(delays))}
    data = Dataset.from_arrays(inputs, {"y": clean + noise * np.std(clean) * e + level}, 0.1, name="made")
    cuts = np.linspace(0, n, parts + 1).astype(int)
    data = data if parts == 1 else join(*(data.rows(a, b) for a, b in pairwise(cuts)))
    return data, clean + level


def fit_of(model, **made_like):
    """Fit to the noise-free output of another record, in percent."""
    data, clean = made(**made_like, seed=99)
    run = model.simulate(data)
    known = run.predicted
    return 100 * (1 - np.std(run.y[known, 0] - clean[known]) / np.std(clean[known]))


CASES = {
    "white": {},
    "noisy": {"noise": 0.5},
    "coloured": {"colour": 0.9},
    "smooth": {"smooth": 0.8},
    "levels": {"level": 3.0},
    "experiments": {"parts": 6},
    "short": {"n": 300},
}


@pytest.mark.parametrize("like", CASES.values(), ids=CASES)
@pytest.mark.parametrize("delay", [0, 1, 4, 17, 60])
def test_the_first_effect_is_where_the_delay_is(delay, like):
    found = [first_effects(made((delay,), seed=s, **like)[0], ("u0",))[0] for s in range(5)]
    assert np.median(found) == delay
    assert all(delay <= k <= delay + 2 for k in found)


@pytest.mark.parametrize("like", CASES.values(), ids=CASES)
def test_with_any_delay_a_model_is_as_good_as_with_one_sample(like):
    near, at_once, late = (
        fit_of(ARX(offset=True).fit(made((k,), **like)[0]), delays=(k,), level=like.get("level", 0.0))
        for k in (1, 0, 25)
    )
    assert near > 80
    assert at_once > near - 3
    assert late > near - 3


def test_each_input_has_its_own():
    data, _ = made((0, 30))
    model = ARX().fit(data)
    lags = {name for name in model.fit_info.names if name.startswith("u")}
    assert "u0(k)" in lags
    assert "u1(k-30)" in lags
    assert not lags & {"u1(k)", "u1(k-1)"}
    assert fit_of(model, delays=(0, 30)) > 85
    assert " nk = 0/" in model.fit_info.candidates[0].orders


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("like", CASES.values(), ids=CASES)
def test_no_direct_path_is_made_of_noise(like, seed):
    assert ARX(offset=True).fit(made((1, 2), seed=seed, **like)[0]).nk >= 1


def looped(seed, wanted, *, n=1500, gain=2.0, integral=0.0, direct=0.0, old=False):
    """A first-order plant under control, which acts on the output of the same sample or of the one before."""
    rng = np.random.default_rng(seed)
    e, steps = 0.3 * rng.standard_normal(n), np.repeat(rng.standard_normal(n // 25), 25)
    kinds = {"steps": steps, "smooth": lfilter([0.2], [1.0, -0.8], steps), "white": rng.standard_normal(n)}
    r, total = kinds[wanted], 0.0
    x, u, y = np.zeros((3, n))
    for k in range(n):
        x[k] = 0.9 * x[k - 1] + 0.3 * u[k - 1]
        if old:
            u[k] = gain * (r[k] - y[k - 1])
        y[k] = x[k] + direct * u[k] + e[k]
        if not old:
            total += integral * (r[k] - y[k])
            u[k] = gain * (r[k] - y[k] + total)
    return Dataset.from_arrays({"u": u}, {"y": y}, 0.1, name="looped")


@pytest.mark.parametrize("integral", [0.0, 0.2])
@pytest.mark.parametrize("wanted", ["steps", "smooth", "white"])
def test_a_controller_that_answers_the_output_is_no_direct_path(wanted, integral):
    """It acts on the output of the same sample, the plant one sample later."""
    for seed in range(5):
        assert first_effects(looped(seed, wanted, integral=integral), ("u",))[0] in (1, 2)


@pytest.mark.parametrize("direct", [0.5, 1.0])
def test_a_direct_path_is_seen_beside_a_controller_that_answers_the_sample_before(direct):
    found = [first_effects(looped(s, "white", gain=0.5, direct=direct, old=True), ("u",)) for s in range(5)]
    assert found == [(0,)] * 5


def test_models_of_a_plant_under_control_have_no_direct_path():
    data = looped(0, "white")
    assert ARX().fit(data).nk == 1
    assert not StateSpace(order=(1, 2)).choose_order(data).direct


def test_a_loop_about_one_input_hides_no_direct_path_of_another():
    """The present of an input that answers the outputs tells of them what the other one does."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        w = rng.standard_normal(1500)
        x, u, y = np.zeros((3, 1500))
        for k in range(1500):
            x[k] = 0.9 * x[k - 1] + 0.1 * u[k - 1]
            y[k] = x[k] + 0.5 * w[k] + 0.3 * rng.standard_normal()
            u[k] = 2 * (rng.standard_normal() - y[k])
        both = Dataset.from_arrays({"u": u, "w": w}, {"y": y}, 0.1, name="looped")
        assert first_effects(both, both.inputs) == (1, 0)


def test_the_steering_of_a_model_at_several_speeds_may_be_late():
    rng = np.random.default_rng(0)
    n, v_x = 3000, 10 + 5 * np.sin(np.arange(3000) / 300)
    u, y = rng.standard_normal(n), np.zeros(n)
    for k in range(20, n):
        y[k] = 1.4 * y[k - 1] - 0.6 * y[k - 2] + 0.02 * v_x[k - 1] * u[k - 20]
    noisy = y + 0.1 * np.std(y) * rng.standard_normal(n)
    data = Dataset.from_arrays({"delta": u, "v_x": v_x}, {"r": noisy}, 0.05, name="late")
    model = MultiARX().fit(data)
    assert 15 <= model.models[0].nk <= 20
    run = model.simulate(data)
    assert np.std(run.y[:, 0][run.predicted] - y[run.predicted]) < 0.1 * np.std(y)


# ---- state spaces ----------------------------------------------------------------------------------------------------

FEW = (1, 2, 3, 4, 5)


@pytest.mark.parametrize("like", ["white", "coloured", "smooth", "experiments", "short"])
def test_a_state_space_is_as_good_with_any_delay(like):
    near, at_once, late = (
        fit_of(StateSpace(order=FEW).fit(made((k,), **CASES[like])[0]), delays=(k,)) for k in (1, 0, 25)
    )
    assert near > 93
    assert min(at_once, late) > near - 3


def test_a_state_space_with_a_direct_path_and_a_delay_says_so():
    data, _ = made((0, 30))
    settings = StateSpace(order=FEW)
    model, choice = settings.fit(data), settings.choose_order(data)
    assert model.fit_info.method.startswith(f"direct path; u1 {choice.waits[1]} samples late; order = {choice.order}, ")
    assert choice.direct
    assert choice.waits[0] == 0
    assert 25 < choice.waits[1] < 30
    assert model.order == choice.order + choice.waits[1]
    assert fit_of(model, delays=(0, 30)) > 95


@pytest.mark.parametrize("like", CASES.values(), ids=CASES)
def test_a_state_space_makes_no_path_and_no_delay_of_noise(like):
    offsets = "output" if "level" in like else "none"
    choice = StateSpace(order=FEW, offsets=offsets).choose_order(made((1, 2), **like)[0])
    assert not choice.direct
    assert choice.waits == (0, 0)


def test_whether_a_direct_path_is_open_goes_with_the_order():
    assert StateSpace() == StateSpace(direct="chosen")
    assert StateSpace(order=2) == StateSpace(order=2, direct=False)
    data, _ = made((25,))
    assert StateSpace(order=2).fit(data).order == 2
    assert StateSpace(order=2, direct="chosen").fit(data).order > 20
    assert StateSpace(order=(1, 2), direct=False).choose_order(data).waits == (0,)


def test_inputs_that_wait_in_states_are_those_of_before():
    """The same free run as over shifted inputs, the same estimates, poles and gains, and they survive a file."""
    data, _ = made((20, 3), n=600, parts=2)
    by = {"u0": 17, "u1": 2}
    core = StateSpace(order=3, direct=True, offsets="both", focus="prediction").fit(delayed(data, by))
    model = waiting(core, by, data)
    assert model.order == 3 + 19
    whole, part = model._simulate(data), core._simulate(delayed(data, by))
    assert whole.y[200:300] == pytest.approx(part.y[183:283], abs=0.02)
    steps = model.initial_state(data.rows(0, 60)), core.initial_state(delayed(data.rows(0, 60), by))
    u, shifted = data.rows(59, 200).u, delayed(data.rows(42, 200), by).u
    assert model.free_run(steps[0], u)[80:] == pytest.approx(core.free_run(steps[1], shifted)[80:], abs=0.02)
    values = core.fit_info.values * 1.01
    again, other = model.with_estimates(values), core.with_estimates(values)
    assert again.C @ np.linalg.solve(np.eye(22) - again.A, again.B) + again.D == pytest.approx(
        other.C @ np.linalg.solve(np.eye(3) - other.A, other.B) + other.D
    )
    ours, theirs = model.modes(), core.modes()
    assert ours.names == theirs.names
    assert ours.values == pytest.approx(theirs.values)
    assert ours.std == pytest.approx(theirs.std, rel=1e-6)
    assert waiting(core, {"u0": 0, "u1": 0}, data) is core


def test_what_is_shifted_is_the_input_of_before():
    data, _ = made((1, 1), n=40, parts=2)
    later = delayed(data, {"u1": 3})
    assert later.starts == (0, 17)
    for part, whole in zip(later.experiments, data.experiments, strict=True):
        assert np.array_equal(part["u1"], whole["u1"][:-3])
        assert np.array_equal(part["u0"], whole["u0"][3:])
        assert np.array_equal(part.y, whole.y[3:])
        assert part.t[0] == pytest.approx(whole.t[3])
    assert delayed(data, {"u1": 0}) is data
    with pytest.raises(TooShortError, match="longer than 20 samples"):
        delayed(data, {"u0": 20})


def test_short_records_tell_nothing():
    assert first_effects(made((0,), n=40)[0], ("u0",)) == (1,)
