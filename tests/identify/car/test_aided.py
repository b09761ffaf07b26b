"""A car with steered rear wheels and torque vectoring, both by controllers of their own, from a log of it."""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks.foreign_cars import fleet, plants

from slipangle.codegen import compiler as compiled
from slipangle.data.dataset import Dataset, join
from slipangle.errors import MissingColumnError
from slipangle.identify.car import corrections, sentences
from slipangle.identify.car.effects import told
from slipangle.identify.car.identify_car import identify_car
from slipangle.identify.car.rear_wheels import doubts_with_rear
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.structures import STIFF, corrected, first_guess, fit
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle
from tests.identify.car.test_identify_car import DT, FINE, KNOWN, OUTPUTS, SECONDS, STEERING, TRUE, multisine
from tests.oracles import vehicles

SCALE = 0.87  # of the moment that acts over the one that is logged
REAR_LAG, MOMENT_LAG, MOST = 0.03, 0.05, 3000.0  # s, s, N m


def logs(speeds, seeds, *, noise=1.0, seconds=SECONDS):
    """Drives with multisine steering; rear wheels follow the front ones, and the moment an error of the yaw rate.

    The rear wheels turn against the front ones in slow bends and with them in fast ones. All are driven at once, as
    arrays.
    """
    rngs, h = [np.random.default_rng(seed) for seed in seeds], DT / FINE
    t, speed = np.arange(round(seconds / h)) * h, np.array(speeds, dtype=float)
    logged = np.array([0.08 / v * 12.0 * multisine(rng, t) for v, rng in zip(speeds, rngs, strict=True)])
    late = np.array([np.interp(t - STEERING["delay"], t, angle) for angle in logged])
    wheel, v_y, r, rear, moment = np.zeros((5, len(speed)))
    l_r, rows = TRUE["wheelbase"] - TRUE["l_f"], []
    share = np.where(speed < 15.0, -0.3, 0.3)
    for k in range(len(t)):
        target = STEERING["gain"] * (late[:, k] - STEERING["offset"])
        wheel = wheel + (target - wheel) * -np.expm1(-h / STEERING["lag"])
        rear = rear + (share * wheel - rear) * h / REAR_LAG
        wanted = wheel * speed / (TRUE["wheelbase"] * (1 + speed**2 / 900.0))
        moment = moment + (np.clip(16e3 * (wanted - r), -MOST, MOST) - moment) * h / MOMENT_LAG
        slip = wheel - (v_y + TRUE["l_f"] * r) / speed, rear - (v_y - l_r * r) / speed
        v_y_dot, r_dot, _ = vehicles.saturating_bicycle(TRUE, v_y, r, *slip, speed)
        if k % FINE == 0:
            rows.append((v_y, r, rear, moment))
        v_y, r = v_y + h * v_y_dot, r + h * (r_dot + SCALE * moment / TRUE["inertia_z"])
    parts = []
    for rng, v, angle, motion in zip(rngs, speeds, logged, np.array(rows).transpose(2, 1, 0), strict=True):
        v_y, r, rear, moment = motion
        seen = {
            "v_y": v_y + noise * 0.02 * rng.standard_normal(len(r)),
            "r": r + noise * 0.003 * rng.standard_normal(len(r)),
        }
        inputs = {"delta": angle[::FINE], "v_x": np.full(len(r), v), "delta_r": rear, "M_z": moment}
        parts.append(Dataset.from_arrays(inputs, seen, DT))
    return parts


@cache
def drives(speeds=(11.0, 14.0, 19.0, 25.0), **how):
    return join(*logs(speeds, range(len(speeds)), **how)).hold_mean()


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
    assert "which M_z can check as far as its own scale is known: it turns the car as 0.8" in said
    assert found.interval("delay_M_z")[0] < 1e-3


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.0, ()),
        (-1.0, ("of the other sign", "set sign = -1 for delta_r")),
        (180 / np.pi, ("read as degrees", "declare its unit as deg")),
        (np.pi / 180, ("57 times as large", "declare its unit as rad")),
    ],
)
def test_rear_wheels_logged_with_another_sign_or_unit_are_named(factor, said):
    """The sign showed nowhere but as front wheels that turn 2.5 times; degrees as stiffness that no tire has."""
    data = drives((11.0, 22.0))
    data = data.with_channel("delta_r", factor * data["delta_r"], "rad")
    whole = stretches(data, 1.0)
    start = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=data.inputs)
    free = (*STIFF, "steering_offset", "gain_M_z")
    fitted = partial(fit, start, free)
    words = doubts_with_rear(data, TRUE["wheelbase"], fitted, whole)
    assert len(words) == bool(said)
    assert all(part in words[0] for part in said)


