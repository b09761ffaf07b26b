"""Single track with wheel spin on any tires."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import MissingColumnError, ParameterError, nearest
from slipangle.models.ode import OdeModel
from slipangle.models.tires.on_road import OnRoad
from slipangle.models.tires.simple import Tire, slip_ratio
from slipangle.models.vehicles.axle import axle_velocities, crawl, ground_velocity, slip_angles, steered
from slipangle.models.vehicles.parameters import SingleTrackParams
from slipangle.ops import Scalar, Vector, cos, sin, stack


def single_track(x: Vector, u: Vector, p: SingleTrackParams, tire_f: Tire, tire_r: Tire) -> Vector:
    """State rates of the single track with wheel spin.

    The state is v_x, v_y [m/s], r [rad/s], omega_f, omega_r [rad/s], X, Y [m], psi [rad]; inputs are the road-wheel
    angle [rad] and the drive torque on the front and on the rear axle [N m]. The tires are one of the two of an axle;
    below `crawl` slip is softened. Slip angles use atan2 of the axle's velocity, and the front slip ratio the
    speed along the wheel's own plane; both reduce to eqs. 3-11 to 3-13 at small angles.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. 3-1 to 3-8, slip sign corrected.
    """
    v_x, v_y, r, omega_f, omega_r, psi = x[0], x[1], x[2], x[3], x[4], x[7]
    delta, T_f, T_r = u[0], u[1], u[2]
    v_yf, _ = axle_velocities(v_y, r, p)
    alpha_f, alpha_r = slip_angles(v_x, v_y, r, delta, p)
    v_wheel = v_x * cos(delta) + v_yf * sin(delta)
    front = tire_f.forces(slip_ratio(v_wheel, omega_f, p.radius, v_low=crawl(p)), alpha_f, p.load_f)
    rear = tire_r.forces(slip_ratio(v_x, omega_r, p.radius, v_low=crawl(p)), alpha_r, p.load_r)
    F_xf, F_yf, F_xr, F_yr = 2 * front.F_x, 2 * front.F_y, 2 * rear.F_x, 2 * rear.F_y
    along, across = steered(F_xf, F_yf, delta)
    return stack(
        [
            (along + F_xr) / p.mass + v_y * r,
            (across + F_yr) / p.mass - v_x * r,
            (p.l_f * across - p.l_r * F_yr) / p.inertia_z,
            (T_f - F_xf * p.radius) / p.inertia_wheel_f,
            (T_r - F_xr * p.radius) / p.inertia_wheel_r,
            *ground_velocity(v_x, v_y, psi),
            r,
        ]
    )


class StartsRolling(OdeModel):
    """A model whose states that nobody measured start as in straight driving at the first speed."""

    def _start(self, name: str, data: Dataset) -> float:
        if name in data:
            return float(data[name][0])
        if "v_x" not in data:
            raise MissingColumnError(
                f"'{data.name}' has no channel 'v_x', which the car starts from; {nearest('v_x', data.names)}: add the "
                "speed"
            )
        return float(self.straight(float(data["v_x"][0]))[self.states.index(name)])


@dataclass(frozen=True, kw_only=True)
class SingleTrack(StartsRolling):
    """Single track with wheel spin on any tires.

    States v_x, v_y [m/s], r, omega_f, omega_r [rad/s], X, Y [m], psi [rad]; inputs delta [rad], T_f, T_r
    [N m] per axle. The wheels are stiff (about 1500 1/s at 20 m/s on the thesis' tires, growing as 1/v_x):
    use ``method="radau"`` above a millisecond, with about one substep per 25 ms where wheels lock or spin.
    """

    states = ("v_x", "v_y", "r", "omega_f", "omega_r", "X", "Y", "psi")
    inputs = ("delta", "T_f", "T_r")
    max_step = 0.001
    params: SingleTrackParams
    tire_f: Tire
    tire_r: Tire

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """See `single_track`."""
        steered = stack([self.params.road_wheel(u[0]), u[1], u[2]])
        return single_track(x, steered, self.params, self.tire_f, self.tire_r)

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Accelerations of the centre of gravity, slip angles of the axles."""
        rate, delta = self.derivative(x, u), self.params.road_wheel(u[0])
        alpha_f, alpha_r = slip_angles(x[0], x[1], x[2], delta, self.params)
        return {
            "a_x": rate[0] - x[1] * x[2],
            "a_y": rate[1] + x[0] * x[2],
            "alpha_f": alpha_f,
            "alpha_r": alpha_r,
        }

    def varied(self, *, friction: Scalar = 1.0, mass: Scalar = 1.0) -> Self:
        """The car on another road and laden: factors of friction and of mass, with which its yaw inertia goes. [-]"""
        params = self.params.with_values(mass=mass * self.params.mass, inertia_z=mass * self.params.inertia_z)
        tires = {n: OnRoad(getattr(self, n), friction) for n in ("tire_f", "tire_r")}
        return replace(self, params=params, fit_info=None, **tires)

    @property
    def tells_tire_use(self) -> bool:
        """Whether its tires say what they have to give, see `tire_use`."""
        return None not in (self.tire_f.peak_friction, self.tire_r.peak_friction)

    def tire_use(self, x: Vector, u: Vector) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Tire forces used: along and across, front then rear, each over the largest one there is that way. [-]

        On a friction ellipse the two of an axle are a point of the unit circle: at its edge nothing is left.

        Parameters
        ----------
        x, u : array or symbols, shape (8, ...) and (3, ...)
            States and inputs, SI units.

        Raises
        ------
        ParameterError
            If the tires do not say what they have to give.
        """
        p, delta = self.params, self.params.road_wheel(u[0])
        alpha_f, alpha_r = slip_angles(x[0], x[1], x[2], delta, p)
        v_wheel = x[0] * cos(delta) + axle_velocities(x[1], x[2], p)[0] * sin(delta)
        shares: list[Scalar] = []
        for tire, v, omega, alpha, load in (
            (self.tire_f, v_wheel, x[3], alpha_f, p.load_f),
            (self.tire_r, x[0], x[4], alpha_r, p.load_r),
        ):
            known = tire.peak_friction
            if known is None:
                raise ParameterError(
                    f"a {type(tire).__name__} does not say what it has to give; expected a simple Magic Formula: use "
                    "that, or look at its forces"
                )
            forces = tire.forces(slip_ratio(v, omega, p.radius, v_low=crawl(p)), alpha, load)
            shares += [forces.F_x / (known[0] * load), forces.F_y / (known[1] * load)]
        return shares[0], shares[1], shares[2], shares[3]

    def straight(self, v_x: float, *, X: float = 0.0, Y: float = 0.0, psi: float = 0.0) -> np.ndarray:
        """State of straight driving at speed ``v_x`` [m/s] with rolling wheels."""
        omega = v_x / self.params.radius
        return np.array([v_x, 0.0, 0.0, omega, omega, X, Y, psi])
