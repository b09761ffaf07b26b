"""Handling quantities against the linear bicycle's closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.models.analysis.handling import QUANTITIES, handling
from slipangle.models.analysis.linearize import linearize
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.models.wrappers.delayed import Delayed
from tests.models.all_models import ALL_MODELS
from tests.models.analysis.test_linearize import BICYCLE, CAR, fitted
from tests.oracles import handling as oracle

OVERSTEERING = {**CAR, "l_f": 1.6}
SPEEDS = np.array([10.0, 20.0, 30.0])


def car(values):
    return Bicycle(params=BicycleParams(**values), dt=0.02)


def test_quantities_are_those_of_the_closed_form():
    found = handling(BICYCLE, v_x=SPEEDS)
    K = oracle.gradient(CAR)
    assert found["understeer_gradient"] == pytest.approx(np.full(3, K), rel=1e-8)
    gain = np.array([oracle.yaw_gain(CAR, v) for v in SPEEDS])
    slip = np.array([oracle.sideslip_gain(CAR, v) for v in SPEEDS])
    assert found["yaw_gain"] == pytest.approx(gain, rel=1e-9)
    assert found["steering_sensitivity"] == pytest.approx(SPEEDS * gain, rel=1e-9)
    assert found["sideslip_gain"] == pytest.approx(slip, rel=1e-8)
    both = np.array([oracle.frequency_and_damping(CAR, v) for v in SPEEDS])
    assert found["natural_frequency"] == pytest.approx(both[:, 0], rel=1e-9)
    assert found["damping"] == pytest.approx(both[:, 1], rel=1e-9)
    peak = oracle.yaw_peak(CAR, 30.0)
    assert found["peak_time"][2] == pytest.approx(peak, rel=1e-4)
    assert found["overshoot"][2] == pytest.approx(oracle.yaw_step(CAR, 30.0, peak) / gain[2] - 1, rel=1e-6)
    assert found["tb_factor"][2] == pytest.approx(peak * 4.0 * slip[2] / (30.0 * gain[2]), rel=1e-4)
    assert oracle.yaw_step(CAR, 30.0, found["rise_time"][2]) == pytest.approx(0.9 * gain[2], rel=1e-4)
    weave = np.array([oracle.yaw_response(CAR, v, 2j * math.pi * 0.2) for v in SPEEDS])
    assert found["weave_yaw_gain"] == pytest.approx(np.abs(weave), rel=1e-9)
    assert found["weave_yaw_lag"] == pytest.approx(-np.angle(weave) / (2 * math.pi * 0.2), rel=1e-8)
    edge = oracle.yaw_response(CAR, 20.0, 2j * math.pi * found["bandwidth"][1])
    assert abs(edge) == pytest.approx(gain[1] / math.sqrt(2), rel=1e-3)
    assert found.characteristic_speed.value == pytest.approx(oracle.characteristic_speed(CAR), rel=1e-8)
    assert found.critical_speed.value == math.inf


def test_a_car_without_overshoot_has_no_peak():
    slow = handling(BICYCLE, v_x=[5.0])
    assert math.isnan(slow["peak_time"][0])
    assert slow["overshoot"][0] == 0.0


def test_an_oversteering_car_has_a_critical_speed_beyond_which_nothing_settles():
    v = oracle.critical_speed(OVERSTEERING)
    found = handling(car(OVERSTEERING), v_x=[0.9 * v, 1.1 * v])
    assert found.critical_speed.value == pytest.approx(v, rel=1e-7)
    assert found.characteristic_speed.value == math.inf
    assert found["rise_time"][0] > 0
    assert math.isnan(found["rise_time"][1])
    assert found["yaw_gain"][1] < 0
    slow = linearize(car(OVERSTEERING), v_x=0.9 * v).poles  # two real ones, below none of which a frequency shows
    assert found["natural_frequency"][0] == pytest.approx(np.sqrt(np.prod(slow).real), rel=1e-6)
    assert found["damping"][0] == pytest.approx(-slow.sum().real / 2 / np.sqrt(np.prod(slow).real), rel=1e-6)
    for name in ("natural_frequency", "damping"):  # one pole grows: w^2 < 0
        assert math.isnan(found[name][1])


def test_steering_gain_counts_and_wrappers_are_looked_through():
    geared = replace(BICYCLE, params=BICYCLE.params.with_values(steering_gain=1 / 15))
    found = handling(Delayed(geared, delays={"delta": 0.04}), v_x=[25.0])
    assert found["understeer_gradient"][0] == pytest.approx(oracle.gradient(CAR), rel=1e-6)
    assert found["yaw_gain"][0] == pytest.approx(oracle.yaw_gain(CAR, 25.0) / 15, rel=1e-6)
    held = 0.04 + 0.02 / 2  # inputs of a sampled model are held for a sample, which is half of one late
    plain = handling(BICYCLE, v_x=[25.0])
    assert found["weave_yaw_lag"][0] == pytest.approx(plain["weave_yaw_lag"][0] + held, abs=5e-4)


def test_bands_follow_the_covariance():
    model, covariance = fitted()
    found = handling(model, v_x=[20.0])
    L, m, l_f = CAR["wheelbase"], CAR["mass"], CAR["l_f"]
    slope = m / L * np.array([-(L - l_f) / CAR["C_f"] ** 2, l_f / CAR["C_r"] ** 2])
    assert found.stds["understeer_gradient"][0] == pytest.approx(math.sqrt(slope @ covariance @ slope), rel=1e-5)
    low, high = found.band("understeer_gradient")[0]
    assert low < oracle.gradient(CAR) < high


def test_a_black_box_needs_a_wheelbase():
    box = ALL_MODELS["ARX"]
    with pytest.raises(ParameterError, match=r"has no wheelbase; expected it: wheelbase=2.7"):
        handling(box, v_x=[20.0])
    found = handling(box, v_x=[20.0], wheelbase=2.7)
    yaw = found["yaw_gain"][0]
    assert found["understeer_gradient"][0] == pytest.approx(1 / (20 * yaw) - 2.7 / 400, rel=1e-9)
    assert math.isnan(found["sideslip_gain"][0])


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"v_x": []}, "v_x holds no speeds"),
        ({"v_x": [10.0, -1.0]}, "not above 0"),
        ({"wheelbase": -2.0}, "wheelbase is -2"),
    ],
)
def test_bad_input_gets_a_sentence(given, said):
    with pytest.raises(ParameterError, match=said):
        handling(BICYCLE, **given)


def test_models_that_do_not_steer_are_refused():
    with pytest.raises(ParameterError, match="expected a steering input delta and the yaw rate r"):
        handling(ALL_MODELS["longitudinal"])
    with pytest.raises(ParameterError, match="no quantity 'yawgain'; nearest are 'yaw_gain'"):
        handling(BICYCLE, v_x=[20.0])["yawgain"]


def test_every_quantity_names_its_standard():
    assert {q.standard for q in QUANTITIES.values()} >= {"ISO 4138", "ISO 7401", "ISO 13674-1"}
