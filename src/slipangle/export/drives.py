"""Recorded drives: what a controller was asked at every step, and what it decided."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slipangle.control.commands import Commands
from slipangle.control.controller import Ahead, Controller
from slipangle.control.driver import Driver
from slipangle.control.racing.racer import Racer
from slipangle.errors import ParameterError
from slipangle.estimate.measurements import plain_name
from slipangle.export.names import comment
from slipangle.models.wrappers.on_ground import POSE
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan
from slipangle.paths.lane_change import double_lane_change
from slipangle.paths.preview import Preview

DEFAULT_STEPS = 200
SPEED = 20.0  # m/s


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """What a controller was asked, a row a step, and what it decided; ``columns`` names the numbers of a row."""

    columns: tuple[str, ...]
    asked: np.ndarray
    commands: np.ndarray
    controls: tuple[str, ...]

    def text(self) -> str:
        """As a table of comma-separated numbers, which read back as the same doubles."""
        head = ",".join([*self.columns, *(f"command {n}" for n in range(len(self.controls)))])
        rows = np.hstack([self.asked, self.commands])
        return "\n".join([head, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n"


NO_DRIVE = Drive(columns=(), asked=np.empty((0, 0)), commands=np.empty((0, 1)), controls=())


@dataclass
class Recorder:
    """A controller that writes down what it is asked and what it decides; `closed_loop` drives with it.

    Parameters
    ----------
    controller : Controller
        The one that decides.

    Examples
    --------
    ``recorder = Recorder(mpc); closed_loop(plant, recorder, path); mpc.export("folder", drive=recorder.drive)``
    """

    controller: Controller
    asked: list[np.ndarray] = field(default_factory=list)
    commands: list[np.ndarray] = field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.controller, name)

    def plan(
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> Plan:
        """As `Controller.plan`.

        Raises ParameterError if the reference has wanted inputs, limits or weights, which a drive has no columns for.
        """
        controller = self.controller
        wanted = controller.reference(reference) if isinstance(reference, Preview) else reference
        wanted = controller.check_reference(wanted)
        if wanted.inputs is not None:
            raise ParameterError(
                "the reference has wanted inputs; expected none: a recorded drive has no place for them"
            )
        wanted.require_plain("a recorded drive")
        plan = controller.plan(x, wanted, previous, applied=applied)
        parts = [np.asarray(x, dtype=float), wanted.tracked, self._exogenous(wanted)]
        if getattr(getattr(controller, "ocp", None), "corridor", None) is not None:
            parts.append(np.asarray(wanted.corridor, dtype=float))
        given = np.full(len(controller.controls), np.nan) if applied is None else np.asarray(applied, dtype=float)
        self.asked.append(np.concatenate([np.ravel(part) for part in (*parts, given)]))
        self.commands.append(np.array(plan.command))
        return plan

    def _exogenous(self, wanted: Reference) -> np.ndarray:
        rows = exogenous_rows(self.controller)
        w = np.asarray(wanted.exogenous, dtype=float)
        return np.vstack([w, w[-1:]]) if len(w) < rows else w[:rows]

    @property
    def drive(self) -> Drive:
        """What has been recorded so far.

        Raises ParameterError if that is nothing.
        """
        if not self.asked:
            raise ParameterError("nothing has been recorded; expected a drive: call plan, or closed_loop, first")
        controls = tuple(self.controller.controls)
        columns = tuple(f"asked {i}" for i in range(len(self.asked[0])))
        return Drive(columns=columns, asked=np.array(self.asked), commands=np.array(self.commands), controls=controls)


@dataclass
class DriverRecorder:
    """A driver that writes down what it is told and what it wants; `slipangle.simulate.drive.drive` drives with it.

    Parameters
    ----------
    driver : Driver or Racer
        The one that decides.

    Examples
    --------
    ``recorder = DriverRecorder(driver); drive(plant, recorder); driver.export("folder", drive=recorder.drive)``
    """

    driver: Driver | Racer
    told: list[list[float]] = field(default_factory=list)
    commands: list[list[float]] = field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.driver, name)

    def reset(self) -> None:
        """Forget the drive so far."""
        self.driver.reset()
        self.told.clear()
        self.commands.clear()

    def step(self, measurements: Mapping[str, float], t: float) -> Commands:
        """As `Driver.step`."""
        said = self.driver.step(measurements, t)
        self.told.append([float(t), *(float(measurements.get(n, math.nan)) for n in channels(self.driver))])
        self.commands.append([said[n] for n in self.driver.controls])
        return said

    @property
    def drive(self) -> Drive:
        """What has been recorded since the start or `reset`.

        Raises ParameterError if that is nothing.
        """
        if not self.told:
            raise ParameterError("nothing has been recorded; expected a drive: call step, or drive, first")
        columns = ("t", *(comment(n) for n in channels(self.driver)))
        return Drive(
            columns=columns, asked=np.array(self.told), commands=np.array(self.commands), controls=self.driver.controls
        )


def channels(driver: Driver | Racer) -> tuple[str, ...]:
    """What a driver may be told: measured outputs, pose, speed, inputs, and states that some instrument knows."""
    if isinstance(driver, Racer):
        return driver.sensing.filter.model.outputs
    model = driver.controller.model
    states = map(plain_name, model.states)
    return tuple(dict.fromkeys((*POSE, "v_x", *model.outputs, *model.inputs, *states, *model.states)))


def standard_drive(controller: Controller, steps: int = DEFAULT_STEPS) -> Drive:
    """A drive of the controller's own model: a double lane change over and over, or steps of what is tracked.

    Parameters
    ----------
    controller : Controller
        To be recorded.
    steps : int
        Of the drive.
    """
    recorder, model = Recorder(controller), controller.model
    path = double_lane_change(SPEED)
    here = getattr(controller, "start", None)
    start = here({"v_x": SPEED, "X": 0.0, "Y": 0.0, "psi": 0.0}) if here is not None else model.straight(SPEED)
    x, s, previous = np.asarray(start, dtype=float), 0.0, None
    posed = "X" in model.states
    for k in range(steps):
        if posed:
            s = path.project(float(x[model.states.index("X")]), float(x[model.states.index("Y")]), s).s
        else:
            s += SPEED * controller.dt
        if s > path.length - SPEED * controller.times[-1] or not np.isfinite(x).all():  # once more from the start
            x, s = np.asarray(start, dtype=float), 0.0
        preview = path.ahead(s, controller.times)
        previous = recorder.plan(x, _wanted(controller, preview, k), previous)
        given = dict(zip(controller.controls, previous.command.tolist(), strict=True))
        known: dict[str, float] = {"v_x": SPEED, **given}
        u = np.array([known.get(n, 0.0) for n in model.inputs])
        x = np.asarray(model.functions[0](x, u).full()).ravel()
    return recorder.drive


def exogenous_rows(controller: Controller) -> int:
    """Rows of the exogenous inputs: with or without one for the end."""
    leader: Any = getattr(controller, "calm", controller)  # of two, the one whose references are those of both
    return controller.horizon + (getattr(leader, "ocp", None) is not None)


def preview_columns(preview: Preview) -> dict[str, np.ndarray]:
    """What a look along a path knows, by the names of channels."""
    return {n: getattr(preview, n) for n in ("X", "Y", "psi", "v_x", "r", "curvature")}


def _wanted(controller: Controller, preview: Preview, k: int) -> Reference:
    """The reference of a preview; what that does not know is zero or, where it knows nothing, a square wave."""
    known = preview_columns(preview)
    wave = np.full(len(preview.X), 0.1 if k // 25 % 2 else -0.1)
    is_known = any(n in known for n in controller.references)

    def columns(names: Sequence[str], unknown: np.ndarray, rows: int) -> np.ndarray:
        listed = [known.get(n, unknown)[:rows] for n in names]
        return np.column_stack(listed) if listed else np.empty((rows, 0))

    rows = exogenous_rows(controller)
    return Reference(
        tracked=columns(controller.references, 0.0 * wave if is_known else wave, controller.horizon + 1),
        exogenous=columns(controller.exogenous, 0.0 * wave, rows),
        corridor=np.column_stack([preview.right, preview.left]),
    )
