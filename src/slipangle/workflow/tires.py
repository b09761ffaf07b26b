"""The car of a job on tires of files: a dual track around the identified bicycle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slipangle.control.speed.driver import SpeedDriver
from slipangle.control.speed.pedals import pedal_driver
from slipangle.errors import ConfigError, shown
from slipangle.identify.physics.tire_bicycle_fit import tires_of
from slipangle.models.model import Model
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.on_tires import bicycle_on, dual_track_on, peak_friction, wheel_loads
from slipangle.models.vehicles.parameters import BicycleParams, ChassisParams
from slipangle.models.vehicles.road import Road

TIRES = ("tire", "tire_f", "tire_r")  # of [[model]] and [plant]: files relative to the job's
_PlantSettings = Any  # of `slipangle.workflow.drive`, which needs this file


def located(entries: Mapping[str, Any], folder: Path, where: str) -> dict[str, Any]:
    """Entries with tire files where they are, from the job's folder.

    Raises ConfigError if one does not exist.
    """
    found = dict(entries)
    for key in TIRES:
        name = entries.get(key)
        if not isinstance(name, str) or not name:
            continue
        found[key] = str(folder / name)
        if not Path(found[key]).is_file():
            raise ConfigError(
                f"{where}: {key} is {shown(name)}, and there is no such file; expected a .tir or .json file, relative "
                "to the folder of the job"
            )
    return found


def plant_tires(wanted: _PlantSettings, model: Model) -> tuple[Tire, Tire] | None:
    """The tires that ``[plant]`` names, else those of the identified model; None where neither has some."""
    if wanted.tire or wanted.tire_f:
        return tires_of(wanted.tire, wanted.tire_f, wanted.tire_r, force=wanted.force, conventions=wanted.conventions)
    return getattr(getattr(model, "ode", None), "scaled_tires", None)


def car_on(
    wanted: _PlantSettings, chassis: ChassisParams, tires: tuple[Tire, Tire]
) -> tuple[DualTrack, SpeedDriver, str]:
    """The dual track on tires, who drives it, and what it is in words."""
    params, mu = dual_track_on(chassis, *tires, car=wanted.car), wanted.friction
    car = DualTrack(params=params, dt=0.001, tire_f=tires[0], tire_r=tires[1], road=Road(friction=(mu, mu, mu, mu)))
    files = [Path(name).name for name in (wanted.tire, wanted.tire_f, wanted.tire_r) if name]
    whose = f"tires of {' and '.join(files)}" if files else "tires as identified"
    road = "" if mu == 1.0 else f" on a road of {mu:g} times their friction"
    text = (
        f"a dual track of the known mass and geometry on {whose}{road} (rolling radius {params.radius:.3g} m, "
        f"relaxation lengths {params.relaxation_x:.2g} and {params.relaxation_y:.2g} m, rolling resistance "
        f"{params.rolling_resistance:.2g}), with what is not known in proportion to its size"
    )
    return car, pedal_driver(params), text


def equivalent(wanted: _PlantSettings, chassis: ChassisParams, tires: tuple[Tire, Tire]) -> tuple[BicycleParams, float]:
    """The car as a bicycle, and its tires' friction coefficient across."""
    loads = wheel_loads(chassis)
    peaks = [peak_friction(tire, float(load)) for tire, load in zip(tires, loads, strict=True)]
    return bicycle_on(chassis, *tires), wanted.friction * min(peaks)