def test_rear_wheels_logged_late_are_named():
    data = drives((11.0, 22.0))
    parts = []
    for part in data.experiments:
        t = np.arange(part.n_samples) * DT
        parts.append(part.with_channel("delta_r", np.interp(t - 0.3, t, part["delta_r"]), "rad"))
    data = join(*parts)
    start = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=data.inputs)
    fitted = partial(fit, start, (*STIFF, "steering_offset", "gain_M_z"))
    words = doubts_with_rear(data, TRUE["wheelbase"], fitted, stretches(data, 1.0))
    assert "with delta_r 0.3 s earlier the error is" in words[0]
    assert "it is logged late; shift it" in words[0]


@pytest.mark.parametrize(("factor", "known"), [(1.0, False), (2.0, True), (0.5, True)])
def test_the_scale_of_the_rear_wheels_is_found(factor, known):
    """Without, the front wheels were said to turn nearly twice as far, beside a stiffness a third too small."""
    data = drives()
    data = data.with_channel("delta_r", data["delta_r"] / factor, "rad")
    start = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=data.inputs)
    free = (*STIFF, "steering_offset", "delay_delta", "steering_lag", "delay_delta_r", "steering_gain", "gain_M_z")
    before = fit(corrections._steered(start), free, data)
    (scale,) = (c for c in corrections.corrections(data, KNOWN["wheelbase"], None) if "gain_delta_r" in c.free)
    after = corrected(before, scale, data)
    assert after.values["gain_delta_r"] == pytest.approx(factor, rel=0.1)  # the moment says nearly the same
    assert (told(after, scale.free) >= 1.0) == known
    limits = np.tile([[0.97], [1.03]], len(after.names)).T * np.array(list(after.values.values()))[:, None]
    assert bool(sentences.rear(after.names, after, limits)) == known


def test_rear_wheels_that_say_nothing_of_themselves_are_not_doubted():
    """Behind front ones that they follow everywhere alike, no sign of theirs is better than another."""
    data = drives((12.0, 12.0))
    data = data.with_channel("delta_r", -0.3 * STEERING["gain"] * data["delta"], "rad")
    start = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=data.inputs)
    whole, fitted = stretches(data, 1.0), partial(fit, start, (*STIFF, "steering_offset", "gain_M_z"))
    assert not any("delta_r" in s for s in doubts_with_rear(data, 2.6, fitted, whole))


def test_rear_wheels_that_have_nothing_to_do_with_the_car_are_not_taken_for_degrees():
    """An angle that stays at 0.6 degrees was said to be logged in degrees: the smaller it is read, the better."""
    data = drives((11.0, 22.0))
    data = data.with_channel("delta_r", np.full(data.n_samples, 0.01), "rad")
    start = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=data.inputs)
    fitted = partial(fit, start, (*STIFF, "steering_offset", "gain_M_z"))
    words = doubts_with_rear(data, TRUE["wheelbase"], fitted, stretches(data, 1.0))
    assert words == ("the car moves as if delta_r were not there: check its column, and its zero",)


