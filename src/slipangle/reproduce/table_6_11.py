"""Table 6.11: double lane change, experimental tires, N = 5, 10, 15; protocol in `_chapter_6`."""

from slipangle.paths.lane_change import double_lane_change
from slipangle.reproduce._chapter_6 import REAR_DRIVE, drives
from slipangle.reproduce._tires_6 import experimental_tires

_PATH = double_lane_change(25.0, width=1.4, blend=12.0)
reproduce = drives("Table 6.11", "double lane change, experimental tires", REAR_DRIVE, _PATH, experimental_tires)
