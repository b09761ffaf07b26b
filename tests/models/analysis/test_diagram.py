"""Handling diagrams against the linear gradient and the friction of the axles, which closed forms give."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from slipangle.errors import ParameterError
from slipangle.models.analysis.diagram import handling_diagram
from slipangle.models.analysis.handling import handling
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.wrappers.on_ground import OnGround
from tests.models.analysis.test_linearize import BICYCLE, CAR, fitted
from tests.oracles import handling as oracle


def saturating(mu_f, mu_r):
    return SaturatingBicycle(params=SaturatingBicycleParams(**CAR, mu_f=mu_f, mu_r=mu_r), dt=0.02)


def slip(force, load, C, mu, shape=1.4):
    """Slip angle below the peak at which the formula gives a force."""

    def missing(a):
        return mu * load * math.sin(shape * math.atan(C * a / (shape * mu * load))) - force

    return brentq(missing, 0.0, math.tan(math.pi / (2 * shape)) * shape * mu * load / C)


def test_a_linear_car_is_a_straight_line_without_a_limit():
    found = handling_diagram(BICYCLE, v_x=20.0)
    K = oracle.gradient(CAR)
    assert found.understeer_gradient == pytest.approx(np.full(41, K), rel=1e-7)
    assert found.understeer_angle == pytest.approx(K * found.a_y, rel=1e-7, abs=1e-12)
    assert found.a_y_max == math.inf
    assert found.limit == ""
    assert found.stable.all()
    assert np.isnan(found.understeer_angle_std).all()


def test_the_diagram_is_the_difference_of_the_axles_slip_angles():
    found = handling_diagram(saturating(0.9, 1.0), v_x=25.0, points=25)
    weight = CAR["mass"] * GRAVITY / CAR["wheelbase"]
    loads = weight * (CAR["wheelbase"] - CAR["l_f"]), weight * CAR["l_f"]
    low = found.a_y < 0.97 * found.a_y_max
    expected = [
        slip(loads[0] * a / GRAVITY, loads[0], CAR["C_f"], 0.9)
        - slip(loads[1] * a / GRAVITY, loads[1], CAR["C_r"], 1.0)
        for a in found.a_y[low]
    ]
    assert found.understeer_angle[low] == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(("mu_f", "mu_r", "limit"), [(0.9, 1.0, "understeer"), (1.0, 0.9, "oversteer")])
def test_the_axle_with_less_friction_sets_the_limit(mu_f, mu_r, limit):
    found = handling_diagram(OnGround(saturating(mu_f, mu_r)), v_x=25.0)
    assert found.a_y_max == pytest.approx(0.9 * GRAVITY, rel=1e-3)
    assert found.limit == limit
    assert found.stable[0]
    assert found.stable.all() == (limit == "understeer")
    assert f"limit 8.83 m/s2, {limit}" in repr(found)
    assert f"by {limit}" in found.table().caption


def test_the_band_is_that_of_the_gradient():
    model, _ = fitted()
    found, linear = handling_diagram(model, v_x=20.0), handling(model, v_x=[20.0])
    expected = linear.stds["understeer_gradient"][0] * found.a_y
    assert found.understeer_angle_std == pytest.approx(expected, rel=1e-4, abs=1e-12)
    assert np.ptp(found.band()[-1]) == pytest.approx(2 * 1.96 * expected[-1], rel=1e-3)


def test_bad_input_is_said():
    with pytest.raises(ParameterError, match="at least 5 points"):
        handling_diagram(BICYCLE, v_x=20.0, points=3)
    arx = ARXModel(A=np.array([[[-0.5]]]), B=np.array([[[1.0]]]), dt=0.1, inputs=("u",), outputs=("y",))
    with pytest.raises(ParameterError, match="expected a steering input delta"):
        handling_diagram(arx, v_x=20.0)


def test_the_figure_holds_the_numbers():
    one = handling_diagram(saturating(1.0, 0.9), v_x=25.0)
    figure = one.plot(handling_diagram(BICYCLE, v_x=25.0))
    solid, dotted = (np.asarray(t.y, dtype=float) for t in figure.data[:2])
    kept = np.isfinite(solid)
    assert kept.sum() < len(one.a_y)
    assert solid[kept] == pytest.approx(np.degrees(one.understeer_angle)[kept], rel=1e-6, abs=1e-6)
    assert (np.isfinite(solid) | np.isfinite(dotted)).all()
    assert len(figure.layout.shapes) == 1  # the limit of the one that has one
