"""What tables 6.5, 6.6, 6.11 and 6.12 share: the two cars, their controllers, the plant, the drive, the protocol."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from slipangle import MPC, Channel, Ipopt, Model, Path, RealTime, SingleTrack, SingleTrackParams, Tire
from slipangle.control.presets import SOUSA_EQ_6_3, SOUSA_EQ_6_4
from slipangle.models.tires.simple import TireForces
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_1, SOUSA_TABLE_6_10
from slipangle.ops import Scalar, clip, is_symbolic
from slipangle.optimal.realtime.engine import CompiledEngine
from slipangle.optimal.solution import Plan
from slipangle.report.drives import Signal, signals, solver_time
from slipangle.report.maps import path_map
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._cvodes import ByCvodes

PROTOCOL = """\
Plant: CVODES. Tables 6.5 and 6.6: tires of table 6.2 in the plant; the same, and MLP {2 2} fitted as in table 6.4, seed
0, in the prediction; weights of eq. 6-3. Tables 6.11 and 6.12: look-up tables of the labelled stand-in of table 6.8
without its noise in the plant; the coefficients of table 6.8, and MLP {1 1} fitted to the stand-in with noise, seed 0,
in the prediction; weights of eq. 6-4. The thesis' paths are not given. Here a double lane change has the lanes of ISO
3888-1, joined by quintics that reach 12 m into them, the smoothest line that keeps the vehicle between the cones; lane
changes are of 3.5 m to the left, back, to the right and back, each a quintic over 50 m, with 30 m straight between
them. The full state is measured; the reference is the path ahead at the wanted speed from the nearest point on it.
Every row is driven by real-time iterations and by converged plans. The thesis' own way, Ipopt on multiple shooting with
CVODES inside, solves the first steps of the same drive in the same run. Nothing is random but the fits."""
HORIZONS = (5, 10, 15)
STEP, SAMPLE = 0.1, 0.02  # s, of the controller and of the recorded drive
PRINTED = {  # RMSE and largest lateral error [m], average solver time [s], for each horizon
    ("Table 6.5", "Pacejka"): ((0.2029, 0.3959, 0.8437), (0.1989, 0.3872, 1.5745), (0.2019, 0.3925, 2.517)),
    ("Table 6.5", "Neural"): ((0.2014, 0.3938, 0.8264), (0.1972, 0.385, 1.6291), (0.1997, 0.3894, 2.5728)),
    ("Table 6.6", "Pacejka"): ((0.1728, 0.3941, 0.7887), (0.1663, 0.385, 1.5505), (0.1682, 0.391, 2.3741)),
    ("Table 6.6", "Neural"): ((0.171, 0.391, 0.8077), (0.1647, 0.381, 1.5303), (0.1661, 0.3872, 2.3223)),
    ("Table 6.11", "Pacejka"): ((0.3157, 0.61, 0.5588), (0.3119, 0.5944, 1.0134), (0.3125, 0.5904, 1.5668)),
    ("Table 6.11", "Neural"): ((0.3161, 0.6139, 0.4404), (0.3121, 0.5986, 0.8027), (0.3132, 0.5955, 1.1817)),
    ("Table 6.12", "Pacejka"): ((0.2654, 0.7317, 0.5465), (0.2599, 0.7052, 0.9766), (0.2609, 0.7085, 1.6573)),
    ("Table 6.12", "Neural"): ((0.2661, 0.7373, 0.4382), (0.2603, 0.7101, 0.7757), (0.2612, 0.7136, 1.3855)),
}


@dataclass(frozen=True, kw_only=True)
class Car:
    """One of the two cars: parameters, the problem's weights and limits, speed at the start and wanted [m/s]."""

    params: SingleTrackParams
    settings: dict[str, Any]
    start_speed: float
    speed: float

    def model(self, tire: Tire) -> SingleTrack:
        """Single track on one kind of tire all round, one step of Radau IIA per sample."""
        return SingleTrack(params=self.params, dt=STEP, tire_f=tire, tire_r=tire, method="radau")

    def controller(self, model: Model, horizon: int, solver: Any) -> MPC:
        """The thesis' problem on a model of the car."""
        return MPC(model, horizon=horizon, solver=solver, **self.settings)


