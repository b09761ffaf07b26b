"""Table 6.5: double lane change, N = 5, 10, 15; protocol in `_chapter_6`."""

from slipangle.paths.lane_change import double_lane_change
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, drives
from slipangle.reproduce._tires_6 import simulated_tires

_PATH = double_lane_change(20.0, blend=12.0)
reproduce = drives("Table 6.5", "double lane change", FRONT_DRIVE, _PATH, simulated_tires)
