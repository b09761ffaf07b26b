"""Linear bicycle: lateral motion at a given speed."""

from dataclasses import dataclass

from slipangle.models.ode import OdeModel
from slipangle.models.vehicles.axle import slip_speed, small_slip_angles
from slipangle.models.vehicles.parameters import BicycleParams
from slipangle.ops import Scalar, Vector, stack


def bicycle(v_y: Scalar, r: Scalar, delta: Scalar, v_x: Scalar, p: BicycleParams) -> Vector:
    """Rates of v_y [m/s2] and r [rad/s2] of the linear bicycle.

    ``delta`` is the road-wheel angle [rad], ``v_x`` the speed [m/s], which may vary. Below
    `lowest_speed` the speed in the slip denominators stays there, so the model remains defined at standstill.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. 3-19, 3-20, yaw damping corrected: eq. 3-20 prints it with
    C_r l_r^2 subtracted and a spurious v_x.
    """
    v = slip_speed(v_x, p)
    alpha_f, alpha_r = small_slip_angles(v, v_y, r, delta, p)
    F_yf, F_yr = p.C_f * alpha_f, p.C_r * alpha_r
    return stack([(F_yf + F_yr) / p.mass - v_x * r, (p.l_f * F_yf - p.l_r * F_yr) / p.inertia_z])


@dataclass(frozen=True, kw_only=True)
class Bicycle(OdeModel):
    """Linear bicycle driven by the logged steering angle and the measured speed.

    States v_y [m/s], r [rad/s]; inputs delta [rad], v_x [m/s]; outputs r by default, v_y and a_y [m/s2]
    on request.
    """

    states = ("v_y", "r")
    inputs = ("delta", "v_x")
    params: BicycleParams
    outputs: tuple[str, ...] = ("r",)

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `bicycle`."""
        return bicycle(x[0], x[1], self.params.road_wheel(u[0]), u[1], self.params)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Lateral acceleration of the centre of gravity."""
        return {"a_y": self.derivative(x, u)[0] + u[1] * x[1]}

    def slip_speed(self, v_x: Scalar) -> Scalar:
        """Speed that slip angles are told over, at one as logged. [m/s]"""
        return slip_speed(v_x, self.params)
