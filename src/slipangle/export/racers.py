"""C of a `Racer`: filter, lap, sectors, planner, steering and pedals in one struct, from measurements to commands."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.expression import emit, scalar_code
from slipangle.control.racing.learning import GAIN, LEAST, MOST, SUREST
from slipangle.control.racing.pedals import NONE
from slipangle.control.racing.planner import SPEED_IN, STATES
from slipangle.control.racing.racer import BOLD, CREEPING, NO_FORCE, SHORT, SPIN, STOP, Racer
from slipangle.control.racing.sectors import ENOUGH, KEPT, SLOWER, STEP
from slipangle.control.racing.sectors import LEAST as LEAST_TRIAL
from slipangle.control.racing.sensing import POSE, RANGES, WANTED, WHOLE, Sensing
from slipangle.control.watch import Blind
from slipangle.data.channels import Quantity
from slipangle.errors import ParameterError
from slipangle.export.controllers import number, table
from slipangle.export.drives import Drive, DriverRecorder
from slipangle.export.estimators import filter_source, heard
from slipangle.export.loops import NOTHING, Loop, line_tables, path_source
from slipangle.export.project import Project, template, with_prefix

EXOGENOUS = ("curvature", "stage", "mu_f", "mu_r", "d_v_x", "d_r")  # in the order of ``c/racer_plans.c``

MEANINGS = {
    "brake": Quantity("-", "brake pedal"),
    "d_v_x": Quantity("m/s2", "acceleration along the vehicle that its equations leave out"),
    "d_r": Quantity("rad/s2", "yaw acceleration that its equations leave out"),
}


def racer_project(racer: Racer, name: str, drive: Drive) -> Project:
    """The files of a racer; name and drive as for `project`.

    Raises ParameterError if it would plan a new lap, or does something in a way of its own.
    """
    _require_known(racer)
    car, model = racer.car, racer.sensing.filter.model
    made = _begun(racer)
    force = {n: (0.0, 1.0) for n in ("throttle", "brake")}
    every = racer._every * racer.sample
    loop = Loop(
        driver=racer,
        planner=racer._planner.mpc,
        kind="racer",
        title=f"racer on '{racer.track.name}', a plan every {every:g} s",
        when=f"time from call to call of car_step [s]; one of every {racer._every} plans",
        dt=racer.sample,
        states=model.states,
        outputs=model.outputs,
        ranges=RANGES,
        bounds={"delta": (-float(car.delta_max), float(car.delta_max)), **force},
        source=_source(made),
        added=f"\n{with_prefix(template('planned_anew.c'), 'car_planner')}",
        more=f"\n{template('racer_learned.h')}",
        heard=heard(racer.sensing.filter),
        meanings=MEANINGS,
        counts={"SECTORS": len(made.sectors.ends)},
        window={},
        sizes=NOTHING,
    )
    return loop.project(name, drive)


def _begun(racer: Racer) -> Racer:
    """A copy before its first sample, whose planner follows the first lap; the racer's own drive goes on."""
    made = copy.copy(racer)
    made._planner, made.sensing = copy.copy(racer._planner), copy.copy(racer.sensing)
    made.reset()
    return made


def _require_known(racer: Racer) -> None:
    if racer.between is True:
        raise ParameterError(
            "the racer plans a new lap where grip differs, which has no C; expected one that keeps its lap: say "
            'Racer(..., between="sectors")'
        )
    parts = ((racer, Racer, "step"), (racer, Racer, "learn"), (racer.sensing, Sensing, "take"))
    for part, kind, method in parts:
        if getattr(type(part), method) is not getattr(kind, method):
            raise ParameterError(f"a {type(part).__name__} has no C; expected a plain {kind.__name__}: export that")


