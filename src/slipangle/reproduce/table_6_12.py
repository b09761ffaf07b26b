"""Table 6.12: lane changes, experimental tires, N = 5, 10, 15; protocol in `_chapter_6`."""

from slipangle.paths.lane_change import lane_changes
from slipangle.reproduce._chapter_6 import REAR_DRIVE, drives
from slipangle.reproduce._tires_6 import experimental_tires

_PATH = lane_changes(25.0, change=50.0)
reproduce = drives("Table 6.12", "lane changes, experimental tires", REAR_DRIVE, _PATH, experimental_tires)
