"""Intervals of a car hold the truth where the noise of its sensors is coloured, before any floor widens them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from slipangle.data.dataset import join
from slipangle.identify.car import structures
from slipangle.identify.car.corrections import corrections
from slipangle.identify.car.stretches import stretches
from slipangle.identify.car.uncertainty import covariance
from tests.identify.car.test_identify_car import DT, KNOWN, STEERING, TRUE, log

SPEEDS = (10.0, 14.0, 18.0, 22.0, 26.0)
SIZES = {"v_y": 0.02, "r": 0.003}
FREE = (*structures.STIFF, "steering_offset", "delay_delta", "steering_lag", "steering_gain")
SETS = 150


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.9])
@pytest.mark.parametrize("outputs", [("v_y", "r"), ("r",)])
def test_intervals_hold_whatever_the_colour(pole, outputs):
    """150 noises on the linearised fit about the truth: 90 % and more inside, and not far wider than the scatter."""
    drives = (log(speed, seed, noise=0.0, outputs=outputs) for seed, speed in enumerate(SPEEDS))
    data = stretches(join(*drives).hold_mean(), structures.SLOWEST * KNOWN["wheelbase"]).all
    guess = structures.first_guess(**KNOWN, dt=DT, outputs=outputs, gain=1.0)
    known = {n: TRUE[n] for n in (*structures.STIFF, "mu_f", "mu_r")}
    known |= {"delay_delta": STEERING["delay"], "steering_lag": STEERING["lag"]}
    known |= {"steering_gain": STEERING["gain"], "steering_offset": STEERING["offset"]}
    late = next(c for c in corrections(data, KNOWN["wheelbase"], ()) if "steering_lag" in c.free)
    lagging = structures.corrected(structures.fit(guess, ("C_f",), data), late, data).model
    found = structures.fit(lagging.with_values(**known), FREE, data)
    size = np.array([SIZES[name] for name in outputs])
    slopes = found.jacobian * (found.sigma / size)[None, :, None]
    rows = slopes.reshape(-1, len(FREE))
    lengths = [len(y) - 1 for y in found.problem.measured]
    kept = [np.flatnonzero(np.arange(n) >= structures.settling(n, DT)) for n in lengths]
    rng, thinning, off, half = np.random.default_rng(0), 1.0, [], []
    for _ in range(SETS):
        parts = (rng.standard_normal((n + 300, len(outputs))) * np.sqrt(1 - pole**2) for n in lengths)
        every: list[np.ndarray] = [np.asarray(lfilter([1.0], [1.0, -pole], part, axis=0))[300:] for part in parts]
        noise = np.concatenate([e[k] for e, k in zip(every, kept, strict=True)])
        pull = found.pull * np.sqrt(thinning / found.thinning)
        moved = np.linalg.solve(rows.T @ rows + pull.T @ pull, rows.T @ noise.ravel())
        left = noise - slopes @ moved
        sigma = left.std(axis=0)
        settled = {"error": -left / sigma, "jacobian": slopes / sigma[None, :, None], "pull": pull}
        spread = covariance(replace(found, **settled, sigma=size * sigma, thinning=thinning))[0]
        half.append(1.96 * np.sqrt(np.diag(spread)) / found.problem.scale)
        off.append(moved)
        thinning = structures._thinning(left, found.stretch)
    rates = dict(zip(FREE, np.mean(np.abs(off) <= half, axis=0), strict=True))
    assert all(rate >= 0.9 for rate in rates.values()), rates
    assert (np.median(half, axis=0) < 1.4 * 1.96 * np.std(off, axis=0)).all()
