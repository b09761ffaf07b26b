"""What a log may need beyond the linear bicycle is found from where poorer structures stood."""

from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.identify.car import corrections as corrections_module
from slipangle.identify.car import structures
from slipangle.identify.car.corrections import RATE, Correction, corrections
from slipangle.identify.car.effects import believed, told
from slipangle.identify.car.sensors import sensors
from slipangle.identify.car.sentences import unsettled
from slipangle.identify.car.structures import STIFF, Stage, corrected, first_guess, fit
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered

KNOWN = dict(mass=1.7, wheelbase=0.175, l_f=0.0945)
TRUE = dict(C_f=45.0, C_r=75.0, inertia_z=0.0068, mu_f=0.71, mu_r=0.76)
LAG, GAIN, OFFSET, DT = 0.05, 0.46, 0.03, 0.01


def drive(seed):
    """Eight seconds of a 1:10 car whose servo is slow, faster with the seed; the yaw rate alone is measured."""
    rng, t, f = np.random.default_rng(seed), np.arange(800) * DT, np.arange(1, 40) * 0.06
    wave = np.cos(2 * np.pi * (np.outer(t, f) + rng.uniform(0, 1, len(f)))).sum(axis=1)
    u = np.column_stack([0.5 * wave / np.abs(wave).max() + OFFSET, 1.6 + 0.3 * (seed + np.sin(0.4 * np.pi * t + seed))])
    params = SaturatingBicycleParams(**KNOWN, **TRUE, steering_gain=GAIN, steering_offset=OFFSET)
    plant = Steered(SaturatingBicycle(params=params, dt=DT), steering_lag=LAG)
    r = np.append(0.0, plant.free_run(np.zeros(3), u)[:, 0]) + 0.1 * rng.standard_normal(len(t))
    return Dataset.from_arrays({"delta": u[:, 0], "v_x": u[:, 1]}, {"r": r}, DT)


GUESS = first_guess(**KNOWN, dt=DT, outputs=("r",), gain=GAIN)


@pytest.fixture(scope="module")
def driven():
    return join(*map(drive, range(5))).hold_mean()


@pytest.fixture(scope="module")
def begun(driven):
    return fit(GUESS, (*STIFF, "steering_offset"), driven)


@pytest.mark.parametrize("harder", [0.1, 0.8, 5.0])
def test_a_last_fit_ends_at_one_place_wherever_it_began(driven, begun, harder):
    """Ended as soon as the weights moved by less than a fifth, it kept some of how hard the start drew to the prior."""
    free = (*begun.free, "steering_gain", "delay_delta", "mu_f", "mu_r")
    one = fit(begun.model.with_values(mu_f=0.9, mu_r=0.9), free, driven, begun, last=True)
    elsewhere = begun.model.with_values(mu_f=0.8, mu_r=1.0, C_f=1.2 * begun.values["C_f"])
    other = fit(elsewhere, free, driven, replace(begun, thinning=harder * begun.thinning), last=True)
    assert one.settled
    assert other.settled
    slope = np.vstack([one.jacobian.reshape(-1, len(free)), one.pull]) * one.problem.scale**-1.0
    apart = [other.values[name] - one.values[name] for name in one.names]
    assert np.linalg.norm(slope @ apart) < 0.01
    assert other.thinning == pytest.approx(one.thinning, rel=0.01)


def test_a_fit_whose_weights_chase_each_other_is_said_not_to_have_settled(driven, begun, monkeypatch):
    assert unsettled(fit(begun.model, begun.free, driven, begun, last=True)) == []
    back_and_forth = cycle([2.0, 200.0])
    monkeypatch.setattr(structures, "_thinning", lambda *_: next(back_and_forth))
    found = fit(begun.model, begun.free, driven, begun, last=True)
    assert not found.settled
    assert [said.startswith("the last fit did not settle") for said in unsettled(found)] == [True]


@pytest.mark.slow
def test_a_lag_is_found_after_the_tires_were_taken_to_be_late(driven):
    """From no lag at all the search stayed there, and lost the correction that this car needs most."""
    late, gain, saturates, *others = corrections(driven, KNOWN["wheelbase"], ())
    relaxing = next(correction for correction in others if "relaxation_f" in correction.free)
    before = fit(GUESS.with_values(steering_gain=1.0), (*STIFF, "steering_offset"), driven)
    for correction in (saturates, relaxing, gain):
        before = corrected(before, correction, driven)
    after = corrected(before, late, driven)
    assert after.values["steering_lag"] + after.values["delay_delta"] == pytest.approx(LAG, abs=0.005)
    assert after.sigma[0] < 0.97 * before.sigma[0]


def servo(seed, rate):
    """Eight seconds of a car steered in leaps by a servo of 30 ms that turns no faster than ``rate`` [rad/s]."""
    rng, n, fine = np.random.default_rng(seed), 800, 10
    u = np.column_stack([np.repeat(rng.uniform(-0.3, 0.3, 20), 40), np.full(n, 2.0 + 0.2 * seed)])
    wheel, at = np.zeros(n), 0.0
    for k in range(n):
        wheel[k] = at
        for _ in range(fine):
            at += DT / fine * np.clip((u[k, 0] - at) / 0.03, -rate, rate)
    params = SaturatingBicycleParams(**KNOWN, **(TRUE | dict(mu_f=5.0, mu_r=5.0)), steering_gain=GAIN)
    plant = SaturatingBicycle(params=params, dt=DT)
    r = np.append(0.0, plant.free_run(np.zeros(2), np.column_stack([wheel, u[:, 1]]))[:, 0])
    return Dataset.from_arrays({"delta": u[:, 0], "v_x": u[:, 1]}, {"r": r + 0.02 * rng.standard_normal(n)}, DT)


