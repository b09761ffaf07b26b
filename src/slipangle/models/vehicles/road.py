"""`Road`: friction under each wheel, grade and bank, over the distance travelled."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from slipangle.errors import ParameterError
from slipangle.ops import Scalar, clip


def table(x: Scalar, places: Sequence[float], values: Sequence[Scalar]) -> Scalar:
    """Straight lines between values at rising places, constant beyond them, on numbers and symbols.

    >>> [float(table(x, (0.0, 1.0, 3.0), (5.0, 7.0, 3.0))) for x in (-1.0, 0.5, 2.0, 9.0)]
    [5.0, 6.0, 5.0, 3.0]
    """
    value = values[0]
    for i in range(len(places) - 1):
        share = clip((x - places[i]) / (places[i + 1] - places[i]), 0.0, 1.0)
        value = value + (values[i + 1] - values[i]) * share
    return value


def check_table(what: str, places: Sequence[float], values: Sequence[float]) -> None:
    """Raise a `ParameterError` unless places rise and there are as many values."""
    if len(places) != len(values):
        raise ParameterError(f"{what} has {len(places)} places and {len(values)} values; expected as many of each")
    if any(not b > a for a, b in pairwise(places)):
        raise ParameterError(f"{what} is given at {tuple(places)}; expected rising places")


@dataclass(frozen=True, kw_only=True)
class Road:
    """The road under the car; by default level, dry and the same everywhere.

    Raises ParameterError if a profile does not fit the places, or a friction is negative.

    Parameters
    ----------
    friction : tuple of 4 float
        Friction under the front left, front right, rear left, rear right wheel, relative to the road of the tire
        test, wherever the car is.
    distance : tuple of float
        Places along the road of the five profiles below, rising; between them straight lines. The front wheels reach a
        place before the centre of gravity, the rear wheels after it. [m]
    left, right : tuple of float
        Friction under the left, the right wheels at these places; multiplies `friction`.
    grade : tuple of float
        Slope of the road, positive uphill. [rad]
    bank : tuple of float
        Cross slope, positive where the left edge is the higher one. [rad]

    >>> wet_patch = Road(distance=(50.0, 50.1, 70.0, 70.1), left=(1.0, 0.5, 0.5, 1.0), right=(1.0, 0.5, 0.5, 1.0))
    >>> float(wet_patch.friction_at(0, 60.0))
    0.5
    """

    friction: tuple[Scalar, Scalar, Scalar, Scalar] = (1.0, 1.0, 1.0, 1.0)
    distance: tuple[float, ...] = ()
    left: tuple[float, ...] = ()
    right: tuple[float, ...] = ()
    grade: tuple[float, ...] = ()
    bank: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.friction) != 4:
            raise ParameterError(f"the road has {len(self.friction)} frictions; expected 4, one per wheel")
        for name in ("left", "right", "grade", "bank"):
            values = getattr(self, name)
            if values:
                check_table(f"the road's {name}", self.distance, values)
        for value in (*self.friction, *self.left, *self.right):
            if isinstance(value, int | float) and not 0 <= value <= 5:
                raise ParameterError(f"a friction of the road is {value}; expected 0 to 5")

    def friction_at(self, wheel: int, distance: Scalar) -> Scalar:
        """Friction under a wheel (0 to 3: front left, front right, rear left, rear right) at a place. [-]"""
        profile = self.right if wheel % 2 else self.left
        if not profile:
            return self.friction[wheel]
        return self.friction[wheel] * table(distance, self.distance, profile)

    def grade_at(self, distance: Scalar) -> Scalar:
        """Slope at a place, positive uphill. [rad]"""
        return table(distance, self.distance, self.grade) if self.grade else 0.0

    def bank_at(self, distance: Scalar) -> Scalar:
        """Cross slope at a place, positive where the left edge is higher. [rad]"""
        return table(distance, self.distance, self.bank) if self.bank else 0.0
