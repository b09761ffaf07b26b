"""Relaxation lengths from transient slip, against a lag integrated by small steps."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.tire_data import TireData
from slipangle.errors import ExcitationError, MissingColumnError
from slipangle.identify.tires.relaxation import lateral_relaxation, with_relaxation
from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.physical import BrushTire

TIRE = BrushTire(C_alpha=2e4, C_s=2e4, mu=1.5)


def transient(sigma=0.4, rate=100.0, period=1.0, noise=5.0, v=11.0, tire=TIRE):
    """Slip swings; what the tire feels follows by Euler's method at a hundredth of a sample."""
    rng = np.random.default_rng(0)
    n, fine = 1200, 100
    dt = 1 / (rate * fine)
    t = np.arange(n * fine) * dt
    tangent = np.tan(np.deg2rad(4.0) * np.sin(2 * np.pi * t / period))
    felt, x = np.empty(len(t)), 0.0
    for k, wanted in enumerate(tangent):
        felt[k] = x
        x += dt * v / sigma * (wanted - x)
    load = np.full(n, 800.0)
    F_y = tire.forces(0.0, np.arctan(felt[::fine]), load).F_y + noise * rng.standard_normal(n)
    still = np.zeros(n)
    return TireData(
        slip_ratio=still, slip_angle=np.arctan(tangent[::fine]), load=load, F_x=still, F_y=F_y,
        speed=np.full(n, v), time=t[::fine], name="swing",
    )  # fmt: skip


@pytest.mark.parametrize("sigma", [0.2, 0.6])
def test_the_length_is_found(sigma):
    found = lateral_relaxation(TIRE, transient(sigma))
    assert found.length == pytest.approx(sigma, rel=0.03)
    assert found.interval[0] - 0.01 < sigma < found.interval[1] + 0.01
    assert found.interval[1] - found.interval[0] < 0.1 * sigma
    assert found.rmse == pytest.approx(5.0, rel=0.1)
    assert found.rmse_without > 2 * found.rmse
    assert found.load == 800.0


def test_a_tire_gets_the_carcass_that_the_length_means():
    """Relaxation length is cornering stiffness over carcass stiffness."""
    size = dict(FNOMIN=800, UNLOADED_RADIUS=0.26, PCX1=1.6, PDX1=1.5, PKX1=25, PCY1=1.3, PDY1=1.5, PKY1=-25, PKY2=2.0)
    magic = MagicFormulaTire(coefficients=MF61Coefficients(**size))
    data = transient(0.4, tire=magic)
    tire, (said,) = with_relaxation(magic, data)
    assert tire.coefficients.LATERAL_STIFFNESS == pytest.approx(25 * 800 * np.sin(2 * np.arctan(0.5)) / 0.4, rel=0.03)
    assert tire.rolling(800.0).relaxation_y == pytest.approx(0.4, rel=0.03)
    assert tire.rolling(800.0).relaxation_x is None
    assert said.startswith("relaxation length 0.4")
    assert with_relaxation(tire, data) == (tire, ())
    same, (why,) = with_relaxation(magic, replace(data, time=None))
    assert same is magic
    assert "no relaxation length: 'swing' has no time" in why


def test_a_gap_starts_anew():
    data = transient()
    part = data.rows(np.r_[0:400, 700:1200])
    assert lateral_relaxation(TIRE, part).length == pytest.approx(0.4, rel=0.05)


def test_slow_slip_shows_no_length():
    with pytest.raises(ExcitationError, match="explains less than half a percent"):
        lateral_relaxation(TIRE, transient(period=400.0, noise=20.0))


def test_what_is_missing_is_named():
    data = transient()
    with pytest.raises(MissingColumnError, match="'swing' has no time"):
        lateral_relaxation(TIRE, replace(data, time=None))
    with pytest.raises(MissingColumnError, match="'swing' has no speed"):
        lateral_relaxation(TIRE, replace(data, speed=None))