def _source(racer: Racer) -> str:
    """What stands after the header in ``car.c``, of a racer before its first sample."""
    step, pace = racer._planner.moving
    delay = len(racer._actuators.coming)
    moving = {"along_step": step, "pace_at": pace} if delay else {}
    parts = [
        filter_source(racer.sensing.filter),
        "#include <stdlib.h>",
        path_source(ahead=False),
        *(emit(_plain(f), name) for name, f in moving.items()),
        *_of_filter(racer),
        *_of_car(racer),
        *_of_lap(racer),
        *_of_planner(racer),
        *_of_learning(racer),
        f"#define DELAY {delay}",
        f"#define WAITING {max(delay, 1)}",
    ]
    inside = {"BLIND": "blind", "MEMORY": "driver_memory", "LEARNS": "racer_learns", "PLANS": "racer_plans"}
    code = template("racer.c")
    for mark, file in inside.items():
        code = code.replace(f"@{mark}@", template(f"{file}.c"))
    return "\n".join([*parts, code])


def _plain(function: ca.Function) -> ca.Function:
    plain: Any = scalar_code(function)
    return plain


def _defined(numbers: Mapping[str, float]) -> list[str]:
    return [f"#define {n} {v if isinstance(v, int) else number(v)}" for n, v in numbers.items()]


def _of_filter(racer: Racer) -> list[str]:
    """Which channel is what, and between which values."""
    model = racer.sensing.filter.model
    low, high = zip(*(RANGES[n] for n in model.outputs), strict=True)
    lowest, highest = WHOLE.ranges
    whole = {
        "OF_POSE": [n in POSE for n in model.outputs],
        "BEGINS": [n in WANTED for n in model.outputs],
        "READ_BY": [model.outputs.index(n) if n in model.outputs else -1 for n in model.states],
    }
    real = {"LOWEST": low, "HIGHEST": high, "STATE_LOW": lowest, "STATE_HIGH": highest}
    lines = [table(n, v, "int") for n, v in whole.items()] + [table(n, v) for n, v in real.items()]
    grip = float(racer.sensing.filter.model.value("grip"))
    numbers = {"GRIP": grip, "SETTLING": racer.sample / racer._settling, "EVERY": racer._every}
    numbers |= {"AT_X": model.outputs.index("X"), "AT_Y": model.outputs.index("Y")}
    numbers |= {**Blind.numbers, "UNCERTAIN": racer.sensing._uncertain}
    return [*lines, *_defined(numbers)]


def _of_car(racer: Racer) -> list[str]:
    """Its limits, pedals and gears, and what it does of what it is asked."""
    car, pedals, sample = racer.car, racer.pedals, racer.sample
    box = pedals.gearbox
    forces = {"FULL_THROTTLE": pedals.full, "CLOSED": pedals.closed, "BRAKES": pedals.brake}
    lines = [table("PEDAL_SPEEDS", pedals.speeds), *(table(n, v) for n, v in forces.items())]
    lines += [table("UP", box.up if box else ()), table("DOWN", box.down if box else ())]
    numbers = {
        "N_SPEEDS": len(pedals.speeds),
        "GEARS": len(np.atleast_2d(pedals.full)),
        "SHIFTS": len(box.up) if box else 0,
        "NO_PEDAL": NONE,
        "DRIVE_SHARE": min(sample / max(pedals.lag, sample), 1.0),
        "BRAKE_SHARE": min(sample / max(pedals.brake_lag, sample), 1.0),
        "BEHIND": racer._actuators._behind,
        "DELTA_MAX": car.delta_max,
        "BRAKE_FORCE": car.brake_force,
        "FORCE_RATE": car.force_rate * car.weight,
        "STOP_FORCE": -STOP * car.weight,
        "NO_FORCE": NO_FORCE * car.weight,
        "SPIN": SPIN,
        "SPINS": racer._spins,
        "SHORT": SHORT,
        "MASS": car.mass,
        "WEIGHT": car.weight,
        "HALF_WIDTH": 0.5 * car.width,
        "MU_F": car.mu_f,
        "MU_R": car.mu_r,
        "DRAG": car.drag,
        "DOWN_F": car.downforce_f,
        "DOWN_R": car.downforce_r,
        "ROLLING": car.rolling_resistance,
    }
    return [*lines, *_defined(numbers)]


