"""The closed loop of a job: a controller on the identified model, a path, and the car that is driven.

A package adds a vehicle to drive with ``@PLANTS.register("name")`` above a function, or by an entry point of the group
``slipangle.plants``: its arguments are entries of ``[plant]``, what it returns is a `PlantProtocol` or a `Model`.
Controllers are in `slipangle.workflow.controllers`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np

from slipangle.control.driver import Driver
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ConfigError, ParameterError, nearest, shown
from slipangle.identify.physics.tire_bicycle_fit import require_tires
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles import catalogue
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams, ChassisParams, SingleTrackParams
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.optimal.terms import Values
from slipangle.registry import Registry
from slipangle.simulate.drive import drive as drive_plant
from slipangle.simulate.fmu import PlantFMU
from slipangle.simulate.foreign import PlantProtocol
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.plant import Plant
from slipangle.simulate.process import PlantProcess
from slipangle.simulate.robust import AHEAD, UNMOVED
from slipangle.simulate.run import Run
from slipangle.workflow.controllers import CONTROLLERS as CONTROLLERS
from slipangle.workflow.controllers import (
    ESTIMATORS,
    ControllerSettings,
    EstimatorSettings,
    build_path,
    physics_in,
    require_no_law,
)
from slipangle.workflow.controllers import build_mpc as build_mpc
from slipangle.workflow.controllers import identified_bicycle as identified_bicycle
from slipangle.workflow.entries import Seed, Weight, Within, of_kind, record
from slipangle.workflow.tires import car_on, plant_tires

_PLANTS = {
    "sousa-table-6.1": (catalogue.SOUSA_TABLE_6_1, catalogue.SOUSA_TABLE_6_2),
    "sousa-table-6.10": (catalogue.SOUSA_TABLE_6_10, catalogue.SOUSA_TABLE_6_8),
}
NOISE = {"v_y": 0.02, "r": 0.002, "X": 0.02, "Y": 0.02, "psi": 0.001, "v_x": 0.02}


@dataclass(frozen=True, kw_only=True)
class PlantSettings:
    """The car that the controller drives in simulation: one of `PLANTS`, of the catalogue, or around the bicycle.

    Parameters
    ----------
    kind : str
        A vehicle from outside; see 'slipangle list plants'. The table's other entries are those of the kind.
    catalogue : str
        A car of the catalogue.
    friction : float
        Where the car is made of the identified bicycle: friction coefficient at which its tires saturate, some 0.2 at
        least, the stiffer its axles the more; on tires of files the road's, relative to that of their test.
    tire, tire_f, tire_r : str
        Tire file, ``.tir`` or ``.json``, of all wheels, or one for each axle, relative to the job's folder: then the
        car is a dual track of the identified mass and geometry, or the catalogue's, on these tires.
    force : bool
        Use coefficients of tire files outside their range as they stand.
    conventions : {"book", "mfeval"}
        Where codes of the Magic Formula differ.
    car : table
        Parameters of that dual track by name, SI units, such as height and track_f.
    noise : table
        Standard deviation of what is measured, by channel, in the channel's unit.
    seed : int
        Of the noise.
    entries : dict
        The table's other ones: those that the kind takes, checked.
    """

    kind: str = ""
    catalogue: str = ""
    friction: Annotated[float, Within(0.01, 10)] = 1.0
    tire: str = ""
    tire_f: str = ""
    tire_r: str = ""
    force: bool = False
    conventions: Literal["book", "mfeval"] = "book"
    car: dict[str, float] = field(default_factory=dict)
    noise: dict[str, Weight] = field(default_factory=dict)
    seed: Seed = 0
    entries: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.catalogue and self.catalogue not in _PLANTS:
            near = nearest(self.catalogue[:60], _PLANTS)
            raise ConfigError(f"[plant] catalogue is {shown(self.catalogue)}; {near}: use one of these")

    @classmethod
    def from_table(cls, table: dict[str, Any], where: str) -> Self:
        """Entries of every plant, and those of its kind."""
        wanted = of_kind(cls, PLANTS, table, where, every=False) if table.get("kind") else record(cls, table, where)
        if wanted.tire or wanted.tire_f or wanted.tire_r:
            try:
                require_tires(wanted.tire, wanted.tire_f, wanted.tire_r)
            except ParameterError as error:
                raise ConfigError(f"{where}: {error}") from None
        if wanted.kind and (wanted.catalogue or wanted.tire or wanted.tire_f):
            other = "catalogue name" if wanted.catalogue else "tire"
            raise ConfigError(f"{where} has a kind and a {other}; expected one of them: leave the other out")
        return wanted


_STILL = "its rear wheels straight", "no yaw moment by its drive", "on a level road"
_UNMOVED = dict(zip(UNMOVED, _STILL, strict=True))
PLANTS: Registry[Callable[..., Model | PlantProtocol]] = Registry("plant", "slipangle.plants")
"""What ``kind`` in a job's ``[plant]`` may be: functions that return a vehicle."""


