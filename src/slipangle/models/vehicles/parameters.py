"""Parameter records that several vehicles share."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Annotated, Self

from slipangle.errors import ModelWarning
from slipangle.models.parameters import ParameterSet
from slipangle.ops import Scalar, is_symbolic, is_traced
from slipangle.units import SI

GRAVITY = 9.81  # m/s2, the value of the thesis' tables
# kg/m3, mass over the wheelbase cubed: cars about 75, an open-wheeler 30, models 100 to 300, a full truck 700
_DENSITIES = 15.0, 1500.0
IMPOSSIBLE = 15.0  # times beyond these


@dataclass(frozen=True, kw_only=True)
class ChassisParams(ParameterSet):
    """Mass, geometry and steering: what every planar model needs, from a car of 40 g to a truck of 100 t.

    Warns with a ModelWarning where no vehicle of this length weighs so little or so much, as with a mass in tonnes, or
    its centre of gravity does not lie between the axles.
    """

    mass: Annotated[float, SI("kg", "vehicle mass", 1e-3, 1e5)]
    inertia_z: Annotated[float, SI("kg m2", "yaw moment of inertia", 1e-9, 1e6)]
    wheelbase: Annotated[float, SI("m", "wheelbase", 0.01, 20.0)]
    l_f: Annotated[float, SI("m", "centre of gravity to front axle", 1e-3, 15.0)]
    steering_gain: Annotated[float, SI("-", "road-wheel angle per logged steering angle", -20.0, 20.0)] = 1.0
    steering_offset: Annotated[float, SI("rad", "logged steering angle when driving straight", -0.3, 0.3)] = 0.0
    bias_r: Annotated[float, SI("rad/s", "measured yaw rate when there is none", -0.1, 0.1)] = 0.0
    bias_v_y: Annotated[float, SI("m/s", "measured lateral velocity when there is none", -5.0, 5.0)] = 0.0
    bias_a_y: Annotated[float, SI("m/s2", "measured lateral acceleration when there is none", -5.0, 5.0)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if is_symbolic(self.mass, self.wheelbase) or is_traced(self.mass) or is_traced(self.wheelbase):
            return
        said = weight_doubt(self.mass, self.wheelbase, beyond=IMPOSSIBLE)
        if not (is_symbolic(self.l_f) or is_traced(self.l_f) or self.l_f < self.wheelbase):
            said = (
                f"l_f is {self.l_f:g} m and the wheelbase {self.wheelbase:g} m; expected the centre of gravity between "
                "the axles: check both, and their units"
            )
        if said:
            warnings.warn(said, ModelWarning, stacklevel=3)

    @property
    def doubts(self) -> dict[str, Scalar]:
        """What is warned of where a set is made, for those that are changed elsewhere."""
        lightest, heaviest = _DENSITIES[0] / IMPOSSIBLE, _DENSITIES[1] * IMPOSSIBLE
        return {
            "l_f is not below the wheelbase: the centre of gravity is not between the axles": self.l_r,
            "no vehicle of this wheelbase has so little mass": self.mass - lightest * self.wheelbase**3,
            "no vehicle of this wheelbase has so much mass": heaviest * self.wheelbase**3 - self.mass,
        }

    @property
    def l_r(self) -> Scalar:
        """Distance from the centre of gravity to the rear axle. [m]"""
        return self.wheelbase - self.l_f

    @property
    def bicycle(self) -> BicycleParams | None:
        """The parameters where they are those of a linear bicycle."""
        return None

    def road_wheel(self, delta: Scalar) -> Scalar:
        """Road-wheel angle from the logged steering angle. [rad]"""
        return self.steering_gain * (delta - self.steering_offset)


def weight_doubt(mass: float, wheelbase: float, *, beyond: float = 1.0) -> str:
    """A sentence where no vehicle with this wheelbase [m] has this mass [kg], with the unit that would explain it.

    It is empty where the mass is within ``beyond`` times what vehicles of this length weigh.
    """
    lightest, heaviest = (density * wheelbase**3 for density in _DENSITIES)
    if lightest / beyond <= mass <= heaviest * beyond:
        return ""
    units = {"g": 1e-3, "t": 1e3}
    unit = next((u for u, size in units.items() if lightest <= mass * size <= heaviest), "")
    told = f"; {_digits(mass)} {unit} are {_digits(mass * units[unit])} kg" if unit else ""
    return (
        f"mass is {mass:.4g} kg at a wheelbase of {wheelbase:.4g} m; expected {_digits(lightest)} to "
        f"{_digits(heaviest)} kg: check both, and their units{told}"
    )


def _digits(value: float) -> str:
    """Three of them, without a power of ten where there is room."""
    return f"{value:.3g}" if value < 1000 else f"{float(f'{value:.3g}'):.0f}"


@dataclass(frozen=True, kw_only=True)
class BicycleParams(ChassisParams):
    """Linear bicycle: cornering stiffness is per axle."""

    C_f: Annotated[float, SI("N/rad", "front cornering stiffness, per axle", 1e-3, 1e7)]
    C_r: Annotated[float, SI("N/rad", "rear cornering stiffness, per axle", 1e-3, 1e7)]

    @property
    def bicycle(self) -> Self:
        """The parameters themselves."""
        return self

    def at_speed(self, v_x: float) -> Self:
        """The parameters of the linear bicycle at a speed ``v_x`` [m/s]: these, where stiffness knows no speed."""
        return self


@dataclass(frozen=True, kw_only=True)
class SingleTrackParams(ChassisParams):
    """Single track with wheel spin: inertia of both wheels of an axle together."""

    inertia_wheel_f: Annotated[float, SI("kg m2", "spin inertia of the front axle", 1e-11, 1e3)]
    inertia_wheel_r: Annotated[float, SI("kg m2", "spin inertia of the rear axle", 1e-11, 1e3)]
    radius: Annotated[float, SI("m", "rolling radius", 1e-3, 2.0)]

    @property
    def load_f(self) -> Scalar:
        """Static load on one front wheel. [N]"""
        return 0.5 * self.mass * GRAVITY * self.l_r / self.wheelbase

    @property
    def load_r(self) -> Scalar:
        """Static load on one rear wheel. [N]"""
        return 0.5 * self.mass * GRAVITY * self.l_f / self.wheelbase
