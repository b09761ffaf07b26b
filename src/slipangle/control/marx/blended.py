"""The problem of a MARX-MPC: ARX models blended by speed, weights and limits, as its solver reads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Annotated

import numpy as np

from slipangle.control.controller import SteeringController
from slipangle.control.marx.problem import MarxProgram, Numbers, Solver
from slipangle.control.marx.solver import build
from slipangle.errors import ParameterError
from slipangle.fields import Checked, Count, Whole, Within
from slipangle.models.wrappers.multi_arx import MultiARXModel, SpeedBlend
from slipangle.models.wrappers.on_ground import POSE, OnGround
from slipangle.numerics.per_thread import built
from slipangle.optimal.terms import Limits, Values, Weights, coerce, require_names

FASTEST = 1e3  # m/s, above which no steering angle is worth planning


@dataclass(frozen=True, eq=False)
class BlendedProblem(Checked, SteeringController):
    """Settings of a `MultiARXMPC`, which says what they mean, and the solver built for them."""

    columns = references = POSE

    model: MultiARXModel | OnGround
    _: KW_ONLY
    horizon: Count
    Q: Weights
    S: Weights = field(default_factory=Weights)
    R: Weights = field(default_factory=Weights)
    terminal: Weights | None = None
    limits: Limits = field(default_factory=Limits)
    rates: Limits = field(default_factory=Limits)
    knots: Sequence[int] | None = None
    integral: Annotated[float, Within(0, 1)] = 0.0
    fallback: Whole = 5
    safe: Values = field(default_factory=Values)
    plausible: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        coerce(self, Weights, "Q", "S", "R", *(("terminal",) if self.terminal is not None else ()))
        coerce(self, Limits, "limits", "rates", "plausible")
        coerce(self, Values, "safe")
        super().__post_init__()
        if self.knots is not None:
            object.__setattr__(self, "knots", _checked_knots(self.knots, self.horizon))
        base = self.blended
        wanted = {"v_y", "r"} if self._posed else {"Y"}
        if set(base.outputs) != wanted:
            raise ParameterError(
                f"the models' outputs are {list(base.outputs)}; expected Y, or v_y and r on the ground: identify those"
            )
        for what, weights in (("Q", self.Q), ("terminal", self.terminal or {})):
            require_names(weights, self.tracked, what, "use a tracked quantity")
        for what, names in (("S", self.S), ("R", self.R), ("limits", self.limits), ("rates", self.rates)):
            require_names(names, self.controls, what, "use the models' input")
        require_names(self.safe, self.controls, "safe", "use the models' input")
        known = (*self.model.states, *POSE, *self.exogenous)
        require_names(self.plausible, known, "plausible", "use a state, X, Y, psi or v_x")
        if not (self.Q or self.terminal):
            raise ParameterError(f"nothing is tracked; expected weights on some of {list(self.tracked)}: set Q")
        name = self.controls[0]
        if not self.S.get(name, 0.0) + self.R.get(name, 0.0) > 0:
            raise ParameterError(
                f"the input '{name}' has no weight; expected a positive one, so that the plan is unique: set S"
            )
        lower, upper = self.rates.get(name, (0.0, 0.0))
        if not lower <= 0 <= upper:
            raise ParameterError(f"the rate limit of '{name}' is ({lower}, {upper}); expected one that contains 0")

    # ---- what a controller has -----------------------------------------------------------------------------------

    @cached_property
    def blended(self) -> SpeedBlend:
        """The blended model, without the ground."""
        base = self.model.off_ground
        if not (isinstance(base, SpeedBlend) and base.one_prediction):
            raise ParameterError(
                f"the model is a {type(base).__name__}; expected a MultiARXModel, or OnGround of one: blend the ARX "
                "models first"
            )
        return base

    @property
    def _posed(self) -> bool:
        return self.model.off_ground is not self.model

    @property
    def dt(self) -> float:
        """Step. [s]"""
        return self.model.dt

    @cached_property
    def controls(self) -> tuple[str, ...]:
        """The decided input."""
        return self.model.inputs[:1]

    @property
    def tracked(self) -> tuple[str, ...]:
        """What may have a weight in Q."""
        return ("e_y", "e_psi") if self._posed else ("Y",)

    def start(self, measured: Mapping[str, float]) -> np.ndarray:
        """State of the model for a vehicle that has been going straight on as it does now.

        Parameters
        ----------
        measured : mapping of str to float
            Measured channels, SI units.
        """
        base = self.blended
        known = {**measured, "v_y": measured.get("v_y", 0.0), "r": measured.get("r", 0.0)}
        rows = np.tile([known[n] for n in base.outputs], (base.na, 1))
        if base.outputs == ("Y",):
            across = known.get("v_x", 0.0) * np.sin(known.get("psi", 0.0)) + known["v_y"] * np.cos(known.get("psi", 0))
            rows[:, 0] -= across * self.dt * np.arange(base.na)
        past = np.full(base.reach - 1, measured.get(self.controls[0], 0.0))
        pose = [known[n] for n in POSE] if self._posed else []
        return np.concatenate([rows.ravel(), past, pose])

    def prepare(self) -> None:
        """Compile now, so that no plan counts that time as its own."""
        _ = self.solver

    @cached_property
    def problem(self) -> MarxProgram:
        """Sizes, weights and limits for the solver."""
        base, name = self.blended, self.controls[0]
        end = self.Q if self.terminal is None else self.terminal
        low, high = self.limits.get(name, (-np.inf, np.inf))
        slow, fast = self.rates.get(name, (-np.inf, np.inf))
        return MarxProgram(
            horizon=self.horizon,
            knots=tuple(self.knots or range(self.horizon)),
            dt=self.dt,
            na=base.na,
            reach=base.reach,
            outputs=base.outputs,
            n_models=len(base.models),
            smooth=base.shape == "smooth",
            rated=name in self.rates,
            q=np.array([self.Q.get(n, 0.0) for n in self.tracked]),
            end=np.array([end.get(n, 0.0) for n in self.tracked]),
            r=self.R.get(name, 0.0),
            s=self.S.get(name, 0.0),
            bounds=np.array([low, high]),
            steps=np.array([slow, fast]) * self.dt,
        )

    @built
    def solver(self) -> Solver:
        """The compiled solver or, without a compiler, NumPy and DAQP."""
        solver = build(self.problem, self.numbers)
        solver.expect(*self._judge.ranges)
        return solver

    @cached_property
    def numbers(self) -> Numbers:
        """Coefficients of the models and their speeds."""
        A, B, c = self.blended.coefficients
        return Numbers(speeds=np.array(self.blended.speeds, dtype=float), A=A, B=B, c=c)

    def is_plausible(self, x: np.ndarray, v_x: float) -> bool:
        """Whether a state and a speed [m/s] can be true."""
        return self._judge.states.holds(x) and abs(v_x) < FASTEST

    @cached_property
    def _range(self) -> tuple[float, float]:
        low, high = self.problem.bounds
        return float(low), float(high)


def _checked_knots(knots: Sequence[int], horizon: int) -> tuple[int, ...]:
    """Knots as whole numbers.

    Raises
    ------
    ParameterError
        If they do not begin with 0, do not grow, or reach beyond the horizon.
    """
    given = list(knots)
    whole = all(isinstance(k, int | np.integer) for k in given)
    if not (whole and given[:1] == [0] and all(a < b for a, b in pairwise(given)) and given[-1] < horizon):
        raise ParameterError(
            f"knots is {str(given)[:60]}; expected growing whole numbers from 0 to at most {horizon - 1}, the last step"
        )
    return tuple(int(k) for k in given)
