"""Magic Formula 6.1 fitted to rig runs of a tire that is none: a brush whose friction falls as it slides."""

import warnings
from types import SimpleNamespace

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels
from slipangle.data.tire_data import joined
from slipangle.errors import IdentifiabilityWarning, ModelWarning
from slipangle.identify.tires.magic_formula import MagicFormulaFit, typical
from tests.identify.tires.test_magic_formula import prediction, rms
from tests.rig import SIZE, UNITS, channels

WIDTHS = {"slip_angle": np.deg2rad(1.0), "slip_ratio": 0.02, "gamma": np.deg2rad(0.5), "load": 30.0, "pressure": 3e3}


class Brush:
    """Parabolic pressure, eqs. 3.19 to 3.42 of Pacejka; stiffness and friction fall with load, camber steers."""

    def evaluate(self, kappa, alpha, load, *, axes, camber, pressure):
        """Forces and moments in ISO-W, in which a positive slip angle pushes to the right."""
        assert axes == "ISO-W"
        over, inflated = load / SIZE["FNOMIN"] - 1, pressure / SIZE["NOMPRES"] - 1
        x = 34 * load * (1 - 0.1 * over) * kappa / (1 + kappa)
        across = np.tan(-alpha + 0.1 * camber + 0.002) / (1 + kappa)
        y = 26 * load * (1 - 0.25 * over) * (1 + 0.2 * inflated) * across
        sliding = np.hypot(kappa / (1 + kappa), across) / 0.25
        grip = 2.4 * (1 - 0.12 * over) * (1 - 0.05 * inflated) * (0.85 + 0.15 / (1 + sliding**2)) * load
        size = np.hypot(x, y) + 1e-9
        rho = np.minimum(size / (3 * grip), 1)
        share = grip * (3 * rho - 3 * rho**2 + rho**3) / size
        trail = 0.03 * (1 - rho) ** 3 / (3 - 3 * rho + rho**2)
        return SimpleNamespace(F_x=share * x, F_y=share * y, M_x=-0.003 * share * y, M_z=-trail * share * y)


def scatter(data, name):
    """Standard deviation inside bins of equal slip, load, camber, pressure: what no function of these explains."""
    keys = np.column_stack([np.round(getattr(data, n) / width) for n, width in WIDTHS.items()])
    _, which, count = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    y = getattr(data, name)
    mean = np.bincount(which, y) / count
    alone = count[which] > 1
    return float(np.sqrt(np.sum((y - mean[which])[alone] ** 2) / np.sum(1 - 1 / count[which][alone])))


@pytest.mark.slow
def test_forces_of_another_tire_are_followed_to_what_scatters_inside_bins():
    runs = {
        kind: from_channels(channels(kind, seed=k, noise=0.02, tire=Brush()), UNITS)
        for k, kind in enumerate(("cornering", "drive/brake"))
    }
    both = joined(list(runs.values()), name="brush")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        warnings.simplefilter("ignore", ModelWarning)
        tire = MagicFormulaFit(start=typical(both, radius=SIZE["UNLOADED_RADIUS"])).fit(both)
    for data in runs.values():
        off, level = rms(prediction(tire, data).F_y - data.F_y), scatter(data, "F_y")
        assert off <= 1.05 * level
        assert level < 0.03 * rms(data.load) * 2.4  # the bins are narrow: noise is 0.02 of the load
