"""`Compensated`: a path follower that sees the car where its steering will act, and leaves no steady error."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from slipangle.control.default_drive import driven_model
from slipangle.control.followers.followers import PathFollower, SteeringLaw
from slipangle.control.targets import SteadyStates
from slipangle.errors import ParameterError
from slipangle.fields import Checked
from slipangle.models.fast import bind
from slipangle.models.model import Model
from slipangle.models.ode import Parametrised
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.optimal.ocp import Reference


@dataclass(frozen=True, kw_only=True)
class Compensated(Checked, SteeringLaw):
    """Path follower with delay and lag of the steering compensated, and without steady error.

    The follower is asked about the state that the identified model predicts, with the steering held, for as long as its
    delay and lag, and about the path from there on: a Smith predictor [1]_, with the model's own state as what has been
    commanded and does not act yet. To its answer comes what it lacks in steady driving: on a circle of the curvature
    there, with side slip and steering of the model (`SteadyStates`), pushed as an estimator says (`Disturbed`), it
    would answer something else than that steering, and the difference is added. So wind, bank, a wrong stiffness and a
    steering offset leave no steady error, whatever the law.

    Use it in a `Driver`, ``Driver(model, path, controller=Compensated(follower=Stanley(...), car=model))``, or in
    `closed_loop` with an estimator of `model`.

    Parameters
    ----------
    follower : PathFollower
        The law; its ``dt``, ``horizon``, ``limit`` and ``rate`` hold.
    car : Model
        Lateral dynamics as identified, with inputs ``delta`` and ``v_x``, on the ground or off it; delay and lag are
        those of its parameters ``delay_delta`` and ``steering_lag``, none where it has none.

    Raises
    ------
    ParameterError
        If the model lacks v_y or r among its states, or has other inputs, or its sample time is not the follower's.

    References
    ----------
    .. [1] O. J. M. Smith, Closer control of loops with dead time, Chemical Engineering Progress 53(5), 1957.
    """

    controls = PathFollower.controls
    columns = references = PathFollower.columns
    steady = True

    follower: PathFollower
    car: Model

    def __post_init__(self) -> None:
        super().__post_init__()
        model = self.model
        if not math.isclose(model.dt, self.dt):
            raise ParameterError(
                f"the model's sample time is {model.dt:g} s, the follower's {self.dt:g} s; expected the same: give the "
                f"follower dt={model.dt:g}"
            )
        lacking = [n for n in self.follower.model.states if n not in model.states]
        others = [n for n in model.inputs if n not in ("delta", "v_x")]
        if lacking or others:
            raise ParameterError(
                f"the model lacks the states {lacking} and has the inputs {others} beside delta and v_x; expected an "
                "identified bicycle: use an MPC on other models"
            )

    dt, limit, rate = (
        property(lambda self, name=name: getattr(self.follower, name)) for name in ("dt", "limit", "rate")
    )

    @property
    def horizon(self) -> int:  # type: ignore[override]  # not set
        """How many steps it looks ahead."""
        return self.follower.horizon + self.lead

    @cached_property
    def model(self) -> Model:  # type: ignore[override]  # made once
        """The identified model with what may push it, on the ground."""
        return driven_model(self.car, self.dt, lagging=False)

    @cached_property
    def lead(self) -> int:
        """Delay and lag of the steering together, in steps."""
        inner: Model = self.model
        while isinstance(inner, Wrapper) and not isinstance(inner, Parametrised):
            inner = inner.model
        if not isinstance(inner, Parametrised):
            return 0
        known = [inner.value(n) for n in ("delay_delta", "steering_lag") if n in inner.parameter_names]
        return round(sum(known) / self.dt)

    def _angle(self, x: np.ndarray, wanted: Reference, before: float) -> float:
        v_x = float(wanted.exogenous[0, 0])
        rows = wanted.tracked[self.lead :]
        seen = self._seen(self._later(x, before, v_x))
        there = Reference(tracked=rows, exogenous=wanted.exogenous[self.lead :])
        answer = self.follower._angle(seen, there, before)
        steady, target, bend = self._target(rows, v_x, x[list(self._steady.disturbances)])
        known = Reference(tracked=bend, exogenous=there.exogenous)
        return answer + steady - self.follower._angle(target, known, min(max(steady, -self.limit), self.limit))

    def _target(self, rows: np.ndarray, v_x: float, d: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Steering and state of steady driving on the circle that the path is part of there, and that circle."""
        X, Y, psi, curvature = map(float, rows[0, :4])
        slip, steering = self._steady(v_x, np.array([v_x * curvature]), d)
        values = {
            "X": X,
            "Y": Y,
            "psi": psi - math.atan2(slip[0], max(v_x, 1e-3)),
            "v_y": slip[0],
            "r": v_x * curvature,
        }
        along = v_x * self.dt * np.arange(len(rows))
        turned = curvature * along
        chord = along * np.sinc(0.5 * turned / np.pi)
        bend = np.column_stack(
            [X + chord * np.cos(psi + 0.5 * turned), Y + chord * np.sin(psi + 0.5 * turned), psi + turned]
        )
        rest = np.column_stack([np.full_like(along, curvature), rows[:, 4]])
        target = np.array([values[n] for n in self.follower.model.states])
        return float(steering[0]), target, np.hstack([bend, rest])

    def _seen(self, x: np.ndarray) -> np.ndarray:
        return x[[self.model.states.index(n) for n in self.follower.model.states]]

    def _later(self, x: np.ndarray, delta: float, v_x: float) -> np.ndarray:
        """The state when what is commanded now acts."""
        state, inputs, later, call = self._step
        state[:] = x
        inputs[:] = [delta if n == "delta" else v_x for n in self.model.inputs]
        for _ in range(self.lead):
            call()
            state[:] = later
        return state.copy()

    @cached_property
    def _step(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, Callable[[], None]]:
        state, inputs, later = (
            np.zeros(self.model.n_states),
            np.zeros(self.model.n_inputs),
            np.zeros(self.model.n_states),
        )
        return state, inputs, later, bind(self.model.functions[0], (state, inputs), later)

    @cached_property
    def _steady(self) -> SteadyStates:
        return SteadyStates(self.model)
