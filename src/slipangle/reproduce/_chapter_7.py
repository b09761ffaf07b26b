"""What tables 7.1, 7.4, 7.5 and 7.6 share: the car, its logs, the models, the controllers and the drives."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.presets import SOUSA_TABLE_7_3, SOUSA_TABLE_7_3_TIRES
from slipangle.control.speed.pedals import pedal_driver
from slipangle.data.dataset import Dataset
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.presets import SOUSA_SEC_7_2
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.model import Model
from slipangle.models.ode import OdeModel
from slipangle.models.tires.simple import LinearTire, Tire, TireForces
from slipangle.models.vehicles.axle import axle_velocities, ground_velocity
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7, SOUSA_TABLE_7_2
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.parameters import GRAVITY, ChassisParams
from slipangle.models.wrappers.multi_arx import MultiARXModel, Shape
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.ops import Scalar, Vector, atan, cos, maximum, stack
from slipangle.optimal.terms import Weights
from slipangle.paths.path import Path
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.manoeuvres import Manoeuvre, record, sine_steer, three_segments
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import Run

SPEEDS = (10.0, 15.0, 20.0)  # m/s
MORE_SPEEDS = (10.0, 12.0, 14.0, 16.0, 18.0, 20.0)
AMPLITUDES = {10.0: 0.15, 15.0: 0.08, 20.0: 0.05}  # rad
STEP, LOG = 0.05, 0.01  # s
HORIZON, LIMIT = SOUSA_TABLE_7_3["horizon"], SOUSA_TABLE_7_3["limits"]["delta"][1]
CAR = DualTrack(params=SOUSA_CAR_7, tire_f=PASSENGER_TIRE, tire_r=PASSENGER_TIRE, dt=0.001)
PLANT = Plant(CAR)
DRIVER = pedal_driver(SOUSA_CAR_7)
SEGMENTS = {"segment 1": (0.0, 360.0), "segment 2": (360.0, 660.0), "segment 3": (660.0, np.inf)}  # m along X


def the_path() -> Path:
    """The path of sec. 7.2.2; jumps of 0.75, 1.5, 1.5 and 0.75 m, each drawn over 8 m."""
    return three_segments(amplitudes=(5.0, 1.5, 0.75))


# ---- logs ------------------------------------------------------------------------------------------------------------


@cache
def sine_log(v_x: float, *, periods: float = 10.0) -> Dataset:
    """Steering and lateral position of sec. 7.1.3 at the controller's step: a sine of pi/2 rad/s, logged at 100 Hz."""
    log = record(PLANT, sine_steer(v_x, AMPLITUDES[v_x], 0.25, periods=periods, dt=LOG), DRIVER, channels=("Y",))
    return log.resample(STEP).select(inputs=("delta",), outputs=("Y",))


@cache
def rich_log(v_x: float, *, a_y: float = 3.0, seed: int = 1, duration: float = 40.0) -> Dataset:
    """Steering, lateral velocity and yaw rate at the controller's step: a multisine of 0.1 to 2.9 Hz.

    Its peak would give a lateral acceleration of ``a_y`` [m/s2] in a steady turn of a car that understeers a little.
    """
    n = round(duration / LOG) + 1
    t, rng = LOG * np.arange(n), np.random.default_rng(seed)
    delta = np.zeros(n)
    for f in np.arange(0.1, 3.0, 0.1):
        delta += np.sin(2 * np.pi * f * t + rng.uniform(0, 2 * np.pi)) / (1 + f)
    peak = a_y * SOUSA_CAR_7.wheelbase * (1 + 3e-4 * v_x**2) / v_x**2
    delta *= peak / np.abs(delta).max() * np.minimum(t / 2, 1)
    log = record(
        PLANT,
        Manoeuvre(delta=delta, v_x=np.full(n, v_x), dt=LOG, name="multisine"),
        DRIVER,
        channels=("v_x", "v_y", "r"),
    )
    return log.resample(STEP)


# ---- models ----------------------------------------------------------------------------------------------------------


def planar_arx(v_x: float, orders: ARX = SOUSA_SEC_7_2) -> ARXModel:
    """ARX of lateral velocity and yaw rate at one speed."""
    return orders.fit(rich_log(v_x).select(inputs=("delta",), outputs=("v_y", "r")))


@cache
def planar_model(speeds: tuple[float, ...] = SPEEDS, shape: Shape = "triangular") -> OnGround:
    """ARX models of lateral velocity and yaw rate, blended by speed, on the ground."""
    return OnGround(MultiARXModel(models=tuple(planar_arx(v) for v in speeds), speeds=speeds, shape=shape))