def drive(
    wanted: ControllerSettings,
    plant_settings: PlantSettings,
    model: Model,
    progress: Callable[[float], None],
    estimator: EstimatorSettings | None = None,
) -> tuple[Run, str, Any]:
    """Closed loop of a controller on the identified model with the plant at a millisecond."""
    plant, speed, description = build_plant(plant_settings, model)
    controller = CONTROLLERS[wanted.kind](model, wanted, **wanted.entries)
    try:
        if isinstance(controller, Driver):
            run = _driven(plant, whole_driver(controller, speed, estimator), wanted, progress)
        else:
            knows = ESTIMATORS[estimator.kind](controller.model, **estimator.entries) if estimator else None
            how: Any = {"driver": speed, "estimator": knows, "width": wanted.width, "progress": progress}
            run = closed_loop(plant, controller, build_path(wanted), held=unmoved(plant, controller), **how)
    finally:
        getattr(getattr(plant.model, "system", None), "close", int)()
    return run, description + _unmoved_said(plant, model), controller


def unmoved(plant: Plant, controller: Any) -> Values:
    """Zero for what a plant has not of a controller's steered rear wheels, torque vectoring and road, or v_x_dot.

    Of that the controller looks ahead along the path; only what has been is taken for driven at constant speed.
    """
    known = (*_UNMOVED, *AHEAD)
    return Values(dict.fromkeys((n for n in controller.exogenous if n in known and n not in plant.channels), 0.0))


def _unmoved_said(plant: Plant, model: Model) -> str:
    """The same in words, for the end of a sentence."""
    words = [said for name, said in _UNMOVED.items() if name in model.inputs and name not in plant.channels]
    return f", and {', '.join(words)}" if words else ""


def whole_driver(driver: Driver, speed: SpeedDriver | None, estimator: EstimatorSettings | None) -> Driver:
    """A job's `Driver` with the plant's speed driver and the job's estimator, where there is one."""
    knows = ESTIMATORS[estimator.kind](driver.estimator.model, **estimator.entries) if estimator is not None else None
    return driver.with_parts(speed=speed, estimator=knows)


def _driven(plant: Plant, whole: Driver, wanted: ControllerSettings, progress: Callable[[float], None]) -> Run:
    """A drive of a `Driver`, which sees nothing but measurements."""
    length = whole.path.length
    watch = lambda t, commands: progress(min(max(commands.s / length, 0.0), 1.0))  # noqa: E731
    return drive_plant(plant, whole, width=wanted.width, watch=watch)


@PLANTS.register("process")
def plant_process(*, address: str) -> PlantProcess:
    """A vehicle in another process on this machine; see `PlantProcess`.

    Parameters
    ----------
    address : str
        Where it listens, such as "127.0.0.1:5005".
    """
    return PlantProcess(address)


@PLANTS.register("fmu")
def plant_fmu(
    *,
    file: Path,
    inputs: dict[str, str] | None = None,
    outputs: dict[str, str] | None = None,
    start: dict[str, str] | None = None,
    parameters: dict[str, float] | None = None,
    dt: Annotated[float, Within(1e-5, 1.0, "s")] | None = None,
) -> PlantFMU:
    """A vehicle in an FMU for co-simulation; see `PlantFMU`.

    Parameters
    ----------
    file : Path
        The FMU, relative to the job.
    inputs : dict of str to str
        Variable of each command, such as { delta = "SteeringAngle" }; by default every real input by its own name.
    outputs : dict of str to str
        Variable of each measurement; by default every real output by its own name.
    start : dict of str to str
        Variables that hold X, Y, psi and v_x before initialisation, such as { v_x = "v_0" }.
    parameters : dict of str to float
        Values of other variables, by their names in the FMU and in its units.
    dt : float
        Time of one step [s]; by default the step size that the FMU recommends.
    """
    return PlantFMU(file, inputs=inputs, outputs=outputs, start=start, parameters=parameters, dt=dt)


