"""Magic Formula and neural tires."""

from __future__ import annotations

import numpy as np

from slipangle.identify.judge.metrics import rmse
from slipangle.identify.tires.curves import MagicCurveFit
from slipangle.identify.tires.whole_tire import TireFit
from slipangle.models.tires.physical import BrushTire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_8
from slipangle.reproduce import table_6_4
from tests.identify.tires.test_curves import rig
from tests.identify.tires.test_magic_formula import BOTH, TIRE, prediction, quiet_fit, rms
from tests.identify.tires.test_whole_tire import BRUSH, measured
from tests.machines.registry import Errors, fit


@fit("Magic Formula curves with noise, table 6.8")
def _() -> Errors:
    found = np.zeros(2)
    for curve in (SOUSA_TABLE_6_8.longitudinal, SOUSA_TABLE_6_8.lateral):
        slip, mu = rig(curve, noise=0.06)
        fitted = MagicCurveFit().fit(slip, mu)
        far = np.linspace(-0.3, 0.3, 200)
        found += rmse(mu, fitted(slip)), rmse(curve(far), fitted(far))
    return {"train": found[0], "validation": found[1]}


BOUNDS = {
    f"train {label}": sum(float(p) + table_6_4.half_digit(p) for p in (printed[1], printed[3]))
    for label, printed in table_6_4.PRINTED.items()
}


@fit("neural tires, table 6.4", most=BOUNDS, noise=1e-4)
def _() -> Errors:
    """Both curves, each network; between the curves' points too."""
    errors = {}
    for label in table_6_4.PRINTED:
        found = np.zeros(2)
        for slip, mu in table_6_4.data():
            curve = table_6_4.settings(label).fit(slip, mu)
            between = (slip[1:] + slip[:-1]) / 2
            found += rmse(mu, curve(slip)), rmse((mu[1:] + mu[:-1]) / 2, curve(between))
        errors |= {f"train {label}": found[0], f"validation {label}": found[1]}
    return errors


@fit("brush tire from a rig")
def _() -> Errors:
    start = BrushTire(C_alpha=2e4, C_s=3e5, mu=0.6, half_length=0.02)
    train, test = measured(BRUSH), measured(BRUSH, seed=1, loads=(3e3, 5e3))
    model = TireFit(start=start, free=("C_alpha", "C_s", "mu")).fit(train)

    def error(data) -> float:
        out = model.forces(data.slip_ratio, data.slip_angle, data.load)
        return float(np.hypot(rmse(data.F_x, out.F_x), rmse(data.F_y, out.F_y)))

    return {"train": error(train), "validation": error(test)}


@fit("Magic Formula 6.1 from rig runs, pruned")
def _() -> Errors:
    """Forces beside the measured ones, and beside the true ones on the same slips, in the noise of each."""
    tire = quiet_fit(BOTH)
    found, true, pairs = prediction(tire, BOTH), prediction(TIRE, BOTH), []
    for name in ("F_x", "F_y"):
        noise = rms(getattr(BOTH, name) - getattr(true, name))
        measured_error = rms(getattr(BOTH, name) - getattr(found, name)) / noise
        pairs.append((measured_error, rms(getattr(found, name) - getattr(true, name)) / noise))
    return dict(zip(("train", "validation"), np.sqrt(np.mean(np.square(pairs), axis=0)), strict=True))
