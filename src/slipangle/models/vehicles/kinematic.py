"""Kinematic single track: no tire slip."""

from dataclasses import dataclass

from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.axle import ground_velocity
from slipangle.models.vehicles.parameters import ChassisParams
from slipangle.ops import Scalar, Vector, stack, tan


def kinematic(psi: Scalar, v_x: Scalar, delta: Scalar, p: ChassisParams) -> Vector:
    """Rates of X, Y, psi of the kinematic single track about the centre of gravity, no tire slip.

    Source: R. Rajamani, Vehicle Dynamics and Control, 2nd ed., 2012, eqs. 2.4 to 2.6. The speed ``v_x``
    is that along the vehicle's x axis.
    """
    slope = tan(delta) / p.wheelbase
    v_y = v_x * p.l_r * slope
    return stack([*ground_velocity(v_x, v_y, psi), v_x * slope])


@dataclass(frozen=True, kw_only=True)
class Kinematic(OdeModel):
    """Kinematic single track: states X, Y [m], psi [rad]; inputs delta [rad], v_x [m/s]."""

    states = ("X", "Y", "psi")
    inputs = ("delta", "v_x")
    params: ChassisParams

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `kinematic`."""
        return kinematic(x[2], u[1], self.params.road_wheel(u[0]), self.params)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Yaw rate."""
        return {"r": self.derivative(x, u)[2]}