def build_plant(wanted: PlantSettings, model: Model) -> tuple[Plant, SpeedDriver | None, str]:
    """The vehicle that is named, or a car from the catalogue or around the identified bicycle.

    On tires of files, or on those that were identified, it is a dual track, else a single track.
    """
    if wanted.kind:
        return _foreign(wanted)
    noise = Values(**{**NOISE, **wanted.noise})
    delay, lag = (Values() if wanted.catalogue else late(model, name) for name in ("delay_delta", "steering_lag"))
    if own := plant_tires(wanted, model):
        dual, pedals, said = car_on(wanted, plant_chassis(wanted, model), own)
        return Plant(dual, noise=noise, seed=wanted.seed, delay=delay, lag=lag), pedals, said
    require_effect(wanted)
    if wanted.catalogue:
        params, tire = _PLANTS[wanted.catalogue]
        tires = (tire, tire)
        text = f"the catalogue car {wanted.catalogue} with wheel spin and Magic Formula tires"
    elif identified := identified_bicycle(model):
        params, tires = around(identified, wanted.friction)
        text = (
            "a stand-in for the car: the identified mass, geometry and cornering stiffness on Magic Formula tires that "
            f"saturate at a friction coefficient of {wanted.friction:g}, with wheel spin, steered as late as identified"
        )
        if any(getattr(identified, name, 0.0) for name in ("downforce_f", "downforce_r")):
            text += ", but without its downforce"
        if getattr(identified, "locked_half_track", 0.0):
            text += ", but with wheels that turn by themselves where its rear ones turn as one"
    else:
        raise _no_car(wanted)
    car = SingleTrack(params=params, dt=0.001, tire_f=tires[0], tire_r=tires[1])
    reach = 0.8 * params.mass * GRAVITY * params.radius
    driver = SpeedDriver.for_car(mass=params.mass, radius=params.radius, limits=(-reach, 0.5 * reach))
    return Plant(car, noise=noise, seed=wanted.seed, delay=delay, lag=lag), driver, text


def require_effect(wanted: PlantSettings) -> None:
    """Raise a ConfigError if a plant that is not on tires of files is given what it does not heed."""
    told = f"of the catalogue, {shown(wanted.catalogue)}" if wanted.catalogue else "made of the identified bicycle"
    whose = f"from outside, {shown(wanted.kind)}" if wanted.kind else told
    foreign = bool(wanted.kind or wanted.catalogue)
    for name, given in {"friction": foreign and wanted.friction != 1.0, "car": bool(wanted.car)}.items():
        if given:
            raise ConfigError(
                f"[plant] has {name}, which changes nothing of a car {whose}; expected it beside tires of files: leave "
                f"it out, or {'leave kind out' if wanted.kind else 'add a tire'}"
            )


def _foreign(wanted: PlantSettings) -> tuple[Plant, SpeedDriver | None, str]:
    """A vehicle from outside, and who holds its speed: its input v_x, an acceleration a_x, or the vehicle itself."""
    require_effect(wanted)
    plant = Plant(PLANTS[wanted.kind](**wanted.entries), noise=Values(**wanted.noise), seed=wanted.seed)
    others = [n for n in plant.model.inputs if n not in ("delta", "v_x", "a_x")]
    if others or "delta" not in plant.model.inputs:
        raise ConfigError(
            f"the plant '{wanted.kind}' has the inputs {shown(list(plant.model.inputs))}; expected delta [rad] and, "
            "where it does not hold its speed by itself, v_x [m/s] or a_x [m/s2]: turn others into these there"
        )
    driver = SpeedDriver(kp=(2.0,), ki=(1.0,), limits=(-8.0, 4.0), feedforward=1.0, drive=Values(a_x=1.0))
    text = f"a vehicle from outside, “{wanted.kind}”, at {1000 * plant.dt:g} ms a step"
    return plant, driver if "a_x" in plant.model.inputs else None, text