def dual_track_log(name):
    """The drives of a dual track of the fleet, whose rear wheels follow the front ones and motors the yaw rate.

    The moment is made of torques at the rear wheels, so it comes through their inertia and their tires' relaxation.
    """
    foreign = fleet.make(name)
    car, wants = foreign.plant, foreign.drives[0]
    model = replace(car.model, rear_steered=True, torque_vectored=True)
    angles = np.column_stack([foreign.steering.road_wheel(d.wanted) for d in wants])
    v, rng, h = np.array([d.v_x for d in wants]), np.random.default_rng(0), plants.TICK * plants.H
    share = np.where(v < np.median(v), -0.3, 0.2)
    x, total, rear, moment = np.array([model.straight(each) for each in v]), 0.0, 0.0 * v, 0.0 * v
    most, rows = 0.125 * car.mass * vehicles.G * car.wheelbase, []
    for k in range(len(angles) // plants.TICK):
        now = angles[k * plants.TICK : (k + 1) * plants.TICK]
        error = v - x[:, model.states.index("v_x")]
        total = total + 0.4 * car.pace**2 * h * error
        pull = np.clip(1.2 * car.pace * error + total, -3.0, 3.0)
        rear = rear + (share * now[0] - rear) * -np.expm1(-h / 0.04)
        wanted = (now[0] - rear) * v / (car.wheelbase * (1 + v**2 / (1.1 * v.max()) ** 2))
        asked = np.clip(20 * car.inertia_z * (wanted - x[:, model.states.index("r")]), -most, most)
        moment = moment + (asked - moment) * -np.expm1(-h / 0.03)
        more = np.broadcast_to(np.column_stack([rear, moment]), (plants.TICK, len(v), 2))
        u = np.concatenate([car.inputs(now, np.broadcast_to(pull, now.shape)), more], axis=2)
        rows.append((x[:, [model.states.index(n) for n in ("v_x", "v_y", "r")]], rear, moment))
        x = model.steps.run_many(x, np.ascontiguousarray(u), last_only=True)
    every = round(foreign.dt / h)
    motion, rears, moments = (np.array(column)[::every] for column in zip(*rows, strict=True))
    parts = []
    for j, want in enumerate(wants):
        noise = {n: foreign.noise[n] * rng.standard_normal(len(motion)) for n in ("v_x", "v_y", "r")}
        seen = {n: motion[:, j, i] + noise[n] * (v[j] if n == "v_x" else 1.0) for i, n in enumerate(noise)}
        logged = foreign.steering.logged(want.wanted)[:: plants.TICK * every][: len(motion)]
        inputs = {"delta": logged, "v_x": seen.pop("v_x"), "delta_r": rears[:, j], "M_z": moments[:, j]}
        parts.append(Dataset.from_arrays(inputs, seen, foreign.dt))
    return foreign, join(*parts).hold_mean()


@pytest.mark.slow
@pytest.mark.skipif(compiled.compiler() is None, reason="the plant is driven compiled")
def test_a_dual_track_with_both_is_found_within_its_intervals():
    """Rear wheels that were not let act 5 ms late made moment and yaw inertia a third too large, outside intervals."""
    foreign, data = dual_track_log("sports car")
    truth = foreign.truth
    found = identify_car(data, mass=truth.mass, wheelbase=truth.wheelbase, l_f=truth.l_f)
    for name, true in (*((n, truth.values[n]) for n in STIFF), ("gain_M_z", 1.0)):
        low, high = found.interval(name)
        assert low <= true <= high, name
    assert found.model.value("steering_gain") == pytest.approx(foreign.steering.gain, rel=0.02)


def test_whatever_is_around_the_car_stays_where_tires_relax():
    given = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0, added=("bank", "M_z", "delta_r"))
    late = corrections._relaxing(corrections._steered(corrections._loaded(given)))
    assert late.inputs == given.inputs == ("delta", "v_x", "delta_r", "M_z", "bank")
    assert late.ode.states == ("v_y", "r", "alpha_f", "alpha_r", "v_x_s", "delta_s")
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
    final = SimpleNamespace(values={"gain_M_z": gain, "delay_M_z": 0.02})
    names, late = ("C_f", "gain_M_z", "delay_M_z"), (0.0, 0.03)
    words = sentences.moment(names, final, np.array([[1.0, 2.0], limits, late]))
    assert bool(words) == said
    if said:
        found = (
            f"{gain:.2g} ({limits[0]:.2g} to {limits[1]:.2g}) times the moment that was logged, 20 (0 to 30) ms later"
        )
        assert words[0].startswith(f"M_z turns the car as {found}, at the mass that was given; expected about as much")
    assert sentences.moment(("C_f",), final, np.ones((1, 2))) == []


def test_all_logs_have_such_an_input_or_none():
    with_both = drives(noise=0.0)
    without = Dataset.from_arrays({n: with_both[n] for n in ("delta", "v_x")}, {n: with_both[n] for n in OUTPUTS}, DT)
    with pytest.raises(MissingColumnError, match=r"has an input delta_r and .* none: add it, 0 where there was none"):
        identify_car([with_both, without], **KNOWN)
