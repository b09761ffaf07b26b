"""What a log may need beyond the linear bicycle is found from where poorer structures stood."""

import numpy as np
import pytest

from slipangle.data.dataset import Dataset, join
from slipangle.identify.car.structures import STIFF, corrected, corrections, first_guess, fit
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


@pytest.mark.slow
def test_a_lag_is_found_after_the_tires_were_taken_to_be_late():
    """From no lag at all the search stayed there, and lost the correction that this car needs most."""
    data = join(*map(drive, range(5))).hold_mean()
    late, gain, saturates, _, relaxing = corrections(data, KNOWN["wheelbase"], ())
    before = fit(first_guess(**KNOWN, dt=DT, outputs=("r",), gain=1.0, banked=False), (*STIFF, "steering_offset"), data)
    for correction in (saturates, relaxing, gain):
        before = corrected(before, correction, data)
    after = corrected(before, late, data)
    assert after.values["steering_lag"] + after.values["delay_delta"] == pytest.approx(LAG, abs=0.005)
    assert after.sigma[0] < 0.97 * before.sigma[0]
