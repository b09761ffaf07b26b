"""`SwitchedMPC`: a fast controller while the tires are far from their limit, a nonlinear one near it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, fields, replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from slipangle.control.call import given
from slipangle.control.controller import Ahead, Led
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.model import Model, derived
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.wrappers.on_ground import POSE
from slipangle.ops import Vector, concatenate
from slipangle.optimal.checks import counted, is_numbers, stuck
from slipangle.optimal.ocp import Reference
from slipangle.optimal.solution import Plan, Status


@dataclass(frozen=True)
class SideBySide(Model):
    """Two models of the same vehicle, each with its own state; the outputs are the first one's.

    Parameters
    ----------
    first, second : Model
        With the same sample time and inputs, and the same outputs in any order.

    Raises
    ------
    ParameterError
        If they differ in these.
    """

    first: Model
    second: Model

    def __post_init__(self) -> None:
        a, b = self.first, self.second
        if a.dt != b.dt or a.inputs != b.inputs or set(a.outputs) != set(b.outputs):
            raise ParameterError(
                f"the models differ: dt {a.dt} and {b.dt} s, inputs {a.inputs} and {b.inputs}, outputs {a.outputs} and "
                f"{b.outputs}; expected the same ones"
            )

    @derived
    def dt(self) -> float:
        """Sample time. [s]"""
        return self.first.dt

    @derived
    def inputs(self) -> tuple[str, ...]:
        """Inputs of both."""
        return self.first.inputs

    @derived
    def outputs(self) -> tuple[str, ...]:
        """Outputs of the first."""
        return self.first.outputs

    @derived
    def states(self) -> tuple[str, ...]:
        """States of the first, then of the second with a prime."""
        return (*self.first.states, *(f"{n}'" for n in self.second.states))

    @derived
    def memory(self) -> int:
        """Samples a free run starts from."""
        return max(self.first.memory, self.second.memory)

    def initial_state(self, data: Dataset) -> np.ndarray:
        """Both states at the last of the first `memory` samples."""
        parts = [m.initial_state(data.rows(self.memory - m.memory, self.memory)) for m in (self.first, self.second)]
        return np.concatenate(parts)

    def split(self, x: Any) -> tuple[Any, Any]:
        """The two states."""
        return x[: self.first.n_states], x[self.first.n_states :]

    def step(self, x: Vector, u: Vector) -> Vector:
        """Both one sample on."""
        a, b = self.split(x)
        return concatenate([self.first.step(a, u), self.second.step(b, u)])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the first."""
        return self.first.output(self.split(x)[0], u)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """Both take in the measurement."""
        a, b = self.split(x)
        order = [self.first.outputs.index(n) for n in self.second.outputs]
        other = concatenate([y[i : i + 1] for i in order])
        return concatenate([self.first.correct(a, u, y), self.second.correct(b, u, other)])


@dataclass(frozen=True, kw_only=True, eq=False)
class SwitchedPlan(Plan):
    """`Plan` of a `SwitchedMPC`.

    Parameters
    ----------
    active : int
        0: the calm controller planned; 1: the one for the limit.
    demand : float
        Lateral acceleration demanded over the friction's, see `SwitchedMPC`. [-]
    calm_steps : int
        Steps in a row with little demand.
    planned : Plan
        The active controller's own, from which it goes on while it stays active.
    """

    active: int
    demand: float
    calm_steps: int
    planned: Plan