@pytest.fixture(scope="module")
def by_servo():
    """Drives by a servo of 1.5 rad/s, fits to them with a lag, and with a largest rate too, and that correction."""
    data = join(*(servo(seed, 1.5) for seed in range(4)))
    late, limit = (
        next(c for c in corrections(data, KNOWN["wheelbase"], ()) if n in c.free)
        for n in ("steering_lag", "steering_rate")
    )
    before = corrected(fit(GUESS, (*STIFF, "steering_offset", "steering_gain"), data), late, data)
    return data, before, corrected(before, limit, data), limit


def test_a_steering_that_turns_no_faster_than_its_servo_is_told_from_one_that_lags(by_servo):
    """Where the lag alone was free, it grew tenfold, and the gain with it."""
    _, before, after, limit = by_servo
    assert after.values["steering_rate"] == pytest.approx(1.5, rel=0.05)
    assert after.values["steering_lag"] + after.values["delay_delta"] == pytest.approx(0.03, abs=0.012)
    assert before.values["steering_lag"] > 0.06
    assert after.sigma[0] < 0.6 * before.sigma[0]
    assert limit.adds_nothing_to((*STIFF, "steering_gain"), ())  # wheels that are not late are not slow


def test_a_largest_rate_that_the_steering_hardly_asks_for_is_none_and_is_taken_back(by_servo):
    """One was kept that lane changes asked for by a twentieth more, in place of a lag of another shape."""
    data, before, slow, _ = by_servo
    hardly = replace(slow, model=slow.model.with_values(steering_rate=15.0))  # as sharp, of leaps of 20 rad/s
    stages = [
        Stage(correction=said, kept=True, error=np.ones(1), change=-0.1, values=f.values)
        for said, f in (("late", before), ("slow", slow))
    ]
    assert told(slow, RATE) > 1 > told(hardly, RATE)
    assert believed(slow, stages, data) == (slow, stages)
    found, left = believed(hardly, stages, data)
    assert "steering_rate" not in found.names
    assert found.model.value("steering_rate") == np.inf
    assert found.values["steering_lag"] == pytest.approx(before.values["steering_lag"], rel=0.02)
    assert [stage.kept for stage in left] == [True, False]


@pytest.mark.parametrize(("step", "doubted"), [(0.02, False), (0.2, True)])
def test_a_servo_at_its_limit_whose_angle_is_logged_too_seldom_is_doubted(step, doubted):
    """It is 0.12 rad behind at its largest rate."""
    swept = 0.2 - np.abs(np.arange(400) * step % 0.8 - 0.4)
    log = Dataset.from_arrays({"delta": swept}, {"r": swept}, DT)
    final: Any = SimpleNamespace(
        names=(),
        problem=SimpleNamespace(base_names=(), data=log),
        values={"steering_rate": 1.5, "steering_lag": 0.08},
        model=SimpleNamespace(dt=DT),
    )
    said = sensors(final, np.zeros((0, 0)))
    assert len(said) == doubted
    assert all("no interval holds" in sentence for sentence in said)


def test_relaxation_lengths_of_both_axles_are_drawn_to_each_other(driven):
    """Apart by a twentieth of the wheelbase costs one more than alike, whatever each of them may be."""
    relaxing = corrections_module._relaxing(GUESS).with_values(relaxation_f=0.02, relaxation_r=0.02)
    found = fit(relaxing, (*STIFF, "relaxation_f", "relaxation_r"), driven)
    half = 0.025 * KNOWN["wheelbase"] / found.problem.scale[3:5]

    def cost(signs):
        return float(np.sum((found.pull[:, 3:5] @ (half * signs)) ** 2)) / found.thinning

    assert cost([1.0, -1.0]) - cost([1.0, 1.0]) == pytest.approx(1.0)


def fitted(sigma: float, names: int) -> Any:
    """What `helps` looks at: errors of 100 independent samples."""
    return SimpleNamespace(sigma=np.array([sigma]), error=np.zeros((100, 1)), thinning=1.0, names=range(names))


def test_what_every_car_has_need_not_earn_its_parameters_and_what_is_constant_must_help_all_the_time():
    linear, better, no_better = fitted(1.0, 4), fitted(0.97, 6), fitted(1.01, 6)
    level = np.ones((4, 1))
    plain = Correction("plain", ())
    ordinary, constant = replace(plain, ordinary=True), replace(plain, constant=True)
    assert not structures.helps(linear, better, level, level, plain)  # 6 for 2 parameters, where 9 are asked
    assert structures.helps(linear, better, level, level, ordinary)
    assert not structures.helps(linear, no_better, level, level, ordinary)
    assert not structures.helps(linear, better, level, 2.0 * level, ordinary)  # it does harm
    uneven, even = np.array([[0.3], [0.4], [0.9], [2.6]]), np.array([[0.9], [0.8], [0.9], [0.7]])
    much = fitted(0.7, 6)
    assert structures.helps(linear, much, level, uneven, plain)
    assert not structures.helps(linear, much, level, uneven, constant)
    assert structures.helps(linear, much, level, even, constant)


def test_tires_bend_by_themselves_where_a_log_uses_what_any_tire_has(driven):
    def saturate(v_x: float) -> Correction:
        data = driven.with_channel("v_x", np.full(driven.n_samples, v_x), "m/s")
        return next(c for c in corrections(data, 2.6, ()) if "mu_f" in c.free)

    used = float(np.quantile(np.abs(driven["r"]), 0.999))
    assert saturate(0.7 * 9.81 / used).ordinary
    assert not saturate(0.5 * 9.81 / used).ordinary
