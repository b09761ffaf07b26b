"""Phase planes against closed forms: the linear car's one equilibrium, the saturating car's saddles."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from slipangle.errors import ParameterError
from slipangle.models.analysis.phase_plane import phase_plane
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.models.vehicles.saturating_bicycle import RelaxingBicycle, SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.wrappers.delayed import Delayed
from tests.models.analysis.test_linearize import BICYCLE, CAR
from tests.oracles import handling as oracle

V = 25.0
GRIP = {"mu_f": 1.0, "mu_r": 1.0}
CARS = SaturatingBicycleParams(**CAR, **GRIP)
SATURATING = SaturatingBicycle(params=CARS, dt=0.02)


def rates(z, delta, v=V):
    """The saturating car's equations, written out."""
    weight, l_r = CAR["mass"] * GRAVITY / CAR["wheelbase"], CAR["wheelbase"] - CAR["l_f"]
    forces = []
    for load, C, arm, angle in (
        (weight * l_r, CAR["C_f"], CAR["l_f"], delta),
        (weight * CAR["l_f"], CAR["C_r"], -l_r, 0),
    ):
        alpha = angle - (z[0] + arm * z[1]) / v
        forces.append(load * math.sin(1.4 * math.atan(C / (1.4 * load) * alpha)))
    turn = (CAR["l_f"] * forces[0] - l_r * forces[1]) / CAR["inertia_z"]
    return [sum(forces) / CAR["mass"] - v * z[1], turn]


def test_a_linear_car_settles_from_everywhere_to_its_steady_state():
    found = phase_plane(BICYCLE, v_x=20.0, delta=0.02, points=7, duration=8.0)
    assert [e.kind for e in found.equilibria] == ["stable"]
    assert found.equilibria[0].r == pytest.approx(0.02 * oracle.yaw_gain(CAR, 20.0), rel=1e-8)
    assert found.equilibria[0].v_y == pytest.approx(0.02 * 20.0 * oracle.sideslip_gain(CAR, 20.0), rel=1e-8)
    assert found.settles.all()
    assert found.share == 1.0


def test_beyond_its_critical_speed_an_oversteering_car_has_a_saddle_only():
    car = Bicycle(params=BicycleParams(**{**CAR, "l_f": 1.6}), dt=0.02)
    v = 1.2 * oracle.critical_speed({**CAR, "l_f": 1.6})
    found = phase_plane(car, v_x=v, points=5, duration=2.0)
    assert [e.kind for e in found.equilibria] == ["saddle"]
    assert not found.settles.any()


def test_a_saturating_car_has_a_stable_region_between_two_saddles():
    delta = 0.03
    found = phase_plane(SATURATING, v_x=V, delta=delta, points=11, duration=4.0)
    assert [e.kind for e in found.equilibria] == ["saddle", "stable", "saddle"]
    for e in found.equilibria:
        assert rates((e.v_y, e.r), delta) == pytest.approx([0.0, 0.0], abs=1e-7)
    assert 0.5 < found.share < 0.95
    stable = found.equilibria[1]
    for i in range(0, 11, 2):
        for j in range(0, 11, 2):
            run = solve_ivp(lambda _, z: rates(z, delta), (0, 4.0), (found.v_y[j], found.r[i]), rtol=1e-8, atol=1e-9)
            gap = np.abs(run.y[:, -1] - [stable.v_y, stable.r]) / [found.v_y[-1], found.r[-1]]
            assert found.settles[i, j] == (gap < 0.02).all()
    assert found.v_y_dot[3, 4] == pytest.approx(rates((found.v_y[4], found.r[3]), delta)[0], rel=1e-9)


def test_states_besides_start_settled():
    relaxing = RelaxingBicycle(
        params=SaturatingBicycleParams(**CAR, **GRIP, relaxation_f=0.3, relaxation_r=0.3), dt=0.02
    )
    found, plain = (phase_plane(c, v_x=V, points=5, duration=1.0) for c in (relaxing, SATURATING))
    for a, b in zip(found.equilibria, plain.equilibria, strict=True):
        assert (a.v_y, a.r, a.kind) == (pytest.approx(b.v_y, abs=1e-5), pytest.approx(b.r, abs=1e-6), b.kind)
    assert found.r_dot == pytest.approx(plain.r_dot, abs=1e-9)


def test_bad_input_is_said():
    with pytest.raises(ParameterError, match="equations of motion with the states v_y and r"):
        phase_plane(Delayed(BICYCLE, delays={"delta": 0.05}), v_x=20.0)
    with pytest.raises(ParameterError, match="at least 5 points"):
        phase_plane(BICYCLE, v_x=20.0, points=2)


def test_it_shows_itself():
    found = phase_plane(BICYCLE, v_x=20.0, points=5, duration=1.0)
    figure = found.plot()
    assert {"trajectories", "starts", "stable"} == {t.name for t in figure.data if t.name}
    assert "72 km/h" in repr(found)
    assert "stable" in found.table().to_text()