@dataclass(frozen=True, eq=False)
class SwitchedMPC(Led):
    """Two controllers and a criterion that says which one plans.

    The criterion is the share of grip that is needed: ``demand = max(|v_x r| now, |v_x r| in the plan before,
    v_x^2 |curvature| ahead) / (friction g)``, over the horizon. Above `enter` the controller for the limit plans, until
    the demand has stayed below `leave` for `dwell` steps: the gap and the time keep the two from taking turns
    quickly. Both see every measurement all the time, and the new one starts from the inputs of the plan before.

    Parameters
    ----------
    calm, limit : MultiARXMPC or MPC
        With the same horizon, step, decided input and reference: X, Y, psi, with v_x from outside.
    friction : float
        Of the road, as far as it is known. [-]
    enter, leave : float
        Demand at which the limit's controller takes over, and below which it gives back. [-]
    dwell : int
        Steps of little demand before it gives back.

    Raises
    ------
    ParameterError
        If the controllers do not fit each other or ``leave`` is not below ``enter``.
    """

    calm: MultiARXMPC | MPC
    limit: MultiARXMPC | MPC
    _: KW_ONLY
    friction: float = 1.0
    enter: float = 0.5
    leave: float = 0.4
    dwell: int = 10

    def __post_init__(self) -> None:
        for name in ("horizon", "dt", "controls", "exogenous", "references"):
            a, b = getattr(self.calm, name), getattr(self.limit, name)
            if a != b:
                raise ParameterError(f"the controllers' {name} are {a} and {b}; expected the same")
        for controller in (self.calm, self.limit):
            if not np.allclose(np.diff(controller.times), self.calm.dt):
                raise ParameterError(
                    f"a controller's instants are {controller.times} s; expected equal steps, which both can share: "
                    "leave steps out"
                )
        if tuple(self.calm.references) != POSE or tuple(self.calm.exogenous) != ("v_x",):
            raise ParameterError(
                f"the controllers track {self.calm.references} with {self.calm.exogenous} from outside; expected X, Y, "
                "psi with v_x: give both Q=Weights(e_y=...)"
            )
        if not (0 < self.leave < self.enter and self.friction > 0 and self.dwell >= 0):
            raise ParameterError(
                f"enter is {self.enter}, leave {self.leave}, friction {self.friction}, dwell {self.dwell}; expected "
                "0 < leave < enter, a positive friction and at least 0 steps"
            )

    @cached_property
    def model(self) -> SideBySide:
        """The two controllers' models."""
        return SideBySide(self.calm.model, self.limit.model)

    @property
    def leader(self) -> MultiARXMPC | MPC:
        """The calm controller; the other one agrees with it."""
        return self.calm

    def prepare(self) -> None:
        """Compile both now."""
        self.calm.prepare()
        self.limit.prepare()

    def start(self, measured: Mapping[str, float]) -> np.ndarray:
        """State of both models at the start."""
        parts = []
        for controller in (self.calm, self.limit):
            if isinstance(controller, MultiARXMPC):
                parts.append(controller.start(measured))
            else:
                parts.append(np.array([measured.get(n, 0.0) for n in controller.model.states]))
        return np.concatenate(parts)

    @np.errstate(all="ignore")
    def demand(self, x: np.ndarray, reference: Reference, previous: Plan | None) -> float:
        """Share of grip that is needed, see the class; infinite if anything is not finite."""
        v = np.abs(reference.exogenous[: len(reference.tracked) - 1, 0])
        step = np.maximum(np.hypot(*np.diff(reference.tracked[:, :2], axis=0).T), 1e-3)
        bend = np.abs(np.diff(reference.tracked[:, 2])) / step * v**2
        states = self.model.states
        yaw_rate = float(x[states.index("r")]) if "r" in states else 0.0
        needed = [float(bend.max()), float(v[0] * abs(yaw_rate))]
        seen = previous.x[:, -1] if previous is not None and np.ndim(previous.x) == 2 and np.size(previous.x) else None
        if is_numbers(seen, (self.horizon + 1,)):
            needed.append(float((np.abs(np.diff(seen)) / self.dt * v).max()))
        share = float(np.max(needed)) / (self.friction * GRAVITY)
        return share if np.isfinite(share) else np.inf

    def plan(
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> SwitchedPlan:
        """Plan with the controller that the criterion names; as `MPC.plan`."""
        begin = perf_counter()
        x, wanted = given(self, x, reference, previous)
        wanted.require_plain("a switched controller")
        demand = self.demand(x, wanted, previous)
        last = previous if isinstance(previous, SwitchedPlan) else None
        calm_before = 0 if last is None else counted(last.calm_steps)
        calm_steps = calm_before + 1 if demand < self.leave else 0
        active = 0 if last is None else int(last.active == 1)
        if demand > self.enter:
            active = 1
        elif active and calm_steps > self.dwell:
            active = 0
        chosen = (self.calm, self.limit)[active]
        part = self.model.split(x)[active]
        before = previous
        if last is not None and last.active == active and isinstance(last.planned, Plan):  # with all that is its own
            before = replace(last.planned, **{f.name: getattr(last, f.name) for f in fields(Plan)})
        elif previous is not None and stuck(previous):  # what led the other one nowhere may lead this one somewhere
            before = replace(previous, status=Status.NOT_FINITE)
        planned = chosen.plan(part, wanted, before, applied=applied)
        values = {f.name: getattr(planned, f.name) for f in fields(Plan)}
        values["seconds"] = perf_counter() - begin
        return SwitchedPlan(**values, active=active, demand=demand, calm_steps=calm_steps, planned=planned)
