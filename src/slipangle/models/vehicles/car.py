"""`DualTrackParams`: the one record of a dual-track car."""

from dataclasses import dataclass, field
from typing import Annotated

from slipangle.models.vehicles.driveline import Brakes, Driveline, Steering
from slipangle.models.vehicles.parameters import ChassisParams
from slipangle.ops import Scalar
from slipangle.units import SI


@dataclass(frozen=True, kw_only=True)
class DualTrackParams(ChassisParams):
    """One record of a car; inertias and unsprung masses are per axle, as everywhere in the toolbox.

    Parameters
    ----------
    steering, brakes, driveline
        Their own records, see `slipangle.models.vehicles.driveline`.

    The others are single numbers with unit and meaning on the field. Off by default: aerodynamics, rolling
    resistance, camber, unsprung masses, roll centres, all of the steering's and brakes' lags, engine inertia and drag.
    """

    height: Annotated[float, SI("m", "centre of gravity above ground", 0.0, 5.0)]
    track_f: Annotated[float, SI("m", "front track width", 0.01, 5.0)]
    track_r: Annotated[float, SI("m", "rear track width", 0.01, 5.0)]
    radius: Annotated[float, SI("m", "rolling radius", 1e-3, 2.0)]
    inertia_wheel_f: Annotated[float, SI("kg m2", "spin inertia of the front axle", 1e-11, 1e3)]
    inertia_wheel_r: Annotated[float, SI("kg m2", "spin inertia of the rear axle", 1e-11, 1e3)]
    # tires
    relaxation_x: Annotated[float, SI("m", "longitudinal relaxation length", 1e-4, 5.0)] = 0.25
    relaxation_y: Annotated[float, SI("m", "lateral relaxation length", 1e-4, 5.0)] = 0.5
    rolling_resistance: Annotated[float, SI("-", "rolling resistance over load", 0.0, 0.5)] = 0.0
    camber_f: Annotated[float, SI("rad", "static camber in front, negative: tops inward", -0.3, 0.3)] = 0.0
    camber_r: Annotated[float, SI("rad", "static camber behind, negative: tops inward", -0.3, 0.3)] = 0.0
    camber_roll_f: Annotated[float, SI("-", "inclination of the front wheels over roll", -2.0, 2.0)] = 0.0
    camber_roll_r: Annotated[float, SI("-", "inclination of the rear wheels over roll", -2.0, 2.0)] = 0.0
    # body
    mass_unsprung_f: Annotated[float, SI("kg", "unsprung mass of the front axle", 0.0, 1e4)] = 0.0
    mass_unsprung_r: Annotated[float, SI("kg", "unsprung mass of the rear axle", 0.0, 1e4)] = 0.0
    inertia_x: Annotated[float, SI("kg m2", "roll inertia of the body about its centre", 1e-9, 1e6)] = 500.0
    inertia_y: Annotated[float, SI("kg m2", "pitch inertia of the body", 1e-9, 1e6)] = 2500.0
    roll_centre_f: Annotated[float, SI("m", "front roll centre above ground", -1.0, 2.0)] = 0.0
    roll_centre_r: Annotated[float, SI("m", "rear roll centre above ground", -1.0, 2.0)] = 0.0
    roll_stiffness_f: Annotated[float, SI("N m/rad", "front roll stiffness", 1e-4, 1e7)] = 40e3
    roll_stiffness_r: Annotated[float, SI("N m/rad", "rear roll stiffness", 1e-4, 1e7)] = 40e3
    roll_damping_f: Annotated[float, SI("N m s/rad", "front roll damping", 0.0, 1e6)] = 3e3
    roll_damping_r: Annotated[float, SI("N m s/rad", "rear roll damping", 0.0, 1e6)] = 3e3
    pitch_stiffness: Annotated[float, SI("N m/rad", "pitch stiffness", 1e-4, 1e7)] = 120e3
    pitch_damping: Annotated[float, SI("N m s/rad", "pitch damping", 0.0, 1e6)] = 10e3
    load_lag: Annotated[float, SI("s", "time constant of load through links and unsprung masses", 1e-3, 1.0)] = 0.02
    # air
    drag_area: Annotated[float, SI("m2", "drag coefficient times frontal area", 0.0, 100.0)] = 0.0
    downforce_f: Annotated[float, SI("m2", "front lift coefficient times area, positive is down", -10.0, 50.0)] = 0.0
    downforce_r: Annotated[float, SI("m2", "rear lift coefficient times area, positive is down", -10.0, 50.0)] = 0.0
    air_density: Annotated[float, SI("kg/m3", "air density", 0.0, 5.0)] = 1.2
    steering: Steering = field(default_factory=Steering)
    brakes: Brakes = field(default_factory=Brakes)
    driveline: Driveline = field(default_factory=Driveline)

    @property
    def mass_sprung(self) -> Scalar:
        """Mass of the body. [kg]"""
        return self.mass - self.mass_unsprung_f - self.mass_unsprung_r

    @property
    def height_sprung(self) -> Scalar:
        """Centre of gravity of the body above ground. [m]"""
        unsprung = self.mass_unsprung_f + self.mass_unsprung_r
        return (self.mass * self.height - unsprung * self.radius) / self.mass_sprung

    @property
    def roll_arm(self) -> Scalar:
        """Centre of gravity of the body above the roll axis. [m]"""
        axis = (self.roll_centre_f * self.l_r + self.roll_centre_r * self.l_f) / self.wheelbase
        return self.height_sprung - axis
