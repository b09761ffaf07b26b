"""Table 6.6: lane changes, horizons of 5, 10 and 15 steps of 0.1 s.

Plant: CVODES, tires of table 6.2. Prediction: the same tires, and MLP {2 2} fitted as in table 6.4, seed 0. Weights
of eq. 6-3 (see `slipangle.reproduce._chapter_6.Car` for their units). The thesis' path is not given: here changes
of 3.5 m to the left, back, to the right and back, each a quintic over 50 m, with 30 m straight between them. The
full state is measured; the reference is the path ahead at the wanted speed from the nearest point on it. Every row
is driven by real-time iterations and by converged plans. The thesis' own way, Ipopt on multiple shooting with
CVODES inside, solves the first steps of the same drive in the same run. Nothing is random but the fits.
"""

from __future__ import annotations

from slipangle.paths.lane_change import lane_changes
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, drives, rows
from slipangle.reproduce._tires_6 import simulated_tires

PRINTED = [
    *rows("Pacejka", (0.1728, 0.3941, 0.7887), (0.1663, 0.385, 1.5505), (0.1682, 0.391, 2.3741)),
    *rows("Neural", (0.171, 0.391, 0.8077), (0.1647, 0.381, 1.5303), (0.1661, 0.3872, 2.3223)),
]


def reproduce(progress: Progress) -> Reproduction:
    """Drive every row."""
    return drives(
        "Table 6.6: lane changes",
        __doc__,
        FRONT_DRIVE,
        lane_changes(20.0, change=50.0),
        simulated_tires,
        PRINTED,
        progress,
    )
