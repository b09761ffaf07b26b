"""A tire on a road of another friction."""

from dataclasses import dataclass
from typing import Any

from slipangle.models.tires.simple import Tire, TireForces
from slipangle.ops import Scalar


@dataclass(frozen=True)
class OnRoad(Tire):
    """A tire on a road of another friction, a number or a symbol, relative to the road of its test. [-]"""

    tire: Tire
    friction: Any

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Those of the tire at the product of both frictions."""
        return self.tire.forces(slip_ratio, slip_angle, load, camber=camber, friction=self.friction * friction)

    @property
    def peak_friction(self) -> tuple[Scalar, Scalar] | None:
        """See `Tire.peak_friction`."""
        known = self.tire.peak_friction
        return None if known is None else (self.friction * known[0], self.friction * known[1])