def _of_lap(racer: Racer) -> list[str]:
    """The track and, between the start line and itself a lap later, the lap on it."""
    own, length = racer._planner, racer.track.length
    part = slice(np.searchsorted(own._s, 0.0, side="right") - 1, np.searchsorted(own._s, length, side="right") + 1)
    places, states, rate = own._s[part], own._states[part], own._rate[part]
    columns = {"LAP": places, "LAP_STATES": states, "LAP_RATE": rate}
    lines = [*line_tables(racer.path), *(table(n, v) for n, v in columns.items())]
    return [*lines, *_defined({"N_LAP": len(places), "NXP": states.shape[1]})]


def _of_planner(racer: Racer) -> list[str]:
    """What the planner is told, and its limits."""
    own = racer._planner
    ocp = own.mpc.ocp
    at: Mapping[str, Sequence[int]] = {
        "TRACKED": [STATES.index(n) for n in ocp.references],
        "EXOGENOUS": [EXOGENOUS.index(n) for n in ocp.exogenous],
        "SPEED_IN": SPEED_IN,
    }
    lines = [table(n, v, "int") for n, v in at.items()]
    lines += [table("LIMITS", ocp.state_limits), table("RATES", ocp.input_bounds), table("FADING", own._fading)]
    numbers = {
        "LIMITED": len(ocp.limited),
        "LIMIT_N": ocp.limited.index("n"),
        "LIMIT_F": ocp.limited.index("F_asked"),
        "STAGE_SECONDS": own.dt,
        "SLOWEST": own.slowest,
        "CREEPING": CREEPING * own.slowest,
        "SLOWEST_SQUARED": own.slowest**2,
        "REACHED": own._ahead,
        "ROOM": own._room,
    }
    return [*lines, *_defined(numbers)]


def _of_learning(racer: Racer) -> list[str]:
    """How grip, forces and sectors are learned."""
    learned, corners, places = racer.learned, racer.sectors, racer.sectors._places
    blends = [places[-1] - corners.length, *places, places[0] + corners.length]
    numbers = {
        "BETWEEN": int(racer.between is not False),
        "SECTORS": len(corners.ends),
        "PARTS": len(learned._shares),
        "GRIP_STD": learned.grip_std,
        "KNOWN": learned._known,
        "SUREST": SUREST,
        "REMEMBERED": 1.0 - racer.sample / learned._memory,
        "FULL_FOR": learned._settled,
        "LEAST_SHARE": LEAST,
        "MOST_SHARE": MOST,
        "OF_NEW": GAIN,
        "BOLD": BOLD,
        "LAP_MU_F": racer.lap.car.mu_f,
        "TRIAL": STEP,
        "LEAST_TRIAL": LEAST_TRIAL,
        "SLOWER": SLOWER,
        "BETTER": corners._better,
        "NARROWEST": corners._narrower,
        "KEPT_ROOM": KEPT * corners.margin,
        "ENOUGH_ROOM": ENOUGH * corners.margin,
    }
    return [table("ENDS", corners.ends), table("BLENDS", blends), *_defined(numbers)]


def standard_racer_drive(racer: Racer, steps: int) -> Drive:
    """A drive of the racer's own model of the car from the start of its lap on, as noisy as it takes its sensors for.

    Parameters
    ----------
    racer : Racer
        To be recorded; its own drive goes on as if nothing had been.
    steps : int
        Of the drive, a sample time each.
    """
    own = _begun(racer)
    recorder, model, rng, lap = DriverRecorder(own), own.sensing.filter.model, np.random.default_rng(0), own.lap
    step, output, _ = model.functions
    x = np.array([float(getattr(lap, n)[0]) if hasattr(lap, n) else 0.0 for n in model.states])
    noise = [own.sensing.filter.noise(n) for n in model.outputs]
    for k in range(steps):
        acting = own._actuators
        u = np.array([acting.steered, acting.force])
        if k:
            x = np.asarray(step(x, u).full()).ravel()
        seen = np.asarray(output(x, u).full()).ravel() + rng.normal(0.0, noise)
        recorder.step(dict(zip(model.outputs, seen.tolist(), strict=True)), racer.sample * k)
    return recorder.drive
