"""Which coefficients of Magic Formula 6.1 a fit frees, between which bounds, and what must vary to see them.

Bounds are wide of published tires; the range of the random starts is that of ordinary ones. Coefficients that enter by
their square or in a product of two have one sign here: the other is the same tire.
"""

from __future__ import annotations

from typing import NamedTuple


class Free(NamedTuple):
    """A coefficient: bounds, range of the starts, and what must vary: f load, c camber, p pressure."""

    name: str
    lower: float
    upper: float
    low: float = 0.0
    high: float = 0.0
    needs: str = ""


def _around_zero(reach: float, needs: str, *names: str) -> tuple[Free, ...]:
    return tuple(Free(name, -reach, reach, -0.002 * reach, 0.002 * reach, needs) for name in names)


LONGITUDINAL = (
    Free("PCX1", 0.8, 3.0, 1.2, 1.8),
    Free("PDX1", 0.1, 5.0, 0.8, 2.5),
    *_around_zero(3.0, "f", "PDX2"),
    *_around_zero(60.0, "c", "PDX3"),
    Free("PEX1", -20.0, 1.0, -1.0, 0.5),
    *_around_zero(20.0, "f", "PEX2", "PEX3"),
    *_around_zero(2.0, "", "PEX4"),
    Free("PKX1", 1.0, 300.0, 10.0, 60.0),
    *_around_zero(200.0, "f", "PKX2"),
    *_around_zero(3.0, "f", "PKX3"),
    *_around_zero(0.1, "", "PHX1"),
    *_around_zero(0.1, "f", "PHX2"),
    *_around_zero(0.5, "", "PVX1"),
    *_around_zero(0.5, "f", "PVX2"),
    *_around_zero(10.0, "p", "PPX1", "PPX2", "PPX3", "PPX4"),
)
LATERAL = (
    Free("PCY1", 0.8, 3.0, 1.2, 1.7),
    Free("PDY1", 0.1, 5.0, 0.8, 2.5),
    *_around_zero(3.0, "f", "PDY2"),
    *_around_zero(60.0, "c", "PDY3"),
    Free("PEY1", -20.0, 1.0, -1.0, 0.5),
    *_around_zero(20.0, "f", "PEY2"),
    *_around_zero(3.0, "", "PEY3"),
    *_around_zero(300.0, "c", "PEY4"),
    *_around_zero(3000.0, "c", "PEY5"),
    Free("PKY1", -300.0, -1.0, -60.0, -10.0),
    Free("PKY2", 0.05, 20.0, 1.0, 4.0, "f"),
    *_around_zero(20.0, "c", "PKY3"),
    Free("PKY4", 0.5, 4.0, 1.8, 2.2, "f"),
    *_around_zero(1000.0, "c", "PKY5"),
    *_around_zero(30.0, "c", "PKY6"),
    *_around_zero(30.0, "cf", "PKY7"),
    *_around_zero(0.1, "", "PHY1"),
    *_around_zero(0.1, "f", "PHY2"),
    *_around_zero(0.5, "", "PVY1"),
    *_around_zero(0.5, "f", "PVY2"),
    *_around_zero(20.0, "c", "PVY3"),
    *_around_zero(20.0, "cf", "PVY4"),
    *_around_zero(10.0, "p", "PPY1", "PPY3", "PPY4"),
    *_around_zero(10.0, "fp", "PPY2"),
    *_around_zero(10.0, "cp", "PPY5"),
)
COMBINED = (
    Free("RBX1", 0.5, 100.0, 5.0, 25.0),
    Free("RBX2", 0.0, 100.0, 3.0, 20.0),
    *_around_zero(10000.0, "c", "RBX3"),
    Free("RCX1", 0.3, 2.5, 0.9, 1.2),
    Free("REX1", -20.0, 1.0, -1.0, 0.5),
    *_around_zero(20.0, "f", "REX2"),
    *_around_zero(0.1, "", "RHX1"),
    Free("RBY1", 0.5, 100.0, 5.0, 25.0),
    Free("RBY2", 0.0, 100.0, 3.0, 20.0),
    *_around_zero(0.5, "", "RBY3"),
    *_around_zero(10000.0, "c", "RBY4"),
    Free("RCY1", 0.3, 2.5, 0.9, 1.2),
    Free("REY1", -20.0, 1.0, -1.0, 0.5),
    *_around_zero(20.0, "f", "REY2"),
    *_around_zero(0.1, "", "RHY1"),
    *_around_zero(0.1, "f", "RHY2"),
    Free("RVY1", -2.0, 2.0, -0.02, 0.02),
    *_around_zero(2.0, "f", "RVY2"),
    *_around_zero(30.0, "c", "RVY3"),
    Free("RVY4", 0.0, 300.0, 5.0, 30.0),
    Free("RVY5", -5.0, 5.0, 1.7, 2.1),
    Free("RVY6", 0.0, 150.0, 5.0, 30.0),
)
_TRAIL = (
    Free("QBZ1", 0.5, 100.0, 4.0, 15.0),
    *_around_zero(60.0, "f", "QBZ2", "QBZ3"),
    *_around_zero(60.0, "c", "QBZ4", "QBZ5"),
    Free("QBZ9", 0.0, 600.0, 5.0, 60.0),
    *_around_zero(100.0, "f", "QBZ10"),
    Free("QCZ1", 0.5, 2.5, 1.0, 1.3),
    Free("QDZ1", -0.1, 1.0, 0.05, 0.15),
    *_around_zero(1.0, "f", "QDZ2"),
    *_around_zero(60.0, "c", "QDZ3"),
    *_around_zero(500.0, "c", "QDZ4"),
    *_around_zero(0.2, "", "QDZ6"),
    *_around_zero(0.2, "f", "QDZ7"),
    *_around_zero(10.0, "c", "QDZ8", "QDZ10"),
    *_around_zero(30.0, "cf", "QDZ9", "QDZ11"),
    Free("QEZ1", -30.0, 1.0, -3.0, 0.0),
    *_around_zero(30.0, "f", "QEZ2", "QEZ3"),
    *_around_zero(5.0, "", "QEZ4"),
    *_around_zero(100.0, "c", "QEZ5"),
    *_around_zero(0.1, "", "QHZ1"),
    *_around_zero(0.1, "f", "QHZ2"),
    *_around_zero(5.0, "c", "QHZ3"),
    *_around_zero(5.0, "cf", "QHZ4"),
    *_around_zero(10.0, "p", "PPZ1"),
    *_around_zero(10.0, "cp", "PPZ2"),
)
_OVERTURNING = (
    *_around_zero(1.0, "", "QSX1"),
    *_around_zero(60.0, "c", "QSX2"),
    *_around_zero(10.0, "", "QSX3"),
    *_around_zero(5.0, "cp", "PPMX1"),
)
_OVERTURNING_WITH_LOAD = (
    *_OVERTURNING[:3],
    Free("QSX4", 0.0, 50.0, 1.0, 15.0, "f"),
    *_around_zero(5.0, "f", "QSX5"),
    Free("QSX6", 0.0, 10.0, 0.5, 2.0, "f"),
    *_around_zero(10.0, "cf", "QSX7"),
    Free("QSX8", -20.0, 20.0, 0.5, 5.0, "f"),
    Free("QSX9", -5.0, 5.0, -0.1, 0.1, "f"),
    Free("QSX10", -10.0, 10.0, 0.2, 1.0, "cf"),
    Free("QSX11", -10.0, 10.0, -2.0, 2.0, "cf"),
    _OVERTURNING[3],
)
# Alternatives for each moment, of which the data choose
MOMENTS: dict[str, tuple[tuple[Free, ...], ...]] = {"M_z": (_TRAIL,), "M_x": (_OVERTURNING, _OVERTURNING_WITH_LOAD)}