def plant_chassis(wanted: PlantSettings, model: Model) -> ChassisParams:
    """Mass and geometry of the car that tires of files are put on: the catalogue's or the identified one's.

    Raises ConfigError if there is neither.
    """
    if wanted.catalogue:
        return _PLANTS[wanted.catalogue][0]
    known = identified_bicycle(model)
    if known is None:
        raise _no_car(wanted)
    return known


def require_car(wanted: ControllerSettings, plant: PlantSettings) -> None:
    """Where the controller's model holds no car, which is known before it is fitted: what else needs one.

    Raises ConfigError if the plant or the controller would be made of it.
    """
    if not plant.kind and not plant.catalogue:
        raise _no_car(plant)
    require_no_law(wanted)


def _no_car(wanted: PlantSettings) -> ConfigError:
    if wanted.tire or wanted.tire_f or wanted.tire_r:
        return ConfigError(
            "[plant] has tires and no car to put them on, since the controller's model is no bicycle; expected one or "
            "the other: add a catalogue name, or control a bicycle"
        )
    return ConfigError("[plant] has no catalogue name and the controller's model is no bicycle; expected one of both")


def catalogued(name: str) -> tuple[BicycleParams, float]:
    """A car of the catalogue as a bicycle, and its tires' largest friction coefficient across."""
    params, tire = _PLANTS[name]
    angles, small = np.linspace(0.01, 0.5, 200), 1e-4

    def across(angle: np.ndarray | float, load: float) -> Any:
        return tire.forces(0.0, angle, load).F_y

    stiffness = {f"C_{a}": 2 * float(across(small, getattr(params, f"load_{a}"))) / small for a in ("f", "r")}
    grip = max(float(across(a, params.load_f)) for a in angles) / params.load_f
    geometry = {n: getattr(params, n) for n in ("mass", "inertia_z", "wheelbase", "l_f")}
    more = {n: getattr(params, n) for n in ("steering_gain", "steering_offset")}
    return BicycleParams(**geometry, **more, **stiffness), grip


def late(model: Model, name: str) -> Values:
    """Delay or lag of an identified steering; none where the model has no such parameter. [s]"""
    if isinstance(model, Parametrised) and name in model.parameter_names:
        return Values(delta=model.value(name))
    inside = physics_in(model)
    return Values() if inside is None else late(inside, name)


def around(
    p: BicycleParams, friction: float
) -> tuple[SingleTrackParams, tuple[SimpleMagicFormula, SimpleMagicFormula]]:
    """A single track whose tires have the bicycle's cornering stiffness near zero slip.

    Shape factors are typical of passenger-car tires (C = 1.3 across, 1.65 along, E = -0.5); the
    longitudinal stiffness is twice the cornering stiffness at equal load.

    Raises ConfigError if the friction is so low that the tires would saturate at once.
    """
    params = SingleTrackParams(
        **{
            name: getattr(p, name)
            for name in ("mass", "inertia_z", "wheelbase", "l_f", "steering_gain", "steering_offset")
        },
        inertia_wheel_f=2e-3 * p.mass,
        inertia_wheel_r=2e-3 * p.mass,
        radius=0.32,
    )

    steepest = max(p.C_f / params.load_f, p.C_r / params.load_r) / 2
    lowest = 2 * steepest / (1.65 * MagicCurve.metadata()["B"].upper)
    if friction < lowest:
        raise ConfigError(
            f"[plant] friction is {friction:g}, at which tires as stiff as those identified have saturated before they "
            f"slip; expected {math.ceil(1000 * lowest) / 1000:g} or more: raise it, or give tires of files (tire)"
        )

    def tire(axle_stiffness: float, load: float) -> SimpleMagicFormula:
        slope = axle_stiffness / (2 * load)  # friction coefficient per rad
        lateral = MagicCurve(B=slope / (1.3 * friction), C=1.3, D=friction, E=-0.5)
        along = MagicCurve(B=2 * slope / (1.65 * friction), C=1.65, D=friction, E=-0.5)
        return SimpleMagicFormula(longitudinal=along, lateral=lateral, combined="ellipse")

    return params, (tire(p.C_f, params.load_f), tire(p.C_r, params.load_r))
