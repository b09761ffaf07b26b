"""A log does not say how inputs move between samples: intervals take in steps and lines, and outputs may tell which."""

import warnings

import numpy as np
import pytest
from scipy import signal

from slipangle import Delayed, Ode
from slipangle.data.dataset import Dataset, join
from slipangle.errors import IdentifiabilityWarning
from slipangle.identify.physics.between_samples import _before_means
from slipangle.identify.physics.grey_box import GreyBox

DT, FINE, TRUE = 0.05, 20, {"w": 5.0, "z": 0.3, "g": 6.0}


def oscillator(dt=DT):
    return Ode(
        f=lambda x, u, p: [x[1], p.w * p.w * (p.g * u[0] - x[0]) - 2 * p.z * p.w * x[1]],
        states=("y", "v"),
        inputs=("u",),
        outputs=("y",),
        params={"w": (4.0, 0.1, 50.0), "z": (0.5, 0.01, 5.0), "g": (4.0, 0.1, 50.0)},
        dt=dt,
    )


def record(how, seed, noise, n=600):
    """The oscillator from rest by its transition matrix over a twentieth of a sample, steps or lines between."""
    rng = np.random.default_rng(seed)
    u = signal.lfilter([0.4], [1, -0.6], rng.standard_normal(n + 1))
    fine = (np.arange(n * FINE) + 0.5) / FINE
    between = np.repeat(u[:n], FINE) if how == "held" else np.interp(fine, np.arange(n + 1), u)
    w, z, g = TRUE.values()
    A, B = np.array([[0, 1], [-w * w, -2 * z * w]]), np.array([[0], [g * w * w]])
    F, G, *_ = signal.cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), DT / FINE)
    x, y = np.zeros(2), np.empty(n)
    for k, now in enumerate(between):
        if k % FINE == 0:
            y[k // FINE] = x[0]
        x = F @ x + G[:, 0] * now
    return Dataset.from_arrays({"u": u[:n]}, {"y": y + noise * y.std() * rng.standard_normal(n)}, DT)


def fitted(data, start=None, free=tuple(TRUE)):
    """``fit_info``, and whether a sentence on what is between the samples was said."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        info = GreyBox(start=start or oscillator(), free=free, free_initial_state=True).fit(data).fit_info
    return info, [s for s in info.warnings if "between their samples" in s]


@pytest.mark.parametrize(
    ("how", "means", "told"),
    [("held", False, ""), ("line", False, "hold_mean()"), ("held", True, "without hold_mean()")],
)
def test_outputs_tell_how_inputs_move_and_the_intervals_hold(how, means, told):
    inside = []
    for seed in range(10):
        data = record(how, seed, 0.05)
        info, said = fitted(data.hold_mean() if means else data)
        assert len(said) == bool(told), said
        assert not told or f"{told} (hold = " in said[0], said
        off = np.abs(info.values - list(TRUE.values()))
        inside.append(off <= 1.96 * info.std)
        if not told:
            assert (info.std < 0.01 * info.values).all()
    assert np.mean(inside) >= 0.85


def test_means_of_lines_are_silent_and_hold():
    inside = []
    for seed in range(10):
        info, said = fitted(record("line", seed, 0.1).hold_mean())
        assert not said
        inside.append(np.abs(info.values - list(TRUE.values())) <= 1.96 * info.std)
    assert np.mean(inside) >= 0.85


@pytest.mark.parametrize(("how", "told"), [("held", "no rate in a job"), ("line", "hold_mean()")])
@pytest.mark.parametrize("times", [2, 4])
def test_lines_that_a_higher_rate_draws_between_samples_hide_no_inputs_that_were_held(how, told, times):
    inside = []
    for seed in range(5):
        data = record(how, seed, 0.02).resample(DT / times)
        info, said = fitted(data, oscillator(DT / times))
        assert len(said) == 1
        assert told in said[0]
        inside.append(np.abs(info.values - list(TRUE.values())) <= 1.96 * info.std)
    assert np.mean(inside) >= 0.85


def test_a_delay_takes_in_the_half_sample_that_outputs_do_not_tell_unless_the_user_says_it():
    """A free delay makes up for lines with half a sample; declared as held, the interval is the narrow one."""
    start = Delayed(oscillator(), delays={"u": 0.06}, longest=0.2)
    prompt = record("held", 0, 0.5)
    data = Dataset.from_arrays({"u": prompt["u"][2:]}, {"y": prompt["y"][:-2]}, DT)
    free = ("w", "z", "g", "delay_u")
    (open_, said), (known, none) = fitted(data, start, free), fitted(data.hold_sample(), start, free)
    assert not said
    assert not none
    np.testing.assert_array_equal(open_.values, known.values)
    wide, narrow = (info.std[info.names.index("delay_u")] for info in (open_, known))
    assert 1.3 * narrow < wide < narrow + 0.5 * DT


@pytest.mark.parametrize("first", [0, 37])
def test_means_know_the_inputs_that_they_are_of_but_for_a_share_that_turns_its_sign(first):
    """Cut anywhere, as a training part is; smooth inputs come back."""
    t = DT * np.arange(300)
    smooth = Dataset.from_arrays({"u": np.sin(t) + 0.3 * np.cos(3.1 * t), "w": 5 + 0.1 * t}, {"y": 0 * t}, DT)
    data = join(smooth.rows(0, 120), smooth.rows(120, 300)).hold_mean()
    cut = data.rows(first, 240)
    back = _before_means(cut)
    kept = np.setdiff1d(np.arange(cut.n_samples), np.array(cut.stops) - 1)  # the mean of the last is beyond the cut
    np.testing.assert_allclose(back.u[kept], smooth.u[first:240][kept], atol=2e-3)
