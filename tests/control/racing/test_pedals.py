"""Pedals against the dual track that they press."""

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ParameterError
from slipangle.models.vehicles.catalogue import BMW_320I, PASSENGER_TIRE
from slipangle.models.vehicles.dual_track.dual_track import DualTrack

CAR = DualTrack(params=BMW_320I, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
PEDALS = sa.Pedals.of(BMW_320I)


def accelerated(v, throttle, brake, seconds=0.5):
    """Mean acceleration of the plant between half and all of some seconds, and its speed then, air taken off."""
    x = CAR.straight(v)
    path = [x]
    for _ in range(round(seconds / 0.001)):
        x = np.asarray(CAR.functions[0](x, [0.0, throttle, brake]).full()).ravel() if CAR.kernel is None else x
        if CAR.kernel is not None:
            x = CAR.kernel.run(x, np.array([[0.0, throttle, brake]]))[-1]
        path.append(x)
    half = len(path) // 2
    speed = 0.5 * (path[half][0] + path[-1][0])
    p = BMW_320I
    rest = 0.5 * p.air_density * p.drag_area * speed**2 / p.mass + p.rolling_resistance * 9.81
    return (path[-1][0] - path[half][0]) / (0.001 * (len(path) - 1 - half)) + rest, speed


@pytest.mark.parametrize("v", [13.0, 22.0, 35.0])
@pytest.mark.parametrize("force", [-5000.0, -1500.0, 0.0, 800.0, 1800.0])
def test_the_car_gets_the_force_that_was_asked_for(v, force):
    throttle, brake = PEDALS.pressed(force, v, float(PEDALS.most(v)))
    found, _ = accelerated(v, throttle, brake)
    tight = 0.06 * BMW_320I.mass + 0.04 * abs(force)  # the wheels' inertia bears a part of the resistance too
    assert BMW_320I.mass * found == pytest.approx(force, abs=tight)
    assert sum(PEDALS.forces(throttle, brake, v, float(PEDALS.most(v)))) == pytest.approx(force, abs=1.0)


def test_pedals_end_at_their_stops():
    assert PEDALS.pressed(1e6, 20.0, float(PEDALS.most(20.0))) == (1.0, 0.0)
    assert PEDALS.pressed(-1e6, 20.0, float(PEDALS.most(20.0)))[1] == 1.0
    assert PEDALS.forces(1.0, 0.0, 20.0, 2000.0) == pytest.approx((2000.0, 0.0))


def test_forces_are_those_of_the_gear():
    line = BMW_320I.driveline
    for gear in (2, 3):
        ratio = line.ratios[gear - 1] * line.final / BMW_320I.radius
        turning = 2.0 * BMW_320I.inertia_wheel_f + line.engine.inertia * (ratio * BMW_320I.radius) ** 2
        share = BMW_320I.mass / (BMW_320I.mass + turning / BMW_320I.radius**2)
        expected = float(line.engine.torque(1.0, 22.0 * ratio)) * ratio * share
        assert float(PEDALS.most(22.0, gear)) == pytest.approx(expected, rel=1e-3)
    assert PEDALS.most(np.array([22.0, 22.0]), np.array([2, 3]))[1] == PEDALS.most(22.0, 3) < PEDALS.most(22.0, 2)
    assert PEDALS.most(22.0) == PEDALS.most(22.0, 2)  # the lowest that the engine turns
    throttle, brake = PEDALS.pressed(1000.0, 22.0, float(PEDALS.most(22.0, 3)), 3)
    assert throttle > PEDALS.pressed(1000.0, 22.0, float(PEDALS.most(22.0, 2)), 2)[0]
    assert sum(PEDALS.forces(throttle, brake, 22.0, float(PEDALS.most(22.0, 3)), 3)) == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"speeds": np.array([1.0, 1.0])}, "speeds that rise"),
        ({"brake": np.array([1.0, -1.0])}, "brake positive"),
        ({"full": np.array([-900.0, 5.0])}, "drives less"),
        ({"gearbox": PEDALS.gearbox}, None),
        (
            {"gearbox": PEDALS.gearbox, "full": np.full((2, 2), 5e3)},
            "of .1, 2. gears, the gearbox has 5; expected one row",
        ),
    ],
)
def test_pedals_that_are_none_are_refused(changed, words):
    good = {"speeds": np.array([0.0, 50.0]), "full": np.array([5e3, 2e3]), "closed": np.array([-300.0, -300.0])}
    given = {**good, "brake": np.array([1e4, 1e4]), **changed}
    if words is None:
        assert sa.Pedals(**given).most(10.0, 4) == sa.Pedals(**given).most(10.0)
        return
    with pytest.raises(ParameterError, match=words):
        sa.Pedals(**given)