@dataclass(frozen=True, kw_only=True)
class Lateral(OdeModel):
    """The single track at a given speed.

    States v_y [m/s], r [rad/s], X, Y [m], psi [rad]; inputs delta [rad] and v_x [m/s]. The tires carry the static load;
    below 3 m/s slip angles are those at 3 m/s.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eq. 7-1.
    """

    states = ("v_y", "r", "X", "Y", "psi")
    inputs = ("delta", "v_x")
    params: ChassisParams
    tire_f: Tire
    tire_r: Tire

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Time derivative of the state."""
        p, v = self.params, maximum(u[1], 3.0)
        delta = p.road_wheel(u[0])
        v_yf, v_yr = axle_velocities(x[0], x[1], p)
        alpha_f, alpha_r = delta - atan(v_yf / v), -atan(v_yr / v)
        load = 0.5 * p.mass * GRAVITY / p.wheelbase
        F_f = 2 * self.tire_f.forces(0.0, alpha_f, load * p.l_r).F_y * cos(delta)
        F_r = 2 * self.tire_r.forces(0.0, alpha_r, load * p.l_f).F_y
        return stack(
            [
                (F_f + F_r) / p.mass - u[1] * x[1],
                (p.l_f * F_f - p.l_r * F_r) / p.inertia_z,
                *ground_velocity(u[1], x[0], x[4]),
                x[1],
            ]
        )


@dataclass(frozen=True, kw_only=True)
class Softer(Tire):
    """A tire that feels only a share of the slip angle."""

    tire: Tire
    share: float

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Forces of the tire at the smaller angle."""
        return self.tire.forces(slip_ratio, self.share * slip_angle, load, camber=camber, friction=friction)


def linear_model(share: float = SOUSA_TABLE_7_3_TIRES["LMPC"]) -> Lateral:
    """Linear tires with a share of the plant's stiffness at static load.

    The relaxation that eq. 7-1 lacks delays the plant's forces, so somewhat softer tires predict better: of 1, 0.94,
    0.8 and 0.7 this share serves LMPC best on the path itself (0.7 helps in segment 3 and harms in 1 and 2).
    """
    p, tire = SOUSA_CAR_7, CAR.tires[0]
    load, small = 0.5 * p.mass * GRAVITY / p.wheelbase, 1e-4
    slopes = [float(tire.forces(0.0, small, load * arm).F_y) / small for arm in (p.l_r, p.l_f)]
    front, rear = (LinearTire(C_alpha=share * slope) for slope in slopes)
    return Lateral(params=SOUSA_TABLE_7_2, tire_f=front, tire_r=rear, dt=STEP, substeps=2)


def magic_model(share: float = SOUSA_TABLE_7_3_TIRES["NMPC"]) -> Lateral:
    """The plant's own Magic Formula, softened as `linear_model`: of 1, 0.9 and 0.8 this is NMPC's best share."""
    tire = Softer(tire=CAR.tires[0], share=share)
    return Lateral(params=SOUSA_TABLE_7_2, tire_f=tire, tire_r=tire, dt=STEP, substeps=2)


# ---- controllers and drives ------------------------------------------------------------------------------------------


def general(model: Model, solver: Any, horizon: int = HORIZON) -> MPC:
    """LMPC or NMPC with table 7.3."""
    settings: dict[str, Any] = SOUSA_TABLE_7_3 | {"horizon": horizon}
    return MPC(model, solver=solver, **settings)


def blended(model: MultiARXModel | OnGround, settings: dict[str, Any] = SOUSA_TABLE_7_3, **more: Any) -> MultiARXMPC:
    """MARX-MPC with table 7.3, the distance from the path or the lateral position being tracked."""
    weight = settings["Q"]["e_y"]
    tracked = Weights(e_y=weight) if "psi" in model.states else Weights(Y=weight)
    every: dict[str, Any] = settings | {"Q": tracked} | more
    return MultiARXMPC(model, **every)


def drive(controller: Any, path: Path) -> Run:
    """One drive with the speed driver."""
    if hasattr(controller, "prepare"):
        controller.prepare()
    return closed_loop(PLANT, controller, path, driver=DRIVER)


def along(run: Run, name: str) -> np.ndarray:
    """Samples that lie in a segment."""
    low, high = SEGMENTS[name]
    return (run["X"] >= low) & (run["X"] < high)


def segment_rmse(run: Run, name: str) -> float:
    """Root mean square of the lateral error in a segment; infinite if the drive did not get through it. [m]"""
    inside = along(run, name)
    if not inside.any() or (name != "segment 3" and run["X"].max() < SEGMENTS[name][1]) or run.end.name != "FINISHED":
        return np.inf
    return float(np.sqrt(np.mean(run.e_y[inside] ** 2)))


def segment_seconds(run: Run, name: str, seconds: Sequence[float] | np.ndarray) -> np.ndarray:
    """Solver times of the plans made in a segment. [s]"""
    low, high = SEGMENTS[name]
    X = np.interp(run.t_plan, run.t, run["X"])
    return np.asarray(seconds)[(X >= low) & (X < high)]
