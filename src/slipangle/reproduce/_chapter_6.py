"""What tables 6.5, 6.6, 6.11 and 6.12 share: the two cars, their controllers, the plant, the drive."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from slipangle.control.mpc import MPC
from slipangle.data.dataset import Channel
from slipangle.models.model import Model
from slipangle.models.tires.simple import Tire, TireForces
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_10
from slipangle.models.vehicles.parameters import SingleTrackParams
from slipangle.models.vehicles.single_track import SingleTrack
from slipangle.ops import Scalar, clip, is_symbolic
from slipangle.optimal.ipopt import Ipopt
from slipangle.optimal.realtime import RealTime
from slipangle.optimal.realtime.engine import CompiledEngine
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.path import Path
from slipangle.report.drives import Signal, signals, solver_time
from slipangle.report.maps import path_map
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction, protocol
from slipangle.reproduce._cvodes import ByCvodes

HORIZONS = (5, 10, 15)
STEP, SAMPLE = 0.1, 0.02  # s, of the controller and of the recorded drive


@dataclass(frozen=True, kw_only=True)
class Car:
    """One of the two cars: parameters, driven axle, limits and weights.

    Weights are those of eqs. 6-3 and 6-4. Their common factor 10^3 is taken to stand before Q and S alike, so
    it is left out; steering counts as the angle of the steering wheel in rad, torque in kN m.
    """

    params: SingleTrackParams
    driven: str
    steering_ratio: float
    torque: float
    Q: tuple[float, float, float]
    S: tuple[float, float]
    start_speed: float
    speed: float

    def model(self, tire: Tire) -> SingleTrack:
        """Single track on one kind of tire all round, one step of Radau IIA per sample."""
        return SingleTrack(params=self.params, dt=STEP, tire_f=tire, tire_r=tire, method="radau")

    def controller(self, model: Model, horizon: int, solver: Any) -> MPC:
        """The thesis' problem on a model of the car."""
        q, s, ratio = self.Q, self.S, self.steering_ratio
        return MPC(
            model,
            horizon=horizon,
            Q=Weights(v_x=q[0], X=q[1], Y=q[2]),
            S=Weights(**{"delta": s[0] * ratio**2, self.driven: s[1] * 1e-6}),
            limits=Limits(**{"delta": 0.9 / ratio, self.driven: self.torque}),
            solver=solver,
        )


