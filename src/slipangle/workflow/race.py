"""The race of a job: a racer drives laps on a plant that is another model than the one it plans with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from slipangle.control.racing.pedals import Pedals
from slipangle.control.racing.racer import Racer
from slipangle.control.racing.sensing import usual_noise
from slipangle.errors import ConfigError, ParameterError
from slipangle.models.model import Model
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles import catalogue
from slipangle.models.vehicles.driveline import Brakes, Engine, Steering
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.on_tires import dual_track_on, wheel_loads
from slipangle.optimal.lap.car import LapCar, size_of
from slipangle.optimal.lap.driven import LapDelta, lap_delta
from slipangle.optimal.lap.lap import Lap
from slipangle.optimal.terms import Values
from slipangle.paths.path import Path
from slipangle.report.lap import delta_figure
from slipangle.report.laps_driven import (
    corners,
    corners_table,
    lap_times,
    laps_table,
    off_track_table,
    race_map,
)
from slipangle.report.page import Block, Figure, Number, Section, Text, Verdict
from slipangle.report.tables import Tone
from slipangle.simulate.plant import Plant
from slipangle.simulate.race import Race, race
from slipangle.simulate.race_car import on_road, optimum, race_car
from slipangle.simulate.run import End
from slipangle.workflow.drive import PlantSettings, late
from slipangle.workflow.race_settings import RaceSettings
from slipangle.workflow.tires import car_on, plant_tires

_CARS = {"bmw-320i": (catalogue.BMW_320I, "BMW 320i"), "vw-vanagon": (catalogue.VW_VANAGON, "VW Vanagon")}
NEAR, FALLBACKS = 0.07, 0.01  # over the optimum, and plans that are older ones, up to which a drive is good [-]
_MARGIN = 0.4  # m, of a car of usual size, that plans keep from the edges
_FASTEST = 120.0  # m/s, up to which the engine of a stand-in is given
_BRAKES = 1.15  # of the friction, that the brakes of a stand-in are good for


@dataclass(frozen=True, kw_only=True, eq=False)
class Raced:
    """A race and what it is judged by.

    Parameters
    ----------
    race : Race
        What was driven.
    fastest : Lap
        The fastest lap of the racer's car at the plant's true friction, without margins.
    plant : str
        What was driven, in words.
    settings : RaceSettings
        As the job says.
    """

    race: Race
    fastest: Lap
    plant: str
    settings: RaceSettings


def raced(
    wanted: RaceSettings,
    plant_settings: PlantSettings,
    model: Model,
    car: LapCar,
    track: Path,
    points: int | None,
    progress: Callable[[float, str], None],
) -> Raced:
    """Fit the racer's car to the plant, find that car's fastest lap at the plant's friction, and drive.

    ``model`` and ``car`` are the job's; ``points`` are those of laps that are not planned by the racer. Raises
    ConfigError if no plant can be made, ParameterError, SolverError and SimulationError as `Racer` and `race_car`.
    """
    progress(0.0, "fitting the racer's car to the plant")
    racer, plant, said = racer_on(wanted, plant_settings, model, car, track, points)
    progress(0.3, "finding what the plant's road allows")
    fastest = optimum(racer.car, track, wanted.friction, points)
    progress(0.4, f"driving {wanted.laps} laps")
    return Raced(race=race(racer, plant, wanted.laps), fastest=fastest, plant=said, settings=wanted)


def racer_on(
    wanted: RaceSettings,
    plant_settings: PlantSettings,
    model: Model,
    car: LapCar,
    track: Path,
    points: int | None,
    **more: Any,
) -> tuple[Racer, Plant, str]:
    """A racer whose car is fitted to a plant, that plant, and what it is in words; ``more`` are settings of `Racer`.

    Raises as `raced`.
    """
    real, said = plant_of(wanted, plant_settings, model, car)
    size = float(size_of(real.params))
    noise = {**usual_noise(size), **wanted.noise}
    margin = _MARGIN * size if wanted.margin is None else wanted.margin
    believed = race_car(real, track, margin=margin, points=points)
    how: dict[str, Any] = {name: getattr(wanted, name) for name in ("share", "grip_std")}
    delay, lag = (Values() if wanted.plant else late(model, name) for name in ("delay_delta", "steering_lag"))
    how["steering_delay"] = delay.get("delta", 0.0)
    how["steering_lag"] = real.params.steering.lag + lag.get("delta", 0.0)
    racer = Racer(believed, track, Pedals.of(real.params), noise=noise, margin=margin, **how, **more)
    plant = Plant(on_road(real, wanted.friction), noise=Values(**noise), delay=delay, lag=lag, seed=wanted.seed)
    return racer, plant, said


def plant_of(wanted: RaceSettings, settings: PlantSettings, model: Model, car: LapCar) -> tuple[DualTrack, str]:
    """The dual track that is raced, and what it is in words."""
    if wanted.plant:
        tire = catalogue.PASSENGER_TIRE
        params, said = _CARS[wanted.plant]
        return DualTrack(params=params, tire_f=tire, tire_r=tire, dt=0.001), f"the catalogue's {said} as a dual track"
    if settings.kind or settings.catalogue:
        raise ConfigError(
            "[plant] names a vehicle that has no pedals, or is no dual track; expected tires of files, or a plant of "
            'the race: add plant = "bmw-320i" to [race], or leave [plant] out'
        )
    if tires := plant_tires(settings, model):
        steered = car.with_values(steering_gain=1.0, steering_offset=0.0)
        dual, _, said = car_on(settings, steered, tires)
        line = dual.params.driveline
        return replace(dual, params=replace(dual.params, driveline=replace(line, engine=_engine(car, dual)))), said
    try:
        stand_in = _around(car)
    except ParameterError as error:
        raise ConfigError(
            f"no dual track can stand for the car of the fastest lap: {error}; expected a plausible car: see its "
            'stiffness and friction, or name a plant in [race], such as plant = "bmw-320i"'
        ) from None
    return stand_in, (
        "a stand-in for the car: mass, geometry, axle stiffness, friction, power and air of the fastest lap's, on "
        "Magic Formula tires, with body roll, relaxing tires, wheels that spin and lock, and open differentials"
    )


def _around(car: LapCar) -> DualTrack:
    """A dual track around the car of a lap; what that does not know is in proportion to its size."""
    load_f, load_r = wheel_loads(car)
    tire_f, tire_r = _tire(car, car.C_f, car.mu_f, car.E_f, load_f), _tire(car, car.C_r, car.mu_r, car.E_r, load_r)
    params = dual_track_on(car, tire_f, tire_r)
    grip = _BRAKES * max(car.mu_f, car.mu_r) * car.mu_x * car.weight
    air = 0.5 * params.air_density
    params = params.with_values(
        steering_gain=1.0,
        steering_offset=0.0,
        rolling_resistance=car.rolling_resistance,
        drag_area=car.drag / air,
        downforce_f=car.downforce_f / air,
        downforce_r=car.downforce_r / air,
        **({"height": car.transfer_x * car.wheelbase} if car.transfer_x > 0 else {}),
    )
    params = replace(
        params,
        brakes=Brakes(torque=min(car.brake_force, grip) * params.radius, bias=1.0 - car.brake_rear),
        steering=Steering(limit=car.delta_max),
        driveline=replace(params.driveline, front_share=1.0 - car.drive_rear),
    )
    dual = DualTrack(params=params, tire_f=tire_f, tire_r=tire_r, dt=0.001)
    return replace(dual, params=replace(params, driveline=replace(params.driveline, engine=_engine(car, dual))))


def _tire(car: LapCar, C: float, mu: float, E: float, load: float) -> SimpleMagicFormula:
    """A tire of an axle's stiffness [N/rad] and friction at the load on each wheel [N], twice as stiff along."""
    slope = C / (2 * load)
    lateral = MagicCurve(B=slope / (car.shape * mu), C=car.shape, D=mu, E=E)
    along = car.mu_x * mu
    return SimpleMagicFormula(
        longitudinal=MagicCurve(B=2 * slope / (1.65 * along), C=1.65, D=along), lateral=lateral, combined="ellipse"
    )


