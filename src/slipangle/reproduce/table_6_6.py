"""Table 6.6: lane changes, N = 5, 10, 15; protocol in `_chapter_6`."""

from slipangle.paths.lane_change import lane_changes
from slipangle.reproduce._chapter_6 import FRONT_DRIVE, drives
from slipangle.reproduce._tires_6 import simulated_tires

_PATH = lane_changes(20.0, change=50.0)
reproduce = drives("Table 6.6", "lane changes", FRONT_DRIVE, _PATH, simulated_tires)
