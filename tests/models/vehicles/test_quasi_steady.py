"""Quasi-steady wheels follow the full single track below saturation, and say where they cannot."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_2
from slipangle.models.vehicles.quasi_steady import QuasiSteadySingleTrack
from slipangle.models.vehicles.single_track import SingleTrack

KEPT = [0, 1, 2, 5, 6, 7]


@pytest.mark.parametrize("v_x", [10.0, 20.0, 35.0])
@pytest.mark.parametrize(("delta", "torque"), [(0.0, 1000.0), (0.02, 0.0), (0.02, 1500.0), (-0.01, -1500.0)])
def test_close_to_the_full_single_track(v_x, delta, torque):
    full = SingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2, method="radau")
    quasi = QuasiSteadySingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2)
    a, b, u = full.straight(v_x), quasi.straight(v_x), np.array([delta, torque, 0.0])
    for _ in range(5):
        a, b = full.step(a, u), quasi.step(b, u)
    assert b == pytest.approx(a[KEPT], rel=2e-3, abs=5e-3)


def test_combined_slip_is_refused():
    tire = replace(SOUSA_TABLE_6_2, combined="ellipse")
    with pytest.raises(ParameterError, match="combined"):
        QuasiSteadySingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=tire, tire_r=tire)


def test_torque_beyond_the_grip_gives_no_more_force():
    model = QuasiSteadySingleTrack(params=SOUSA_TABLE_6_1, dt=0.1, tire_f=SOUSA_TABLE_6_2, tire_r=SOUSA_TABLE_6_2)
    x = model.straight(20.0)
    strong, stronger = (model.derivative(x, np.array([0.0, T, 0.0]))[0] for T in (1e5, 2e5))
    assert strong == stronger < 9.81