def _engine(car: LapCar, plant: DualTrack) -> Engine:
    """An engine without gears that gives the car's power at the wheels, up to its largest force and its grip."""
    p = plant.params
    most = min(car.drive_force, max(car.mu_f, car.mu_r) * car.weight)
    v = np.linspace(0.0, _FASTEST, 241)
    force = np.minimum(most, car.power / np.maximum(v, 1e-3))
    speeds = v / p.radius * p.driveline.ratios[0] * p.driveline.final
    torques = force * p.radius / (p.driveline.ratios[0] * p.driveline.final)
    return Engine(speeds=tuple(speeds.tolist()), torques=tuple(torques.tolist()))


# ---- the verdict ---------------------------------------------------------------------------------------------------


def word(found: Raced) -> Tone:
    """Poor where the car left the track or did not finish its laps, good where it was near the optimum throughout."""
    race = found.race
    if race.off_track or not race.finished:
        return "poor"
    share = race.run.fallbacks / max(len(race.run.plans), 1)
    over = np.array(race.times) / found.fastest.time - 1.0
    return "good" if share <= FALLBACKS and over.max() <= NEAR and over.min() >= 0.0 else "fair"


def sentence(found: Raced) -> str:
    """What was driven, in words."""
    race, best = found.race, found.fastest.time
    off, run = race.off_track, race.run
    said = f"{len(race.laps)} of {race.wanted} laps of “{found.fastest.track.name}”"
    if race.laps:
        least, most = (100.0 * (t / best - 1.0) for t in (min(race.times), max(race.times)))
        said += f" in {_span(min(race.times), max(race.times), '.2f')} s, {_span(least, most, '+.1f')} % against the "
        said += f"optimum of {best:.2f} s"
        if least < 0.0:
            said += " (faster than what should be fastest: the plant is better than the car that stands for it)"
    if off:
        worst = max(off, key=lambda one: one.depth)
        times = "once" if len(off) == 1 else f"{len(off)} times"
        said += f"; it left the track {times}, by up to {worst.depth:.2f} m at {worst.s:.0f} m"
    else:
        said += (
            f"; the car stayed on the track, {100 * float(race.room[race.judged].min()):.0f} cm or more from its edges"
        )
    if not race.finished and run.end is not End.TIME:
        said += f"; it ended early: {run.end.value}"
    if run.fallbacks:
        said += f"; {run.fallbacks} of {len(run.plans)} plans were older ones"
    return f"{said}."


