"""Late inputs in continuous time against closed forms, and the way to samples and back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.models.analysis.linearize import linearize
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.wrappers.delayed import Delayed
from tests.models.analysis.test_linearize import BICYCLE

DT = 0.02
PLAIN = linearize(BICYCLE, v_x=20.0)
DELAYS = [[0.0, 0.0], [0.06, 0.0], [0.053, 0.0], [0.004, 0.0], [0.0, 0.031], [0.017, 0.045], [0.0199, 0.02]]
CHANNELS = {"dt": DT, "inputs": ("delta",), "outputs": ("r",)}


def late(delay):
    return replace(PLAIN, delay=np.array(delay))


def filtered(numerator, denominator, step, u):
    """A system in continuous time behind an input held over each step, by SciPy."""
    found = signal.cont2discrete((numerator, denominator), step)
    return signal.lfilter(np.ravel(found[0]), found[1], u)


@pytest.mark.parametrize("delay", DELAYS)
def test_to_samples_and_back(delay):
    """Also the outputs that the inputs reach at once, such as the lateral acceleration."""
    there = late(delay).sampled(DT)
    assert not there.delay.any()
    assert len(set(there.states)) == len(there.states)
    back = there.continuous()
    assert back.delay == pytest.approx(np.where(np.abs(PLAIN.B).any(axis=0), delay, back.delay), abs=1e-8)
    assert back.states == PLAIN.states
    for key in "ABCD":
        assert getattr(back, key) == pytest.approx(getattr(PLAIN, key), rel=1e-5, abs=1e-6), key


@pytest.mark.parametrize("delay", [0.04, 0.053])
def test_steps_are_those_of_the_plain_system_later(delay):
    fine = 1e-3
    for output in ("r", "a_y"):
        plain = PLAIN.step(output, "delta", duration=1.0)
        shown = late([delay, 0.0]).step(output, "delta", duration=1.0)
        later = np.where(shown.t < delay - 1e-12, 0.0, np.interp(shown.t - delay, plain.t, plain.y))
        assert shown.y == pytest.approx(later, abs=2e-4 * np.abs(later).max())
        samples = late([delay, 0.0]).sampled(fine).step(output, "delta", duration=1.0)
        assert shown.y == pytest.approx(samples.y, abs=1e-9 * np.abs(samples.y).max())
    pushed, plain = late([delay, 0.0]).impulse("r", "delta", duration=1.0), PLAIN.impulse("r", "delta", duration=1.0)
    assert pushed.y[pushed.t < delay - 1e-9] == pytest.approx(0.0)
    rest = pushed.t > delay
    wanted = np.interp(pushed.t[rest] - delay, plain.t, plain.y)
    assert pushed.y[rest] == pytest.approx(wanted, abs=1e-3 * np.abs(plain.y).max())


def test_frequencies_turn_by_the_delay():
    f = np.array([0.3, 1.0, 3.0])
    ratio = late([0.053, 0.0]).bode("r", "delta", frequency=f).value / PLAIN.bode("r", "delta", frequency=f).value
    assert ratio == pytest.approx(np.exp(-2j * np.pi * f * 0.053), rel=1e-12)


def test_samples_are_those_of_scipy():
    """A lag of 0.3 s behind 0.053 s, simulated on a grid of 1 ms."""
    matrices = {"A": np.array([[-1 / 0.3]]), "B": np.array([[2 / 0.3]]), "C": np.eye(1), "D": np.zeros((1, 1))}
    names = {"states": ("x",), "inputs": ("delta",), "outputs": ("r",)}
    sampled = replace(PLAIN, **matrices, **names, delay=np.array([0.053])).sampled(DT)
    u = np.repeat(np.random.default_rng(0).standard_normal(40), 20)  # held over each sample of 20 ms
    exact = filtered([2.0], [0.3, 1.0], 1e-3, np.concatenate([np.zeros(53), u])[: len(u)])[::20]
    x, found = np.zeros(len(sampled.A)), []
    for value in u[::20]:
        found.append(sampled.C[0] @ x + sampled.D[0, 0] * value)
        x = sampled.A @ x + sampled.B[:, 0] * value
    assert found == pytest.approx(exact, abs=1e-9)


@pytest.mark.parametrize("delay", [0.04, 0.053, 0.071])
def test_a_delayed_model_gives_the_system_and_the_delay_that_it_interpolates(delay):
    back = linearize(Delayed(BICYCLE, delays={"delta": delay}), v_x=20.0).continuous()
    assert back.delay == pytest.approx([delay, 0.0], abs=1e-8)
    assert np.sort(back.rates) == pytest.approx(np.sort(PLAIN.rates), rel=1e-4)  # the model's own steps are not exact
    assert back.gain("r", "delta").value == pytest.approx(PLAIN.gain("r", "delta").value, rel=1e-4)


def test_past_inputs_that_are_no_delay_are_refused():
    with pytest.raises(ParameterError, match="past inputs that are no delay"):
        linearize(ARXModel(A=[-0.9], B=[0.1, 0.5, -0.2, 0.3], **CHANNELS)).continuous()
    with pytest.raises(ParameterError, match="past inputs that are no delay"):  # two alone, of either sign
        linearize(ARXModel(A=[-0.9], B=[0.1, -0.5], **CHANNELS)).continuous()
    late_by_three = linearize(ARXModel(A=[-0.9], B=[0.1], nk=4, **CHANNELS)).continuous()
    assert late_by_three.delay == pytest.approx([3 * DT], abs=1e-9)
    assert late_by_three.rates == pytest.approx([np.log(0.9) / DT])
    with pytest.raises(ParameterError, match="keep it discrete"):
        linearize(ARXModel(A=[0.5], B=[0.1], **CHANNELS)).continuous()


def test_delays_are_checked_and_said():
    assert "delta late by 0.053 s" in repr(late([0.053, 0.0]))
    for delay in ([0.1], [-0.1, 0.0]):
        with pytest.raises(ParameterError, match="one per input"):
            late(delay)
    with pytest.raises(ParameterError, match="past inputs are states"):
        replace(PLAIN.sampled(DT), delay=np.array([0.1, 0.0]))
    for other in ("to_scipy", "to_control"):
        with pytest.raises(ParameterError, match=r"act late .*sampled"):
            getattr(late([0.053, 0.0]), other)()
    assert late([0.053, 0.0]).sampled(DT).to_scipy().dt == DT


# ---- bands of linear models from data -------------------------------------------------------------------------


def log(seed=1, n=1500):
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.standard_normal(n), np.ones(4) / 4, "same")
    y = signal.lfilter([0.0, 0.0, 0.3, 0.1], [1.0, -1.4, 0.55], u) + 0.05 * rng.standard_normal(n) + 0.2
    return sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT, units={"delta": "rad", "r": "rad/s"})


def deviation(slopes, info):
    """Of what moves with the estimates by ``slopes``, the last axis."""
    return np.sqrt(np.einsum("...i,ij,...j->...", slopes, info.covariance, slopes))


def test_bands_of_a_process_model_are_those_of_its_parameters():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(200), 5)
    fine = np.concatenate([np.full(45, u[0]), np.repeat(u, 20)])[: 20 * len(u)]  # 45 ms late
    y = filtered([2.0], [0.3, 1.0], DT / 20, fine - u[0])[::20] + 0.1 * rng.standard_normal(len(u))
    model = sa.ProcessModel(form="P1D").fit(sa.Dataset.from_arrays({"delta": u}, {"r": y}, DT))
    info, linear = model.fit_info, sa.linearize(model)
    K, T, late_by = info.values
    assert info.names == ("K", "T_p1", "T_d")
    assert linear.delay == pytest.approx([late_by])
    assert linear.poles == pytest.approx([-1 / T])
    assert linear.gain().value == pytest.approx(K)
    assert linear.gain().std == pytest.approx(info.std[0], rel=1e-3)
    assert linear.pole_std()[0] == pytest.approx([info.std[1] / T**2], rel=1e-3)
    step = linear.step(duration=1.5)
    after = step.t > late_by + 0.01
    t = step.t[after] - late_by
    decay = np.exp(-t / T)
    assert step.y[after] == pytest.approx(K * (1 - decay), rel=1e-6)
    slopes = np.column_stack([1 - decay, -K * decay * t / T**2, -K * decay / T])
    assert step.std[after] == pytest.approx(deviation(slopes, info), rel=2e-3)
    f = np.array([0.1, 1.0])
    w = 2 * np.pi * f
    turns = np.column_stack([0 * w, -w / (1 + (w * T) ** 2), -w])
    assert linear.bode(frequency=f).phase_std == pytest.approx(deviation(turns, info), rel=1e-3)
    back = linear.sampled(DT).continuous()
    assert back.delay == pytest.approx([late_by], abs=1e-7)
    assert back.gain().std == pytest.approx(info.std[0], rel=1e-3)


def test_bands_of_a_transfer_function_are_those_of_its_coefficients():
    model = sa.TransferFunction(poles=2, zeros=1, delay=0.0).fit(log())
    info = model.fit_info
    place = {n: i for i, n in enumerate(info.names)}
    slope = np.zeros(len(info.names))
    b0, a0 = info.values[place["b_0"]], info.values[place["a_0"]]
    slope[place["b_0"]], slope[place["a_0"]] = 1 / a0, -b0 / a0**2
    gain = sa.linearize(model).gain()
    assert gain.value == pytest.approx(b0 / a0, rel=1e-6)
    assert gain.std == pytest.approx(deviation(slope, info), rel=1e-3)


def test_bands_of_arx_are_those_of_its_coefficients():
    model = sa.ARX(na=2, nb=2, nk=2, offset=True).fit(log())
    info, linear = model.fit_info, sa.linearize(model)
    above, below = model.B.sum(), 1 + model.A.sum()
    slope = np.array([above / below**2, above / below**2, 1 / below, 1 / below, 0.0])  # named by the equation for y
    assert linear.gain().value == pytest.approx(above / below)
    assert linear.gain().std == pytest.approx(deviation(slope, info), rel=1e-3)
    assert np.isfinite(linear.bode(frequency=np.array([0.5])).magnitude_std).all()
    assert "standard deviations of r(k-1)" in linear.uncertainty


@pytest.mark.filterwarnings("ignore:the data have a level")  # of 0.2 in r
def test_estimates_of_arx_with_several_outputs_keep_their_rows():
    data = log()
    other = np.roll(data["r"], 3) + 0.01 * np.random.default_rng(5).standard_normal(data.n_samples)
    both = data.with_channel("v_y", other).select(inputs=["delta"], outputs=["r", "v_y"])
    model = sa.ARX(na=1, nb=2, nk=1).fit(both)
    same = model.with_estimates(model.fit_info.values)
    assert np.array_equal(same.A, model.A)
    assert np.array_equal(same.B, model.B)
    names, values = model.fit_info.names, model.fit_info.values.copy()
    values[names.index("v_y: delta(k-2)")] += 1.0
    changed = model.with_estimates(values)
    assert changed.B[1, 1, 0] == pytest.approx(model.B[1, 1, 0] + 1.0)
    assert np.abs(changed.B - model.B).sum() == pytest.approx(1.0)
    assert np.array_equal(changed.A, model.A)


def test_bands_of_output_error_are_those_of_its_coefficients():
    model = sa.OutputError(nb=2, nf=2, nk=2, offset=True).fit(log())
    above, below = model.B[0].sum(), 1 + model.F[0].sum()
    slope = np.array([1 / below, 1 / below, -above / below**2, -above / below**2, 0.0])
    gain = sa.linearize(model).gain()
    assert gain.value == pytest.approx(above / below, rel=1e-6)
    assert gain.std == pytest.approx(deviation(slope, model.fit_info), rel=1e-3)


@pytest.mark.filterwarnings("ignore:the data have a level")  # of 0.2 in r
def test_bands_of_a_state_space_do_not_hang_on_its_basis():
    model = sa.StateSpace(order=2).fit(log())
    modes = model.modes()
    gain = sa.linearize(model).gain()
    assert gain.value == pytest.approx(modes.values[-1], rel=1e-6)
    assert gain.std == pytest.approx(modes.std[-1], rel=1e-3)
