"""Table 6.5: double lane change, horizons of 5, 10 and 15 steps of 0.1 s.

Plant: CVODES, tires of table 6.2. Prediction: the same tires, and MLP {2 2} fitted as in table 6.4, seed 0. Weights
of eq. 6-3 (see `slipangle.reproduce._chapter_6.Car` for their units). The thesis' path is not given: here the
lanes of ISO 3888-1, joined by quintics that reach 12 m into them, the smoothest line that keeps the vehicle between
the cones. The full state is measured; the reference is the path ahead at the wanted speed from the nearest point on
it. Every row is driven by real-time iterations and by converged plans. The thesis' own way, Ipopt on multiple
shooting with CVODES inside, solves the first steps of the same drive in the same run. Nothing is random but the
fits.
"""

from __future__ import annotations

from slipangle.paths.lane_change import double_lane_change
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, drives, rows
from slipangle.reproduce._tires_6 import simulated_tires

PRINTED = [
    *rows("Pacejka", (0.2029, 0.3959, 0.8437), (0.1989, 0.3872, 1.5745), (0.2019, 0.3925, 2.517)),
    *rows("Neural", (0.2014, 0.3938, 0.8264), (0.1972, 0.385, 1.6291), (0.1997, 0.3894, 2.5728)),
]


def reproduce(progress: Progress) -> Reproduction:
    """Drive every row."""
    return drives(
        "Table 6.5: double lane change",
        __doc__,
        FRONT_DRIVE,
        double_lane_change(20.0, blend=12.0),
        simulated_tires,
        PRINTED,
        progress,
    )
