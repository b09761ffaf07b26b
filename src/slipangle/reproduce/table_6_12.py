"""Table 6.12: lane changes, experimental tires, horizons of 5, 10 and 15 steps of 0.1 s.

Plant: CVODES, tires from look-up tables of the labelled stand-in of table 6.8 without its noise. Prediction: the
coefficients of table 6.8, and MLP {1 1} fitted to the stand-in with noise, seed 0. Weights of eq. 6-4 (see
`slipangle.reproduce._chapter_6.Car` for their units). The thesis' path is not given: here changes of 3.5 m to the
left, back, to the right and back, each a quintic over 50 m, with 30 m straight between them. The full state is
measured; the reference is the path ahead at the wanted speed from the nearest point on it. Every row is driven by
real-time iterations and by converged plans. The thesis' own way, Ipopt on multiple shooting with CVODES inside,
solves the first steps of the same drive in the same run. Nothing is random but the fits.
"""

from __future__ import annotations

from slipangle.paths.lane_change import lane_changes
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_6 import REAR_DRIVE, drives, rows
from slipangle.reproduce._tires_6 import experimental_tires

PRINTED = [
    *rows("Pacejka", (0.2654, 0.7317, 0.5465), (0.2599, 0.7052, 0.9766), (0.2609, 0.7085, 1.6573)),
    *rows("Neural", (0.2661, 0.7373, 0.4382), (0.2603, 0.7101, 0.7757), (0.2612, 0.7136, 1.3855)),
]


def reproduce(progress: Progress) -> Reproduction:
    """Drive every row."""
    return drives(
        "Table 6.12: lane changes, experimental tires",
        __doc__,
        REAR_DRIVE,
        lane_changes(25.0, change=50.0),
        experimental_tires,
        PRINTED,
        progress,
    )
