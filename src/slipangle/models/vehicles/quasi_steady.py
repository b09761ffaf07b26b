"""Single track whose wheels are in equilibrium at every instant: six states, nothing stiff."""

from dataclasses import dataclass

from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.axle import ground_velocity, slip_angles, steered
from slipangle.models.vehicles.parameters import SingleTrackParams
from slipangle.ops import Vector, clip, cos, sin, stack


@dataclass(frozen=True, kw_only=True)
class QuasiSteadySingleTrack(OdeModel):
    """Single track with quasi-steady wheels, for prediction.

    The slip of a wheel settles within about a millisecond, so the longitudinal force is what the torque leaves after
    turning the wheel along with the car, ``F_x radius = T - inertia v_x' / radius``, at most ``grip`` times the load.
    States v_x, v_y [m/s], r [rad/s], X, Y [m], psi [rad]; inputs delta [rad], T_f, T_r [N m] per axle. Lateral forces
    are those of wheels that roll without longitudinal slip, so the tires' directions must not see each other. Raises
    ParameterError if the tires share their friction between the directions.

    Parameters
    ----------
    tire_f, tire_r : Tire
        One front and one rear tire.
    grip : float
        Largest longitudinal force over load. [-]

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. 3-1 to 3-8 with 3-4, 3-5 at rest.
    """

    states = ("v_x", "v_y", "r", "X", "Y", "psi")
    inputs = ("delta", "T_f", "T_r")
    max_step = 0.05
    params: SingleTrackParams
    tire_f: Tire
    tire_r: Tire
    grip: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for tire in (self.tire_f, self.tire_r):
            free, driven = (float(tire.forces(s, 0.05, 1000.0).F_y) for s in (0.0, 0.05))
            if abs(free - driven) > 1e-9 * (1 + abs(free)):
                raise ParameterError(
                    "the tires' lateral force depends on their slip ratio, which quasi-steady wheels do not know; "
                    'expected tires with combined="none": use SingleTrack, or such tires'
                )

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of the six states."""
        p, (v_x, v_y, r, psi) = self.params, (x[0], x[1], x[2], x[5])
        delta = p.road_wheel(u[0])
        alpha_f, alpha_r = slip_angles(v_x, v_y, r, delta, p)
        F_yf = 2 * self.tire_f.forces(0.0, alpha_f, p.load_f).F_y
        F_yr = 2 * self.tire_r.forces(0.0, alpha_r, p.load_r).F_y
        most_f, most_r = 2 * self.grip * p.load_f, 2 * self.grip * p.load_r
        F_xf, F_xr = clip(u[1] / p.radius, -most_f, most_f), clip(u[2] / p.radius, -most_r, most_r)
        turning = (p.inertia_wheel_f * cos(delta) + p.inertia_wheel_r) / p.radius**2
        a_x = (F_xf * cos(delta) - F_yf * sin(delta) + F_xr + p.mass * v_y * r) / (p.mass + turning)
        F_xf = F_xf - p.inertia_wheel_f * a_x / p.radius**2
        _, across = steered(F_xf, F_yf, delta)
        return stack(
            [
                a_x,
                (across + F_yr) / p.mass - v_x * r,
                (p.l_f * across - p.l_r * F_yr) / p.inertia_z,
                *ground_velocity(v_x, v_y, psi),
                r,
            ]
        )
