"""What is said of a car promises no more than its log tells."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slipangle.identify.car.late import with_lateness
from slipangle.identify.car.sentences import held, misplaced, steering, turning
from slipangle.identify.car.structures import STIFF, first_guess, fit
from slipangle.identify.car.uncertainty import hull_of_sum
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycleParams
from slipangle.models.vehicles.steering import Steered
from slipangle.models.wrappers.delayed import Delayed
from tests.identify.car.test_identify_car import DT, KNOWN, OUTPUTS, drives
from tests.identify.car.test_late import drives as behind
from tests.identify.car.test_late import fitted

PAIR = ("delay_delta", "steering_lag")


@pytest.fixture(scope="module")
def answered():
    """A car fitted with its steering's delay and lag."""
    guess = first_guess(**KNOWN, dt=DT, outputs=OUTPUTS, gain=1.0).with_values(mu_f=0.9, mu_r=1.0)
    late = Delayed(Steered(guess.model, steering_lag=0.03), delays={"delta": 0.02}, longest=0.3)
    return fit(late, (*STIFF, "steering_offset", "steering_gain", *PAIR), drives())


def later(fitted, seconds):
    """The same car with a delay that much longer."""
    return replace(fitted, model=fitted.model.with_values(delay_delta=fitted.values["delay_delta"] + seconds))


def test_how_late_the_wheels_are_reaches_as_far_as_structures_as_good_say(answered, monkeypatch):
    """A fit without the tires' relaxation found 71 (60 to 82) ms where one with it, as good, found the true 50."""
    low, high = hull_of_sum(PAIR, answered, [])
    other = later(answered, -0.04)
    wide = hull_of_sum(PAIR, answered, [(other, 1.0)])
    assert wide == pytest.approx((low - 0.04, high), abs=1e-9)
    assert hull_of_sum(PAIR, answered, [(other, 0.5)]) == pytest.approx((low - 0.02, high), abs=1e-9)
    assert hull_of_sum(PAIR, answered, [(fit(answered.model, STIFF, drives(), answered), 1.0)]) == (low, high)
    limits = np.tile([0.0, 0.1], (len(answered.names), 1))
    (said,) = steering(answered, [(later(answered, 0.04), 1.0)], limits)
    late = sum(answered.values[name] for name in PAIR)
    assert said.startswith(
        f"steering and tires together are {1000 * late:.0f} ({np.floor(1000 * low):.0f} to "
        f"{np.ceil(1000 * high + 40):.0f}) ms late"
    )
    relaxed = replace(answered, free=(*answered.free, "relaxation_f"))
    monkeypatch.setattr(type(answered), "values", answered.values)
    assert steering(relaxed, [], limits)[0].startswith("the road wheels are ")


@pytest.mark.parametrize(("lever", "unit"), [(-1.0, True), (-0.4, False), (0.5, False), (1.9, True)])
def test_a_place_of_v_y_that_no_centre_of_gravity_explains_may_be_another_unit(lever, unit):
    """Of v_y in km/h it was said that l_f is 3.24 m at a wheelbase of 3.3 m, and C_f 2 140 N/rad of a van's 100 000."""
    p = SaturatingBicycleParams(mass=2800.0, wheelbase=3.3, l_f=2.2, inertia_z=6400.0, C_f=1e5, C_r=1.9e5)
    final: Any = SimpleNamespace(
        free=("lever_v_y",),
        names=("lever_v_y",),
        values={"lever_v_y": lever, "C_f": 4e4, "C_r": 7e4, "inertia_z": 6400.0},
        model=SimpleNamespace(ode=SimpleNamespace(params=p), value=lambda name: getattr(p, name)),
    )
    (said,) = misplaced(final, [], np.array([[lever - 0.1, lever + 0.1]]))
    assert said.startswith(f"v_y reads as if measured {lever:+.2g} m")
    assert ("another unit, such as km/h" in said) == unit
    assert ("C_f about" in said) == (not unit)


def test_no_interval_is_promised_beside_another_doubt():
    """Of a speed in mph, a gain of 0.47 was said, and a late v_y with intervals that hold: they were off fourfold."""
    data = behind(v_y=0.2)
    _, said = with_lateness(fitted(data), [], data)
    assert held(said, doubted=False) == said
    assert said[0].endswith("intervals of C_f, C_r and inertia_z hold for either")
    (doubted,) = held(said, doubted=True)
    assert doubted.endswith("take another sensor; no interval holds until what else is doubted is mended")
    final: Any = SimpleNamespace(values={"steering_gain": 0.47}, model=SimpleNamespace(outputs=("v_y", "r")))
    assert [s.startswith("the road wheels turn 0.47 times") for s in turning(final, 1.0)] == [True]
    assert turning(final, 0.5) == []
