"""Axis systems of tire files, and which coefficients differ between left and right."""

from typing import Literal

AxisSystem = Literal["ISO-W", "SAE", "adapted SAE"]
# Relative to ISO-W: sign of slip angle, sign of F_y, M_y and M_z. F_x, M_x, slip ratio and camber agree in all.
AXES: dict[str, tuple[float, float]] = {
    "ISO-W": (1.0, 1.0),
    "SAE": (-1.0, -1.0),
    "adapted SAE": (1.0, -1.0),
    "slipangle": (-1.0, 1.0),
}
# Coefficients of conicity, ply steer and other differences between left and right.
ASYMMETRIC = (
    *("RHX1", "QSX1", "PEY3", "PHY1", "PHY2", "PVY1", "PVY2", "RBY3", "RVY1", "RVY2"),
    *("QBZ4", "QDZ6", "QDZ7", "QEZ4", "QHZ1", "QHZ2", "SSZ1"),
)
