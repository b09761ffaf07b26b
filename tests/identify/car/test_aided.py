"""A car with steered rear wheels and torque vectoring, both by controllers of their own, from a log of it."""

from types import SimpleNamespace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.errors import MissingColumnError
from slipangle.identify.car import sentences, structures
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.structures import STIFF, first_guess, fit
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle
from tests.identify.car.test_identify_car import DT, FINE, KNOWN, OUTPUTS, STEERING, TRUE
from tests.oracles import vehicles

SCALE = 0.87  # of the moment that acts over the one that is logged
REAR_LAG, MOMENT_LAG, MOST = 0.03, 0.05, 3000.0  # s, s, N m


def rear_share(speed):
    """Rear wheels turn against the front ones in slow bends and with them in fast ones."""
    return -0.3 if speed < 15.0 else 0.3


def log(speed, seed, *, noise=1.0, seconds=16.0):
    """A drive with multisine steering; rear wheels follow the front ones, and the moment an error of the yaw rate."""
    rng, h = np.random.default_rng(seed), DT / FINE
    t = np.arange(round(seconds / h)) * h
    f = np.arange(1, 40) * 0.06
    wave = sum(np.cos(2 * np.pi * (k * t + p)) for k, p in zip(f, rng.uniform(0, 1, len(f)), strict=True))
    logged = 0.08 / speed * 12.0 * wave / np.abs(wave).max()
    late = np.interp(t - STEERING["delay"], t, logged)
    wheel, v_y, r, rear, moment, rows = 0.0, 0.0, 0.0, 0.0, 0.0, []
    l_r = TRUE["wheelbase"] - TRUE["l_f"]
    for k in range(len(t)):
        target = STEERING["gain"] * (late[k] - STEERING["offset"])
        wheel += (target - wheel) * -np.expm1(-h / STEERING["lag"])
        rear += (rear_share(speed) * wheel - rear) * h / REAR_LAG
        wanted = wheel * speed / (TRUE["wheelbase"] * (1 + speed**2 / 900.0))
        moment += (np.clip(16e3 * (wanted - r), -MOST, MOST) - moment) * h / MOMENT_LAG
        slip = wheel - (v_y + TRUE["l_f"] * r) / speed, rear - (v_y - l_r * r) / speed
        v_y_dot, r_dot, _ = vehicles.saturating_bicycle(TRUE, v_y, r, *slip, speed)
        if k % FINE == 0:
            rows.append((v_y, r, rear, moment))
        v_y, r = v_y + h * v_y_dot, r + h * (r_dot + SCALE * moment / TRUE["inertia_z"])
    v_y, r, rear, moment = np.array(rows).T
    seen = {
        "v_y": v_y + noise * 0.02 * rng.standard_normal(len(r)),
        "r": r + noise * 0.003 * rng.standard_normal(len(r)),
    }
    inputs = {"delta": logged[::FINE], "v_x": np.full(len(r), speed), "delta_r": rear, "M_z": moment}
    return Dataset.from_arrays(inputs, seen, DT)


def drives(**how):
    return join(*(log(speed, seed, **how) for seed, speed in enumerate((11.0, 14.0, 19.0, 25.0)))).hold_mean()


def test_stiffness_inertia_and_the_scale_of_the_moment_are_found():
    """Without these inputs stiffness was a quarter too small, or twice as large, beside its interval."""
    found = identify_car(drives(), **KNOWN)
    assert found.model.inputs == ("delta", "v_x", "delta_r", "M_z")
    for name, true in (*((n, TRUE[n]) for n in STIFF), ("gain_M_z", SCALE)):
        low, high = found.interval(name)
        assert low <= true <= high, name
        assert high - low < 0.25 * true, name
    assert found.model.value("steering_gain") == pytest.approx(STEERING["gain"], rel=0.03)
    assert not any("as if they turned as one" in s for s in found.sentences)
    (said,) = (s for s in found.sentences if "in proportion to the mass that was given" in s)
    assert "which M_z can check as far as its own scale is known: it acts as 0.8" in said


def test_whatever_is_around_the_car_stays_where_tires_relax():
    given = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=("bank", "M_z", "delta_r"))
    late = structures._relaxing(structures._steered(given))
    assert late.inputs == given.inputs == ("delta", "v_x", "delta_r", "M_z", "bank")
    assert late.ode.states == ("v_y", "r", "alpha_f", "alpha_r", "delta_s")
    inside = late
    while hasattr(inside, "model"):
        inside = inside.model
    assert isinstance(inside, RelaxingBicycle)


def test_a_moment_that_is_not_logged_leaves_no_parameter():
    data = drives(noise=0.0)
    data = data.select(inputs=("delta", "v_x", "delta_r"))
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=STEERING["gain"], added=data.inputs)
    assert "gain_M_z" not in guess.parameter_names
    found = fit(guess.with_values(steering_offset=0.01, delay_delta=0.1), STIFF, data)
    assert set(found.values) == {*STIFF}


@pytest.mark.parametrize(
    ("gain", "limits", "said"),
    [(0.87, (0.85, 0.93), False), (-0.98, (-1.1, -0.9), True), (0.7, (0.65, 0.75), True), (1.6, (0.8, 2.5), False)],
)
def test_a_moment_that_acts_otherwise_is_told(gain, limits, said):
    final = SimpleNamespace(values={"gain_M_z": gain})
    words = sentences.moment(("C_f", "gain_M_z"), final, np.array([[1.0, 2.0], limits]))
    assert bool(words) == said
    if said:
        assert words[0].startswith(f"M_z turns the car as {gain:.2g} ({limits[0]:.2g} to {limits[1]:.2g}) times")
    assert sentences.moment(("C_f",), final, np.ones((1, 2))) == []


def test_all_logs_have_such_an_input_or_none():
    with_both = drives(noise=0.0)
    without = Dataset.from_arrays({n: with_both[n] for n in ("delta", "v_x")}, {n: with_both[n] for n in OUTPUTS}, DT)
    with pytest.raises(MissingColumnError, match=r"has an input delta_r and .* none: add it, 0 where there was none"):
        identify_car([with_both, without], **KNOWN)
