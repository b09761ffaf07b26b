"""Table 6.11: double lane change, experimental tires, horizons of 5, 10 and 15 steps of 0.1 s.

Plant: CVODES, tires from look-up tables of the labelled stand-in of table 6.8 without its noise. Prediction: the
coefficients of table 6.8, and MLP {1 1} fitted to the stand-in with noise, seed 0. Weights of eq. 6-4 (see
`slipangle.reproduce._chapter_6.Car` for their units). The thesis' path is not given: here the lanes of ISO
3888-1, joined by quintics that reach 12 m into them, the smoothest line that keeps the vehicle between the cones.
The full state is measured; the reference is the path ahead at the wanted speed from the nearest point on it. Every
row is driven by real-time iterations and by converged plans. The thesis' own way, Ipopt on multiple shooting with
CVODES inside, solves the first steps of the same drive in the same run. Nothing is random but the fits.
"""

from __future__ import annotations

from slipangle.paths.lane_change import double_lane_change
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import REAR_DRIVE, drives, rows
from slipangle.reproduce._tires_6 import experimental_tires

PRINTED = [
    *rows("Pacejka", (0.3157, 0.61, 0.5588), (0.3119, 0.5944, 1.0134), (0.3125, 0.5904, 1.5668)),
    *rows("Neural", (0.3161, 0.6139, 0.4404), (0.3121, 0.5986, 0.8027), (0.3132, 0.5955, 1.1817)),
]


def reproduce(progress: Progress) -> Reproduction:
    """Drive every row."""
    return drives(
        "Table 6.11: double lane change, experimental tires",
        __doc__,
        REAR_DRIVE,
        double_lane_change(25.0, width=1.4, blend=12.0),
        experimental_tires,
        PRINTED,
        progress,
    )