FRONT_DRIVE = Car(params=SOUSA_TABLE_6_1, settings=SOUSA_EQ_6_3, start_speed=19.0, speed=20.0)
REAR_DRIVE = Car(params=SOUSA_TABLE_6_10, settings=SOUSA_EQ_6_4, start_speed=24.0, speed=25.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class LookUpTire(Tire):
    """Friction coefficients interpolated in tables of slip ratio [-] and slip angle [rad]; held beyond their ends."""

    slip_ratio: np.ndarray
    mu_x: np.ndarray
    slip_angle: np.ndarray
    mu_y: np.ndarray
    _tables: dict[str, ca.Function] = field(default_factory=dict, repr=False)

    def _look_up(self, name: str, place: np.ndarray, value: np.ndarray, slip: Scalar) -> Scalar:
        if name not in self._tables:
            self._tables[name] = ca.interpolant(name, "bspline", [place.tolist()], value.tolist())
        inside = clip(slip, float(place[0]), float(place[-1]))
        force = self._tables[name](inside)
        return force if is_symbolic(slip) else np.asarray(force).ravel()[0]

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


def drives(
    table: str, what: str, car: Car, path: Path, tires: Callable[[], tuple[Tire, dict[str, Tire]]]
) -> Callable[[Progress], Reproduction]:
    """What reproduces a whole table of drives: every row, and the figures of one."""

    def reproduce(progress: Progress) -> Reproduction:
        progress(0.0, "fitting the neural tires")
        plant, predicted = tires()
        made, shown = records(table, car, path, plant, predicted, progress)
        more = "Figures: Pacejka tires, N = 10, real-time iterations."
        return Reproduction.told(f"{table}: {what}\n\n{PROTOCOL}", made, shown, more=more)

    return reproduce


def records(
    table: str, car: Car, path: Path, plant_tire: Tire, tires: dict[str, Tire], tell: Progress
) -> tuple[list[Record], tuple[Any, ...]]:
    """Every row by real-time iteration and by converged plans, a few steps of the thesis' way beside it; figures."""
    plant = ByCvodes(car.model(plant_tire))
    made: list[Record] = []
    shown: tuple[Any, ...] = ()
    rows = {tire: each for (name, tire), each in PRINTED.items() if name == table}
    cases = [(tire, *case) for tire, each in rows.items() for case in zip(HORIZONS, each, strict=True)]
    for k, (tire, horizon, (rmse, largest, seconds)) in enumerate(cases):
        row = f"{table.lower()}, {tire}, N = {horizon}"
        tell(k / len(cases), row)
        model = car.model(tires[tire])
        fast = drive(plant, car.controller(model, horizon, RealTime()), car, path)
        slow = drive(plant, car.controller(model, horizon, RealTime(iterations=0)), car, path)
        holds = fast.rmse <= max(1.1 * slow.rmse, 1e-3)
        said = f"speed {fast.v_x[-1]:.2f} m/s at the end", f"converged: {slow.rmse:.4g} m"
        ratio, bound = "RMSE over that of converged plans [-]", "<= 1.1, or both below 1 mm"
        made += [
            Record.judged(row, "lateral RMSE [m]", rmse, fast.rmse, at_most=rmse, note=said[0]),
            Record.judged(row, "largest lateral error [m]", largest, fast.largest, at_most=largest),
            Record(row, ratio, None, fast.rmse / slow.rmse, bound, holds, said[1]),
        ]
        if not shown and horizon == 10:
            shown = figures(car, fast, path)
        old = thesis_way(car, model, horizon, path)
        ours, whole = float(np.median(fast.inside[1:])), float(np.median(fast.seconds[1:]))
        p99 = float(np.percentile(fast.inside[1:], 99))
        bound = f"<= {old:.3g} s / 3000, of the thesis' way in the same run"
        note = f"p99 {p99:.2g} s; with everything around it in Python {whole:.2g} s; ratio {old / ours:.0f}"
        made.append(Record(row, "solver time [s], median", seconds, ours, bound, ours <= old / 3000, note))
    return made, shown


def figures(car: Car, done: Drive, path: Path) -> tuple[Any, ...]:
    """Path, signals and solver time of one drive."""
    right, left = path.boundaries()
    centre = np.column_stack([path.X, path.Y])
    t = SAMPLE * np.arange(len(done.e_y))
    held = np.repeat([plan.command for plan in done.plans], round(STEP / SAMPLE), axis=0)[: len(t)]
    rows = [
        Signal(channel=Channel("e_y", "m"), values=done.e_y),
        Signal(channel=Channel("v_x", "m/s"), values=done.v_x),
    ]
    for j, (name, (lower, upper)) in enumerate(car.settings["limits"].items()):
        unit = "N m" if j else "rad"
        rows.append(Signal(channel=Channel(name, unit), values=held[:, j], lower=lower, upper=upper, held=True))
    return (
        path_map(*done.states[:, 5:8].T, reference=centre, left=left, right=right),
        signals(t, rows),
        solver_time(done.inside, deadline=STEP),
    )


def thesis_way(car: Car, model: SingleTrack, horizon: int, path: Path, *, steps: int = 2) -> float:
    """Median process time of Ipopt on multiple shooting with CVODES inside, over a few warm steps. [s]"""
    slow = car.controller(ByCvodes(model), horizon, Ipopt(tolerance=1e-8))
    done = drive(ByCvodes(model), slow, car, path, most=1 + steps)
    return float(np.median(done.seconds[1:]))
