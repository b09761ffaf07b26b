"""Table 4.4, example 3: networks fitted to a dimensionless cornering force, on a labelled stand-in.

The thesis takes force and moment data of a 2017 Indy Lights tire from its maker (1471 N, no camber), which cannot be
shipped. The stand-in is a cornering force over its peak at one load: a Magic Formula with C = 1.4, E = -0.3 and its
peak at 5 degrees, small shifts as real tires have them, 97 slip angles over +-12 degrees, Gaussian noise of 0.02 (the
RMSE that the thesis' better network leaves), noise seed 0. Bounds of table 4.3, multiquadric RBF, hyperbolic-tangent
MLP, 16 random starts each, seed 0. The numbers of thesis and stand-in are of different data: they are compared as
levels of accuracy, and ours also against the noise floor, the standard deviation of the noise that was added.
"""

import numpy as np

from slipangle.identify.judge.metrics import r2, rmse
from slipangle.identify.tires.presets import SOUSA_TABLE_4_3
from slipangle.models.tires.simple import MagicCurve
from slipangle.report.records import Record
from slipangle.report.tire_fits import curve_figure
from slipangle.reproduce import Progress, Reproduction

PRINTED = {"RBF {3}": (0.9984, 0.0347), "MLP {2 2}": (0.9995, 0.0202)}
# B puts the peak at 5 degrees for these C and E
TRUTH = MagicCurve(B=21.14, C=1.4, D=1.0, E=-0.3, S_h=0.002, S_v=0.01)
NOISE = 0.02


def stand_in(*, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slip angle [rad], cornering force over its peak [-] and the noise in it."""
    angle = np.deg2rad(np.linspace(-12.0, 12.0, 97))
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(angle))
    return angle, TRUTH(angle) + noise, noise


def reproduce(progress: Progress) -> Reproduction:
    """Fit both networks."""
    angle, force, noise = stand_in()
    floor = float(np.std(noise))
    records: list[Record] = []
    shown = {}
    for k, (label, (printed_r2, printed_rmse)) in enumerate(PRINTED.items()):
        progress(k / len(PRINTED), f"{label} on the cornering force")
        curve = SOUSA_TABLE_4_3[label].fit(angle, force)
        shown[label] = curve
        here_r2, here_rmse = float(r2(force, curve(angle))), float(rmse(force, curve(angle)))
        limit = min(printed_rmse, 1.02 * floor)
        row, note = f"table 4.4, {label}", f"noise floor {floor:.4g}, and at most 2 % above it"
        different = "stand-in data: see the protocol"
        records += [
            Record.judged(row, "R2 [-]", printed_r2, here_r2, at_least=printed_r2, note=different),
            Record.judged(row, "RMSE [-]", printed_rmse, here_rmse, at_most=limit, digits=4, note=note),
        ]
    title = "cornering force over its peak [-]"
    return Reproduction.told(__doc__, records, [curve_figure(angle, force, shown, along=False, friction_title=title)])
