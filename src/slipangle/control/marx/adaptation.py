"""`AdaptiveMultiARXMPC`: MARX-MPC whose models learn while driving, with a supervisor that says from what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from enum import Enum
from functools import cached_property
from math import isfinite
from typing import Annotated, Any, NamedTuple, TypeGuard

import numpy as np

from slipangle.control.call import given
from slipangle.control.controller import Ahead, Led
from slipangle.control.marx.mpc import SLOWEST, MultiARXMPC, MultiARXPlan
from slipangle.control.marx.problem import Numbers
from slipangle.errors import ParameterError
from slipangle.fields import Checked, Count, NotNegative, Positive, Within
from slipangle.models.wrappers.multi_arx import SpeedBlend
from slipangle.models.wrappers.on_ground import OnGround
from slipangle.optimal.checks import ANY, is_numbers
from slipangle.optimal.solution import Plan, Status


class Lesson(Enum):
    """What the supervisor made of the newest sample."""

    LEARNED = "the sample was learned from"
    WAITING = "there is no sample before this one"
    QUIET = "the regressors say next to nothing new: poor excitation"
    SURPRISING = "the prediction error is far outside its usual size: an outlier, or a tire beyond its linear range"
    SATURATED = "the lateral acceleration is beyond the range in which a linear model holds"
    OUTSIDE = "the speed is outside the models' range"
    DOUBTFUL = "the coefficients would have left the region that is trusted, so they stay"


@dataclass(frozen=True, kw_only=True)
class Supervisor(Checked):
    """Which samples the models learn from, and how far they may go.

    Parameters
    ----------
    excitation : float
        Least variance of the sample's prediction relative to the noise's, ``phi' P phi``, from which it learns. [-]
    surprise : float
        Largest prediction error, in standard deviations of past errors; beyond, the sample is left out.
    gain : float
        Largest factor by which the response to the input after `reach` steps may change against the start.
    reach : int
        Steps of that response.
    lateral : float
        Largest lateral acceleration ``|v_x r|`` of samples to learn from, for models of the yaw rate. [m/s2]
    least_change : float
        Least mean square of the input's change between samples, over about a second; below, nothing is learned. [rad^2]

    Raises
    ------
    ParameterError
        If a number is not positive, or the gain not above 1.
    """

    excitation: Positive = 1e-4
    surprise: Positive = 6.0
    gain: Annotated[float, Within(1, open="low")] = 2.0
    reach: Count = 10
    lateral: float = 4.0
    least_change: NotNegative = 1e-8


class Learned(NamedTuple):
    """What is known after a sample; it travels in ``Plan.memory``.

    theta (n_regressors, ny) of all models side by side, then one constant; P their covariance over the noise's; spread
    the variance of each output's errors; x and u of the last sample; change the mean square change of the input.
    """

    numbers: Numbers
    theta: np.ndarray
    P: np.ndarray
    spread: np.ndarray
    x: np.ndarray | None
    u: float
    change: float
    verdict: Lesson
    samples: int


@dataclass(frozen=True, kw_only=True, eq=False)
class AdaptivePlan(MultiARXPlan):
    """`MultiARXPlan` with what the supervisor did before it."""

    verdict: Lesson
    samples: int = 0


@dataclass(frozen=True, eq=False)
class AdaptiveMultiARXMPC(Checked, Led):
    """`MultiARXMPC` with recursive least squares on its models.

    All models are estimated together: the newest output is the blend ``sum_j w_j(v_x) theta_j' phi + c``, linear in all
    coefficients and one constant, so a sample between two speeds teaches both models by their weights. Old samples are
    forgotten along the present regressors only ([1]_), so a model whose speed is not driven keeps what it knows. The
    constant takes up what no coefficient explains, such as a bank or a steering offset, and makes the controller
    free of a steady offset. What is learned travels in the plans; the controller itself never changes.

    Parameters
    ----------
    base : MultiARXMPC
        Weights, limits and the models to start from.
    forgetting : float
        Weight of a sample per sample of age, above 0 and at most 1.
    prior : float
        Standard deviation of a coefficient at the start, relative to the largest one of its kind.
    noise : float
        Standard deviation of the outputs' one-step error at the start, in their unit.
    supervisor : Supervisor
        What it learns from.

    Raises
    ------
    ParameterError
        If a number makes no sense.

    References
    ----------
    .. [1] R. Kulhavy, Restricted exponential forgetting in real-time identification, Automatica 23 (1987) 589-600.
    """

    base: MultiARXMPC
    _: KW_ONLY
    forgetting: Annotated[float, Within(0, 1, open="low")] = 0.98
    prior: Positive = 0.05
    noise: Positive = 2e-3
    supervisor: Supervisor = field(default_factory=Supervisor)

    # ---- what a controller has -----------------------------------------------------------------------------------

    @property
    def model(self) -> SpeedBlend | OnGround:
        """The base controller's."""
        return self.base.model

    @property
    def leader(self) -> MultiARXMPC:
        """The base controller."""
        return self.base

    def prepare(self) -> None:
        """Compile now."""
        self.base.prepare()

    def start(self, measured: Mapping[str, float]) -> np.ndarray:
        """State of the model at the start."""
        return self.base.start(measured)

    def plan(
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> AdaptivePlan:
        """Learn from the newest sample, then plan; as `MultiARXMPC.plan`."""
        x, wanted = given(self, x, reference, previous)
        known = previous.memory if previous is not None and self._ours(previous.memory) else self._first
        learned = self.learn(known, x, float(wanted.exogenous[0, 0]))
        planned = self.base.plan_with(learned.numbers, x, wanted, previous, applied)
        true = planned.status not in (Status.NOT_FINITE, Status.IMPLAUSIBLE)
        memory = learned._replace(x=x.copy() if true else None, u=float(planned.u[0, 0]))
        values: dict[str, Any] = {name: getattr(planned, name) for name in planned.__dataclass_fields__}
        values["memory"] = memory
        return AdaptivePlan(**values, verdict=learned.verdict, samples=learned.samples)

    def _ours(self, memory: Any) -> TypeGuard[Learned]:
        """Whether something learned is of these models, and numbers."""
        first = self._first
        if not (isinstance(memory, Learned) and isinstance(memory.numbers, Numbers)):
            return False
        pairs = [(getattr(memory, n), getattr(first, n)) for n in ("theta", "P", "spread")]
        pairs += [(getattr(memory.numbers, n), getattr(first.numbers, n)) for n in ("speeds", "A", "B", "c")]
        good = all(is_numbers(given, start.shape) and (np.abs(given) < ANY).all() for given, start in pairs)
        last = memory.x is None or is_numbers(memory.x, (self.model.n_states,))
        return good and last and isfinite(memory.u) and isfinite(memory.change)

    def learned(self, plan: Plan) -> SpeedBlend:
        """The blended model as it was for a plan.

        Raises
        ------
        ParameterError
            If the plan holds nothing learned.
        """
        if not isinstance(plan.memory, Learned):
            raise ParameterError(
                "the plan holds nothing learned; expected one of this controller, not of a finished run"
            )
        numbers, base = plan.memory.numbers, self.base.blended
        reach = base.reach
        models = tuple(
            replace(m, A=numbers.A[j], B=numbers.B[j].reshape(reach, -1, 1), c=numbers.c[j], nk=1, fit_info=None)
            for j, m in enumerate(base.models)
        )
        return replace(base, models=models)

    # ---- learning ------------------------------------------------------------------------------------------------

    @cached_property
    def _sizes(self) -> tuple[int, int, int, int]:
        """Outputs, models, lagged outputs in a model, regressors of a model."""
        base = self.base.blended
        ny = len(base.outputs)
        return ny, len(base.models), base.na * ny, base.na * ny + base.reach

    @cached_property
    def _first(self) -> Learned:
        """Before the first sample."""
        ny, count, past, each = self._sizes
        numbers = self.base.numbers
        theta, size = np.zeros((count, each, ny)), np.ones((count, each))
        theta[:, :past] = -numbers.A.transpose(0, 1, 3, 2).reshape(count, past, ny)
        theta[:, past:] = numbers.B
        for kind in (slice(past), slice(past, each)):
            size[:, kind] = np.maximum(np.abs(theta[:, kind]).max(axis=(1, 2)), 1e-9)[:, None]
        theta = np.vstack([theta.reshape(-1, ny), numbers.c.mean(axis=0)])
        P = np.diag((self.prior * np.append(size, self.noise / self.prior) / self.noise) ** 2)
        spread = np.full(ny, self.noise**2)
        return Learned(numbers, theta, P, spread, None, 0.0, 0.0, Lesson.WAITING, 0)

    def learn(self, known: Learned, x: np.ndarray, v_x: float) -> Learned:
        """What is known after the state ``x`` at speed ``v_x`` [m/s] has been measured."""
        s, (ny, _, past, _) = self.supervisor, self._sizes
        last = known.x
        if last is None or not self.base.is_plausible(x, v_x):
            return known._replace(verdict=Lesson.WAITING)
        base = self.base.blended
        reach = base.reach
        inputs = np.concatenate([[known.u], last[past : past + reach - 1]])
        before = float(inputs[1]) if reach > 1 else known.u
        change = known.change + 0.05 * ((known.u - before) ** 2 - known.change)
        known = known._replace(change=change)
        if base.outside(v_x) or v_x < SLOWEST:
            return known._replace(verdict=Lesson.OUTSIDE)
        if "r" in base.outputs:
            i = base.outputs.index("r")
            if max(abs(x[i]), abs(last[i])) * v_x > s.lateral:
                return known._replace(verdict=Lesson.SATURATED)
        row = np.concatenate([last[:past], inputs])
        phi = np.append(np.concatenate([w * row for w in base.weights(v_x)]), 1.0)
        gain = known.P @ phi
        information = float(phi @ gain)
        if information < s.excitation or change < s.least_change:
            return known._replace(verdict=Lesson.QUIET)
        error = x[:ny] - phi @ known.theta
        usual = known.spread * (1.0 + information)
        if (error**2 > s.surprise**2 * usual).any():
            spread = np.minimum(known.spread * 1.05, 100 * self.noise**2)  # so that a lasting change is believed
            return known._replace(verdict=Lesson.SURPRISING, spread=spread)
        theta = known.theta + np.outer(gain, error) / (1.0 + information)
        numbers = self._numbers(theta)
        if not self._trusted(numbers):
            return known._replace(verdict=Lesson.DOUBTFUL)
        share = self.forgetting - (1.0 - self.forgetting) / information  # Kulhavy: forget along phi alone
        P = known.P - np.outer(gain, gain) * (share / (1.0 + share * information))
        P = 0.5 * (P + P.T)
        spread = known.spread + 0.02 * (error**2 / (1.0 + information) - known.spread)
        spread = np.maximum(spread, (0.1 * self.noise) ** 2)
        return Learned(numbers, theta, P, spread, None, 0.0, change, Lesson.LEARNED, known.samples + 1)

    def _numbers(self, theta: np.ndarray) -> Numbers:
        """Coefficients as the solver reads them."""
        ny, count, past, each = self._sizes
        of_models = theta[:-1].reshape(count, each, ny)
        A = -of_models[:, :past].reshape(count, -1, ny, ny).transpose(0, 1, 3, 2)
        speeds, B = self.base.numbers.speeds, of_models[:, past:]
        return Numbers(speeds=speeds, A=A, B=B, c=np.tile(theta[-1], (count, 1)))

    @cached_property
    def _start_response(self) -> np.ndarray:
        return self._response(self.base.numbers)

    def _response(self, numbers: Numbers) -> np.ndarray:
        """Outputs after `Supervisor.reach` steps of an input of 1, shape (n_models, ny)."""
        ny, count, _, _ = self._sizes
        na, reach = self.base.blended.na, self.base.blended.reach
        y = np.zeros((na + self.supervisor.reach, count, ny))
        held = np.cumsum(numbers.B, axis=1)
        for k in range(self.supervisor.reach):
            now = held[:, min(k, reach - 1)].copy()
            for i in range(na):
                now -= np.einsum("jab,jb->ja", numbers.A[:, i], y[na + k - 1 - i])
            y[na + k] = now
        return y[-1]

    def _trusted(self, numbers: Numbers) -> bool:
        """Whether the response to the input has kept its sign and about its size."""
        start, now = self._start_response, self._response(numbers)
        near = np.abs(start) > 0.05 * np.abs(start).max()
        ratio = np.where(near, now / np.where(near, start, 1.0), 1.0)
        return bool(
            np.isfinite(now).all() and (ratio < self.supervisor.gain).all() and (ratio > 1 / self.supervisor.gain).all()
        )
