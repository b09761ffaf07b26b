"""Table 6.9: networks and the simple Magic Formula fitted to tire data, on a labelled stand-in.

Data as in `table_6_8`, noise seed 0; bounds of tables 6.3 and 6.7, 16 random starts each, seed 0, otherwise as in
`table_6_4`. RMSE is judged against the noise floor, the standard deviation of the noise that was added: within 2 % of
it where the thesis' RMSE is within 2 % of its own (0.124 and 0.063), else no further from it than the thesis, as a
ratio. One radial function is no tire: RBF {1} only has to beat the mean, which any constant nearly does, and its row
says so.
"""

import time
import warnings
from typing import Any

import numpy as np

from slipangle.errors import IdentifiabilityWarning
from slipangle.identify.judge.metrics import r2, rmse
from slipangle.identify.tires.curves import SOUSA_TABLE_6_7, CurveFit, MagicCurveFit
from slipangle.report.records import Record
from slipangle.report.tire_fits import curve_figure
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce.table_6_4 import settings
from slipangle.reproduce.table_6_8 import NOISE, stand_in

# R2, RMSE of mu_x, R2, RMSE of mu_y, average time [s]
PRINTED = {
    "RBF {1}": (0.4403, 1.6741, 0.2978, 1.9688, 0.0255),
    "RBF {2}": (0.9953, 0.1512, 0.9988, 0.0829, 0.2310),
    "RBF {3}": (0.9968, 0.1273, 0.9992, 0.0679, 0.9600),
    "RBF {4}": (0.9968, 0.1261, 0.9992, 0.0647, 1.1300),
    "RBF {5}": (0.9919, 0.2013, 0.9992, 0.0655, 4.2050),
}
PRINTED |= {
    "MLP {1 1}": (0.9957, 0.1472, 0.9991, 0.0713, 0.0415),
    "MLP {2 2}": (0.9968, 0.1259, 0.9993, 0.0639, 0.7920),
    "MLP {3 3}": (0.9969, 0.1238, 0.9993, 0.0634, 1.7550),
    "MLP {1 1 1}": (0.9957, 0.1474, 0.9991, 0.0695, 0.2670),
    "MLP {2 2 2}": (0.9968, 0.1249, 0.9993, 0.0635, 1.9750),
    "MLP {3 3 3}": (0.9970, 0.1246, 0.9993, 0.0632, 3.2150),
    "Pacejka": (0.9966, 0.1313, 0.9992, 0.0671, 0.2550),
}
_CLOSE = 1.02  # times the noise floor


def reproduce(progress: Progress) -> Reproduction:
    """Fit all twelve models to both curves."""
    records: list[Record] = []
    shown: dict[str, dict[str, Any]] = {curve: {} for curve in NOISE}
    for k, (label, printed) in enumerate(PRINTED.items()):
        progress(k / len(PRINTED), f"{label} on both friction curves")
        fit: CurveFit = (
            MagicCurveFit(lower=SOUSA_TABLE_6_7[0], upper=SOUSA_TABLE_6_7[1], level=None)
            if label == "Pacejka"
            else settings(label)
        )
        for j, curve in enumerate(NOISE):
            slip, friction, noise = stand_in(curve)
            floor, spread = float(np.std(noise)), float(np.std(friction))
            began = time.process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", IdentifiabilityWarning)  # table 6.8 is about the coefficients
                found: Any = fit.fit(slip, friction)
            fitted = found(slip)
            if label in ("RBF {2}", "MLP {1 1}", "Pacejka"):  # those of fig. 6.8
                shown[curve][label] = found
            seconds = time.process_time() - began
            here = float(rmse(friction, fitted))
            ratio = max(_CLOSE, printed[2 * j + 1] / NOISE[curve])
            limit = spread if label == "RBF {1}" else ratio * floor
            why = "data's own" if label == "RBF {1}" else f"{ratio:.3g} x floor {floor:.4g}"
            bound, level = f"<= {limit:.4g} ({why})", float(r2(friction, fitted))
            note = f"{curve}: R2 {level:.4f} (thesis {printed[2 * j]}), {seconds:.2f} s"
            if label == "RBF {1}":
                note += "; a bound that the best constant meets too: this row tells nothing about the fit"
            row = f"table 6.9, {label}"
            records.append(Record(row, f"{curve} RMSE [-]", printed[2 * j + 1], here, bound, here <= limit, note))
    figures = [curve_figure(*stand_in(curve)[:2], curves, along=curve == "mu_x") for curve, curves in shown.items()]
    return Reproduction.told(__doc__, records, figures)
