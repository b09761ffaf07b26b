"""A Driver on a plant that is not its model, measurements lost, late and wild: it never raises or breaks a limit."""

import functools

import numpy as np
import pytest

import slipangle as sa
from slipangle.codegen.compiler import compiler, sentence
from slipangle.control.speed.pedals import pedal_driver
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.optimal.terms import Values
from slipangle.simulate.sensors import Sensor, Sensors

pytestmark = pytest.mark.skipif(compiler() is None, reason=sentence())
SEEN = ("r", "v_x", "X", "Y", "psi")
WILD = (np.nan, np.inf, -np.inf, 1e300, 1e9, -50.0, 0.0)


@functools.cache
def parts():
    """The plant's model, pedals, and a driver made of a bicycle that is only roughly like it."""
    p = SOUSA_CAR_7
    car = DualTrack(params=p, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
    rough = SaturatingBicycleParams(
        mass=p.mass, inertia_z=p.inertia_z, wheelbase=p.wheelbase, l_f=p.l_f, C_f=1.8e5, C_r=1.8e5, mu_f=0.9, mu_r=0.95
    )
    known = sa.Steered(SaturatingBicycle(params=rough, dt=0.02, outputs=("r",)), steering_lag=0.05)
    law = pedal_driver(p)
    late = dict.fromkeys(("X", "Y", "psi"), 0.05)
    driver = sa.Driver(known, sa.double_lane_change(22.0), speed=law, noise={"r": 0.002}, late=late)
    return car, law, driver


class Wild:
    """The driver, told a wild number instead of a measurement now and then."""

    def __init__(self, driver, seed):
        self._driver, self._rng, self.said = driver, np.random.default_rng([seed, 1]), []
        self._share = self._rng.uniform(0, 0.05)

    def __getattr__(self, name):
        return getattr(self._driver, name)

    def step(self, measured, t):
        told = {n: v for n, v in measured.items() if self._rng.uniform() > 0.05}
        for name in [n for n in told if self._rng.uniform() < self._share]:
            told[name] = float(self._rng.choice(WILD))
        commands = self._driver.step(told, t)
        self.said.append(commands)
        return commands


def drive(seed):
    car, _, driver = parts()
    rng = np.random.default_rng(seed)
    noise = {"r": 0.002, "v_x": 0.02, "X": 0.02, "Y": 0.02, "psi": 0.001}
    sensors = {
        name: Sensor(
            noise=noise[name],
            interval=float(rng.choice([0.01, 0.02, 0.1])),
            delay=float(rng.choice([0.0, 0.05, 0.15])),
            drop_out=float(rng.uniform(0, 0.6)),
            drop_length=float(rng.choice([1, 5, 40])),
            lost=str(rng.choice(["nan", "hold"])),
        )
        for name in SEEN
    }
    plant = sa.Plant(car, sensors=Sensors(**sensors), delay=Values(delta=0.02), lag=Values(delta=0.05), seed=seed)
    wild = Wild(driver, seed)
    return sa.drive(plant, wild, channels=SEEN, duration=3.0), wild.said


def check(seeds):
    """No exception, no NaN, no limit or rate broken, whatever was lost; how many drives stayed within 20 m."""
    _, law, driver = parts()
    low, high = law.limits
    angle, rate = (dict(which)["delta"] for which in (driver.controller.ocp.limits, driver.controller.ocp.rates))
    bounds = {n: sorted((high * drive, low * brake)) for n, drive, brake in law._shares}
    stayed = 0
    for seed in seeds:
        run, said = drive(seed)
        assert np.isfinite(run.states).all(), seed
        steered = np.array([commands["delta"] for commands in said])
        assert np.isfinite(steered).all(), seed
        assert np.abs(steered).max() <= np.max(angle) + 1e-9, seed
        assert np.abs(np.diff(steered, prepend=0.0)).max() <= np.max(rate) * driver.dt + 1e-9, seed
        for name, (least, most) in bounds.items():
            given = np.array([commands[name] for commands in said])
            assert np.isfinite(given).all(), (seed, name)
            assert (given >= min(least, 0.0) - 1e-9).all(), (seed, name)
            assert (given <= max(most, 0.0) + 1e-9).all(), (seed, name)
        assert all(np.isfinite(c.wanted_v_x) for c in said), seed
        stayed += np.abs(run.e_y).max() < 20.0
    return stayed


def test_drives_with_lost_late_and_wild_measurements():
    assert check(range(4)) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 1000, 250))
def test_a_thousand_drives_with_lost_late_and_wild_measurements(first):
    assert check(range(first, first + 250)) >= 125
