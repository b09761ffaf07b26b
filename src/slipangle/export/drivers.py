"""C of a `Driver`: estimator, path, controller and speed law in one struct, from measurements to commands."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import numpy as np

from slipangle.control.default_drive import DOUBTED, SURE, TRUSTED, UNKNOWN
from slipangle.control.default_drive import MOST as MOST_DOUBT
from slipangle.control.driver import MOST, Driver
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import BRAKED, SpeedDriver
from slipangle.data.channels import Quantity
from slipangle.errors import ParameterError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.measurements import plain_name
from slipangle.estimate.moving_horizon import MHE
from slipangle.export.controllers import limits_of, number, table
from slipangle.export.drives import Drive, DriverRecorder, channels
from slipangle.export.estimators import filter_source, heard
from slipangle.export.joined import has_parts
from slipangle.export.loops import NOTHING, Loop, line_tables, path_source
from slipangle.export.mpc import as_in_c
from slipangle.export.project import Project, template, with_prefix
from slipangle.export.windows import window_solver
from slipangle.models.wrappers.on_ground import POSE
from slipangle.paths.path import Path
from slipangle.paths.preview import strides_between

AHEAD = {"X": 1, "Y": 2, "psi": 3, "curvature": 4, "v_x": 5}  # rows of a look along the path
CODES = {"HEADING": 3, "YAW_RATE": -2, "SPEED_AHEAD": -1, "SPEED_CHANGE": -2}
NO_HEADING = -9  # no reference's code, where headings are taken as they are
TRUST = {"SURE": SURE, "UNKNOWN": UNKNOWN, "DOUBTED_MOST": DOUBTED, "TRUSTED": TRUSTED, "TRUST_MOST": MOST_DOUBT}


def driver_project(driver: Driver, name: str, drive: Drive) -> Project:
    """The files of a driver; name and drive as for `project`.

    Raises ParameterError if a part of it has no C.
    """
    _require_known(driver)
    model, back = driver.controller.model, None
    if isinstance(driver.estimator, MHE):
        back = window_solver(driver.estimator)
    loop = Loop(
        driver=driver,
        planner=driver.controller,
        kind="driver",
        title=f"driver along '{driver.path.name}', a plan every {driver.dt:g} s",
        when="time from plan to plan [s]; car_step may be called more often, and less",
        dt=driver.dt,
        states=model.states,
        outputs=model.outputs,
        ranges=driver._ranges,
        bounds=_bounds(driver),
        source=_source(driver),
        added=_trusting(driver.controller) if driver._trusts else "",
        included='#include "car_window.h"\n' if back else "",
        member="    car_window window;\n" if back else "",
        heard=heard(driver.estimator),
        meanings=meanings(driver),
        counts={},
        window=back.files if back else {},
        sizes=back.sizes if back else NOTHING,
    )
    return loop.project(name, drive)


def _require_known(driver: Driver) -> None:
    known = MHE if isinstance(driver.estimator, MHE) else EKF
    parts = ((driver, Driver, "step"), (driver.estimator, known, "begin"), (driver.controller, MPC, "plan"))
    for part, kind, method in (*parts, *([] if driver.speed is None else [(driver.speed, SpeedDriver, "step")])):
        if getattr(type(part), method, None) is not getattr(kind, method):
            raise ParameterError(
                f"a {type(part).__name__} in the driver has no C; expected a plain {kind.__name__}: write the parts "
                "that have C by their own export"
            )
    if driver._trusts and has_parts(driver.controller):
        raise ParameterError(
            "the driver weighs scenarios, free parameters, Huber costs or an exact Hessian by its trust in the model, "
            "which has no C; expected a problem without: give Driver(controller=...) an MPC of its own, whose weights "
            "stay"
        )


def _trusting(planner: MPC) -> str:
    """C behind the planner that weighs course and quick steering as `less_trusting` does."""
    q, end, _, s = planner.ocp.weights
    errors, _, changes = planner.ocp._counts
    rows = np.vstack([np.tile(q, (planner.ocp.horizon, 1)), end])
    doubted = [n in ("e_course", "e_psi") for n in planner.ocp.tracked]
    reals = {"ERRORS_AS_ONE": rows, "ERRORS_COUNT": errors, "CHANGES_AS_ONE": s, "CHANGES_COUNT": changes}
    tables = [*(table(n, v) for n, v in reals.items()), table("DOUBTED", doubted, "int")]
    return "\n".join(["", *tables, with_prefix(template("trusting.c"), "car_planner")])


def _source(driver: Driver) -> str:
    """What stands after the header in ``car.c``."""
    functions = {"model_step": driver.controller.model.functions[0]}
    if driver._grip_left is not None:
        functions["grip_left"] = driver._grip_left
    parts = [
        filter_source(driver.estimator, **functions),
        *(["#define GRIP"] if driver._grip_left is not None else []),
        *([*(f"#define {n} {number(v)}" for n, v in TRUST.items()), template("surprise.c")] if driver._trusts else []),
        path_source(),
        *_of_model(driver),
        *_of_path(driver),
        *_of_speed(driver),
    ]
    codes = CODES if driver._turns else CODES | {"HEADING": NO_HEADING}
    code = template("driver.c").replace("@MEMORY@", template("driver_memory.c"))
    code = code.replace("@WATCH@", template("blind.c") + template("driver_watch.c"))
    return "\n".join([*parts, *(f"#define {k} ({v})" for k, v in codes.items()), _period(driver), code])


def _period(driver: Driver) -> str:
    """The time from plan to plan as the header has it, exact where numbers are of single precision too."""
    return f"#define PERIOD ((car_seconds){driver.dt!r})"


def _of_model(driver: Driver) -> list[str]:
    """Which channel is what in the filter and the planner."""
    model, known = driver.controller.model, channels(driver)

    def at(names: Sequence[str], within: Sequence[str] = known) -> list[int]:
        return [within.index(n) if n in within else -1 for n in names]

    low, high = zip(*(driver._ranges.get(n, (-1e150, 1e150)) for n in known), strict=True)
    lowest, highest = driver._whole.ranges
    pose = [model.states.index(n) if n in POSE else -1 for n in model.outputs]
    whole = {
        "INPUTS": at(model.inputs),
        "OUTPUTS": at(model.outputs),
        "STATES": at(model.states),
        "PLAIN": at([plain_name(n) for n in model.states]),
        "POSE": at(POSE),
        "MOTION": at(POSE, model.states),
        "POSE_OF_OUTPUT": pose,
        "OUTPUT_OF_POSE": at(POSE, model.outputs),
        "SAME_INPUT": at(model.outputs, model.inputs),
        "BEGUN": [driver.estimator.begun.get(n, -1) for n in model.outputs],
        "PUSHES": [*driver._targets.disturbances, *driver._targets.measured],
    }
    late = [driver.estimator.late.get(n, 0.0) for n in model.outputs]
    real = {"LOWEST": low, "HIGHEST": high, "STATE_LOW": lowest, "STATE_HIGH": highest, "LATE_SECONDS": late}
    lines = [table(n, v, "int") for n, v in whole.items()] + [table(n, v) for n, v in real.items()]
    places = {"STEERING": model.inputs.index(driver.steering), "SPEED": known.index("v_x")}
    places["TURN_RATE"] = at(["r"])[0]
    # m/s, below which a lateral model does not describe the vehicle; m/s and m/s2 by which a measured speed may change
    # at once and over time; m of standard deviation of the position from which the vehicle should stop
    sized = {"SLOWEST": driver._slowest, "JUMP": driver._jump, "MOST": MOST, "LOST": driver._lost}
    sized |= driver._watch.numbers
    lines += [f"#define {n} {number(v)}" for n, v in sized.items()]
    return [*lines, *(f"#define {n} {v}" for n, v in places.items())]


def _of_path(driver: Driver) -> list[str]:
    """The path, what is looked at of it, and the steady side slip on it."""
    path, planner, model = driver.path, driver.controller, driver.controller.model
    speeds, slips = driver._targets.table
    codes = {"v_x": CODES["SPEED_AHEAD"], "v_x_dot": CODES["SPEED_CHANGE"]}
    of = {n: codes[n] if n in codes else model.inputs.index(n) for n in planner.exogenous}
    lines = [*path_tables(path, planner, of), table("SPEEDS", speeds), table("SLIPS", slips)]
    sizes = {"N_SPEEDS": len(speeds), "N_SLIPS": slips.shape[1], "N_STATES_PUSH": len(driver._targets.disturbances)}
    return [*lines, *(f"#define {n} {size}" for n, size in sizes.items())]


def path_tables(path: Path, planner: MPC, exogenous: Mapping[str, int]) -> list[str]:
    """The path, and what of it the planner looks at; ``exogenous`` says what its exogenous inputs are."""
    strides = strides_between(np.asarray(planner.times, dtype=float).tobytes())
    lines = [*line_tables(path), table("COUNTS", [n for n, _ in strides], "long")]
    lines.append(table("STRIDES", [h for _, h in strides]))
    if planner.references:
        codes = AHEAD | {"r": CODES["YAW_RATE"]}
        lines.append(table("REFERENCES", [codes.get(n, -1) for n in planner.references], "int"))
    if planner.exogenous:
        lines += [table("EXOGENOUS", [exogenous[n] for n in planner.exogenous], "int"), table("TIMES", planner.times)]
    return lines


def _of_speed(driver: Driver) -> list[str]:
    law = driver.speed
    if law is None:
        return ["#define N_SHARES 0"]
    shares = [share for share in law._shares if share[0] != driver.steering]
    lines = [table("KP", law.kp), table("KI", law.ki), table("GAIN_SPEEDS", law.speeds)]
    lines += [table("DRIVE", [drive for _, drive, _ in shares]), table("BRAKE", [brake for *_, brake in shares])]
    numbers = {
        "FEEDFORWARD": law.feedforward,
        "BRAKED": BRAKED,
        "BRAKE_MOST": law.limits[0],
        "DRIVE_MOST": law.limits[1],
    }
    lines += [f"#define {n} {number(v)}" for n, v in numbers.items()]
    return [*lines, f"#define N_GAINS {len(law.speeds)}", f"#define N_SHARES {len(shares)}"]


def _bounds(driver: Driver) -> dict[str, tuple[float, float]]:
    """Lowest and highest of each command, where it is bounded."""
    bounds = limits_of(driver.controller)
    if driver.speed is not None:
        low, high = driver.speed.limits
        for n, drive, brake in driver.speed._shares:
            bounds[n] = min(high * drive, low * brake, 0.0), max(high * drive, low * brake, 0.0)
    return bounds


def meanings(driver: Driver) -> dict[str, Quantity]:
    """What names of a driver mean that are no channels, or other than these: a brake of at most one is a pedal."""
    low, high = _bounds(driver).get("brake", (0.0, np.inf))
    pedal = {"brake": Quantity("-", "brake pedal, 0 to 1")} if max(-low, high) <= 1 else {}
    return {**driver.controller.model.quantities, **pedal}


def standard_driver_drive(driver: Driver, steps: int) -> Drive:
    """A drive of the driver's own model from the path's start, its outputs noisy, the pose slow and as late as told.

    Parameters
    ----------
    driver : Driver
        To be recorded; its own drive goes on as if nothing had been.
    steps : int
        Of the drive, two calls a sample time.
    """
    own = copy.copy(driver)
    own.controller = as_in_c(driver.controller)
    recorder, model, rng = DriverRecorder(own), driver.controller.model, np.random.default_rng(0)
    recorder.reset()
    step, output, _ = model.functions
    X, Y, psi = driver.path.start
    x = np.array(model.straight(driver.path.speed(0.0)), dtype=float)
    for n, v in zip(POSE, (X, Y, psi), strict=True):
        x[model.states.index(n)] = v
    past: list[np.ndarray] = []
    late = [round(driver.estimator.late.get(n, 0.0) / driver.dt) for n in model.outputs]
    v_x, wanted = driver.path.speed(0.0), {n: 0.0 for n in driver.controls}
    for k in range(steps):
        t = 0.5 * driver.dt * k
        if k % 2:
            wanted = recorder.step({"v_x": v_x + 0.02 * rng.normal()}, t).values
            continue
        u = np.array([v_x if n == "v_x" else wanted.get(n, 0.0) for n in model.inputs])
        if past:
            x = np.asarray(step(x, u).full()).ravel()
        noise = [driver.estimator.noise(n) for n in model.outputs]
        past.append(np.asarray(output(x, u).full()).ravel() + rng.normal(0.0, noise))
        told = {"v_x": v_x + 0.02 * rng.normal()}
        if k == 0:
            told |= {n: float(x[model.states.index(n)]) for n in POSE}
        for i, n in enumerate(model.outputs):
            if len(past) > late[i] and (n not in POSE or k % 10 == 0):
                told[n] = float(past[-1 - late[i]][i])
        said = recorder.step(told, t)
        wanted, v_x = said.values, driver.path.speed(said.s)
    return recorder.drive