FRONT_DRIVE = Car(
    params=SOUSA_TABLE_6_1,
    driven="T_f",
    steering_ratio=30.0,
    torque=2500.0,
    Q=(1500.0, 200.0, 2500.0),
    S=(100.0, 1.0),
    start_speed=19.0,
    speed=20.0,
)
REAR_DRIVE = Car(
    params=SOUSA_TABLE_6_10,
    driven="T_r",
    steering_ratio=10.0,
    torque=1200.0,
    Q=(2500.0, 200.0, 1500.0),
    S=(1000.0, 1.0),
    start_speed=24.0,
    speed=25.0,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class LookUpTire(Tire):
    """Friction coefficients interpolated in tables of slip; held beyond their ends.

    Parameters
    ----------
    slip_ratio, slip_angle : array, shape (n,)
        Places of the table [-] and [rad].
    mu_x, mu_y : array, shape (n,)
        Friction there.
    """

    slip_ratio: np.ndarray
    mu_x: np.ndarray
    slip_angle: np.ndarray
    mu_y: np.ndarray
    _tables: dict[str, ca.Function] = field(default_factory=dict, repr=False)

    def _look_up(self, name: str, place: np.ndarray, value: np.ndarray, slip: Scalar) -> Scalar:
        if name not in self._tables:
            self._tables[name] = ca.interpolant(name, "bspline", [place.tolist()], value.tolist())
        inside = clip(slip, float(place[0]), float(place[-1]))
        found = self._tables[name](inside)
        return found if is_symbolic(slip) else np.asarray(found).ravel()[0]

    def forces(
        self, slip_ratio: Scalar, slip_angle: Scalar, load: Scalar, *, camber: Scalar = 0.0, friction: Scalar = 1.0
    ) -> TireForces:
        """Friction coefficients times load."""
        mu_x = self._look_up("mu_x", self.slip_ratio, self.mu_x, slip_ratio)
        mu_y = self._look_up("mu_y", self.slip_angle, self.mu_y, slip_angle)
        return TireForces(friction * load * mu_x, friction * load * mu_y)


@dataclass(frozen=True, kw_only=True, eq=False)
class Drive:
    """One drive: lateral distance from the path [m] and state every 0.02 s, plans, times of each and its solver [s]."""

    e_y: np.ndarray
    states: np.ndarray
    plans: tuple[Plan, ...]
    seconds: np.ndarray
    inside: np.ndarray

    @property
    def v_x(self) -> np.ndarray:
        """Speed. [m/s]"""
        return self.states[:, 0]

    @property
    def rmse(self) -> float:
        """Of the lateral error. [m]"""
        return float(np.sqrt(np.mean(self.e_y**2)))

    @property
    def largest(self) -> float:
        """Largest lateral error. [m]"""
        return float(np.abs(self.e_y).max())


def drive(plant: ByCvodes[SingleTrack], controller: MPC, car: Car, path: Path, *, most: int = 1000) -> Drive:
    """Follow a path to its end, the full state measured, the reference at the wanted speed from the nearest point."""
    controller.prepare()
    fine = replace(plant, car=replace(plant.car, dt=SAMPLE))
    X, Y, psi = path.start
    x, plan, s = plant.car.straight(car.start_speed, X=X, Y=Y, psi=psi), None, 0.0
    e_y: list[float] = []
    states: list[np.ndarray] = []
    plans: list[Plan] = []
    seconds: list[float] = []
    inside: list[float] = []
    column = [plant.inputs.index(n) for n in controller.controls]
    rest = dict.fromkeys(controller.exogenous, 0.0)
    while s < path.length and len(plans) < most:
        reference = controller.reference(path.ahead(s, controller.times), **rest)
        began = time.process_time()
        plan = controller.plan(x, reference, plan)
        seconds.append(time.process_time() - began)
        inside.append(controller.engine.timing.total if isinstance(controller.engine, CompiledEngine) else seconds[-1])
        plans.append(plan)
        u = np.zeros(3)
        u[column] = plan.command
        for _ in range(round(STEP / SAMPLE)):
            foot = path.project(x[5], x[6], s)
            e_y.append(foot.e_y)
            states.append(x)
            s = foot.s
            x = fine.step(x, u)
        s = path.project(x[5], x[6], s).s
    return Drive(
        e_y=np.array(e_y),
        states=np.array(states),
        plans=tuple(plans),
        seconds=np.array(seconds),
        inside=np.array(inside),
    )


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of a table as printed: RMSE and largest lateral error [m], average solver time [s]."""

    tire: str
    horizon: int
    rmse: float
    largest: float
    seconds: float


def rows(tire: str, *numbers: tuple[float, float, float]) -> list[Row]:
    """Rows of one prediction tire, for N = 5, 10, 15."""
    return [
        Row(tire=tire, horizon=n, rmse=a, largest=b, seconds=c) for n, (a, b, c) in zip(HORIZONS, numbers, strict=True)
    ]


def records(
    table: str, car: Car, path: Path, plant_tire: Tire, tires: dict[str, Tire], printed: Sequence[Row], tell: Progress
) -> tuple[list[Record], tuple[Any, ...]]:
    """Every row by real-time iteration and by converged plans, a few steps of the thesis' way beside it; figures."""
    plant = ByCvodes(car.model(plant_tire))
    found: list[Record] = []
    shown: tuple[Any, ...] = ()
    for k, row in enumerate(printed):
        name = f"{table}, {row.tire}, N = {row.horizon}"
        tell(k / len(printed), name)
        model = car.model(tires[row.tire])
        fast = drive(plant, car.controller(model, row.horizon, RealTime()), car, path)
        slow = drive(plant, car.controller(model, row.horizon, RealTime(iterations=0)), car, path)
        found += [
            _at_most(name, "lateral RMSE [m]", row.rmse, fast.rmse, f"speed {fast.v_x[-1]:.2f} m/s at the end"),
            _at_most(name, "largest lateral error [m]", row.largest, fast.largest, ""),
            Record(
                row=name,
                quantity="RMSE over that of converged plans [-]",
                thesis=None,
                here=fast.rmse / slow.rmse,
                bound="<= 1.1, or both below 1 mm",
                holds=fast.rmse <= max(1.1 * slow.rmse, 1e-3),
                note=f"converged: {slow.rmse:.4g} m",
            ),
        ]
        if not shown and row.horizon == 10:
            shown = figures(car, fast, path)
        old = thesis_way(car, model, row.horizon, path)
        ours, whole = float(np.median(fast.inside[1:])), float(np.median(fast.seconds[1:]))
        p99 = float(np.percentile(fast.inside[1:], 99))
        found.append(
            Record(
                row=name,
                quantity="solver time [s], median",
                thesis=row.seconds,
                here=ours,
                bound=f"<= {old:.3g} s / 3000, of the thesis' way in the same run",
                holds=ours <= old / 3000,
                note=f"p99 {p99:.2g} s; with everything around it in Python {whole:.2g} s; ratio {old / ours:.0f}",
            )
        )
    return found, shown


def drives(
    title: str,
    doc: str | None,
    car: Car,
    path: Path,
    tires: Callable[[], tuple[Tire, dict[str, Tire]]],
    printed: Sequence[Row],
    progress: Progress,
) -> Reproduction:
    """A whole table of drives: every row, and the figures of one."""
    progress(0.0, "fitting the neural tires")
    plant, predicted = tires()
    name = title.partition(":")[0].lower()
    found, shown = records(name, car, path, plant, predicted, printed, progress)
    progress(1.0, "done")
    text = protocol(doc) + " Figures: Pacejka tires, N = 10, real-time iterations."
    return Reproduction(title=title, records=tuple(found), protocol=text, figures=shown)


def figures(car: Car, done: Drive, path: Path) -> tuple[Any, ...]:
    """Path, signals and solver time of one drive."""
    line = path.ahead(0.0, 400, path.length / 400 / car.speed)
    normal = np.column_stack([-np.sin(line.psi), np.cos(line.psi)])
    centre = np.column_stack([line.X, line.Y])
    t = SAMPLE * np.arange(len(done.e_y))
    held = np.repeat([plan.command for plan in done.plans], round(STEP / SAMPLE), axis=0)[: len(t)]
    limit = 0.9 / car.steering_ratio
    rows = [
        Signal(channel=Channel("e_y", "m"), values=done.e_y),
        Signal(channel=Channel("v_x", "m/s"), values=done.v_x),
        Signal(channel=Channel("delta", "rad"), values=held[:, 0], lower=-limit, upper=limit, held=True),
        Signal(channel=Channel(car.driven, "N m"), values=held[:, 1], lower=-car.torque, upper=car.torque, held=True),
    ]
    return (
        path_map(
            *done.states[:, 5:8].T,
            reference=centre,
            left=centre + np.where(np.isfinite(line.left), line.left, np.nan)[:, None] * normal,
            right=centre - np.where(np.isfinite(line.right), line.right, np.nan)[:, None] * normal,
        ),
        signals(t, rows),
        solver_time(done.inside, deadline=STEP),
    )


def _at_most(row: str, quantity: str, thesis: float, here: float, note: str) -> Record:
    return Record.judged(at_most=thesis, row=row, quantity=quantity, thesis=thesis, here=here, note=note)


def thesis_way(car: Car, model: SingleTrack, horizon: int, path: Path, *, steps: int = 2) -> float:
    """Median process time of Ipopt on multiple shooting with CVODES inside, over a few warm steps. [s]"""
    slow = car.controller(ByCvodes(model), horizon, Ipopt(tolerance=1e-8))
    done = drive(ByCvodes(model), slow, car, path, most=1 + steps)
    return float(np.median(done.seconds[1:]))