def _span(low: float, high: float, form: str) -> str:
    """Both ends of a range, or its only value."""
    ends = (format(low, form), format(high, form))
    return " to ".join(dict.fromkeys(ends))


def metrics(found: Raced) -> dict[str, Any]:
    """The race as JSON has it."""
    race, best = found.race, found.fastest.time
    delta = _best(found)
    room = race.room
    laps = [
        {
            "time": lap.time,
            "over_optimum": lap.time / best - 1.0,
            "room": float(room[race.rows(lap)].min()),
            "grip": float(grip),
            "grip_std": float(std),
        }
        for lap, (grip, std) in zip(race.laps, race.learned, strict=True)
    ]
    return {
        "word": word(found),
        "plant": found.plant,
        "optimum": best,
        "wanted": race.wanted,
        "laps": laps,
        "room": float(room[race.judged].min()),
        "off_track": [asdict(one) for one in race.off_track],
        "corners": [] if delta is None else corners(race, delta),
        "plans": len(race.run.plans),
        "fallbacks": race.run.fallbacks,
        "end": race.run.end.value,
    }


def _best(found: Raced) -> LapDelta | None:
    """The best lap against the optimum."""
    laps = found.race.laps
    return lap_delta(found.fastest, min(laps, key=lambda lap: lap.time)) if laps else None


def section(found: Raced, command: str) -> Section:
    """The race on a page."""
    race, car, wanted = found.race, found.fastest.car, found.settings
    room = float(race.room[race.judged].min())
    times = (
        (
            Number(
                label="best lap",
                value=min(race.times),
                unit="s",
                digits=5,
                reference=found.fastest.time,
                reference_label="optimum",
            ),
        )
        if race.laps
        else ()
    )
    verdict = Verdict(
        title="The race",
        sentence=sentence(found),
        tone=word(found),
        numbers=(*times, Number(label="least room to an edge", value=room, unit="m", digits=2)),
        command=command,
    )
    how = Text(
        text=f"The plant is another model than the one that the laps are planned with: it is {found.plant}, its road "
        f"holds {wanted.friction:g} times the friction that the racer believes in at first. The racer sees its place, "
        "heading, speed, yaw rate and accelerations with noise, and nothing else. It plans with a bicycle of two tires "
        "to an axle whose stiffness and friction were fitted to bends of this plant, its power "
        f"({car.power / 1e3:.0f} kW) and largest force ({car.drive_force:.0f} N) to one careful lap, all at the "
        "believed friction.\n\nThe optimum is that car's fastest lap at the true friction, without margins, with one "
        "power in every gear. It is not the fastest lap of the section before, which is one of the job's own car.\n\n"
        "At the start line the racer plans a new lap while the plant waits; on a real car that takes a second or more."
    )
    blocks: list[Block] = [verdict, how]
    if race.off_track:
        blocks.append(off_track_table(race))
    delta = _best(found)
    driven = None if delta is None else delta.driven
    crosses = " Crosses: off the track, on any lap." if race.off_track else ""
    blocks.append(
        Figure(
            title="The line driven" if driven is None else f"The line driven, lap {driven.number}",
            figure=race_map(race, driven, found.fastest),
            caption=f"By speed. Dashed: the optimum's line. Thin lines: the edges.{crosses}",
        )
    )
    if delta is not None:
        n = delta.driven.number
        blocks += [
            Figure(title="Lap times", figure=lap_times(race.times, found.fastest.time)),
            laps_table(race, found.fastest.time),
            Figure(
                title=f"Lap {n} and the optimum",
                figure=delta_figure(delta),
                caption="Thin or dashed: the optimum. Behind: time since the start line, driven minus optimum.",
            ),
            corners_table(race, delta),
        ]
    return Section(title="The race", blocks=tuple(blocks), short="Race")
