"""ARX models identified at several speeds, blended by weights of speed that sum to 1.

.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
"""

import abc
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, Literal, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.fields import Checked
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.black_box.model import shifted
from slipangle.models.model import FitInfo, Model, derived
from slipangle.models.region import Region
from slipangle.ops import Scalar, Vector, clip, concatenate, matmul

HELD = "the nearest of the models is used there as it is: identify one for such speeds, or doubt what they say"
Shape = Literal["triangular", "smooth"]


def speed_weights(v_x: Scalar, speeds: Sequence[float], shape: Shape = "triangular") -> list[Scalar]:
    """Weight of each model at a speed [m/s]; they sum to 1, at most two differ from 0. [1]_ fig. 7.3

    Below the first and above the last of the rising ``speeds`` the nearest model has all the weight; between them run
    straight lines, or, "smooth", ``3 t^2 - 2 t^3`` with a continuous slope.

    >>> [round(float(w), 6) for w in speed_weights(12.0, (10.0, 15.0, 20.0))]
    [0.6, 0.4, 0.0]
    """
    shares = []
    for a, b in pairwise(speeds):
        t = clip((v_x - a) / (b - a), 0.0, 1.0)
        shares.append(t if shape == "triangular" else t * t * (3.0 - 2.0 * t))
    edges = [0.0 * v_x + 1.0, *shares, 0.0 * v_x]
    return [edges[j] - edges[j + 1] for j in range(len(speeds))]


@dataclass(frozen=True, kw_only=True)
class SpeedBlend(Checked, Model):
    """What both kinds of blending share: the models, their speeds, their coefficients with equal numbers of lags.

    Raises ParameterError if the models do not fit each other or the speeds.

    Parameters
    ----------
    models : tuple of ARXModel
        One per speed, with the same sample time, outputs and one input.
    speeds : tuple of float
        Where they were identified, rising. [m/s]
    shape : {"triangular", "smooth"}
        See `speed_weights`.
    fit_info : FitInfo or None
        How all of them were fitted together, where they were.
    """

    one_prediction: ClassVar[bool]  # of a model with blended coefficients, or one of each model
    na = derived(lambda self: max(m.na for m in self.models))  # past outputs in the state, the most that a model uses
    reach = derived(lambda self: max(m.nb + m.nk - 1 for m in self.models))  # samples that past inputs reach back
    memory = derived(lambda self: max(self.na, self.reach))
    inputs = derived(lambda self: (*self.models[0].inputs, "v_x"))
    _copies = derived(lambda self: 1 if self.one_prediction else len(self.models))

    models: tuple[ARXModel, ...]
    speeds: tuple[float, ...]
    shape: Shape = "triangular"
    fit_info: FitInfo | None = field(
        default=None, repr=False, compare=False, metadata={"may be missing in a file": True}
    )

    dt = derived(lambda self: self.models[0].dt)
    outputs = derived(lambda self: self.models[0].outputs)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.models) != len(self.speeds) or not self.models:
            raise ParameterError(
                f"there are {len(self.models)} models for {len(self.speeds)} speeds; expected one for each"
            )
        if any(not b > a for a, b in pairwise(self.speeds)) or not np.isfinite(self.speeds).all():
            raise ParameterError(f"the models' speeds are {self.speeds}; expected rising ones")
        first = self.models[0]
        if len(first.inputs) != 1:
            raise ParameterError(f"the models have inputs {list(first.inputs)}; expected one, the steering angle")
        if min(m.nk for m in self.models) < 1:
            raise ParameterError("a model's output depends on the input at the same sample; expected nk of at least 1")
        for other in self.models[1:]:
            if (other.dt, other.inputs, other.outputs) != (first.dt, first.inputs, first.outputs):
                raise ParameterError(
                    f"models differ: dt {first.dt} and {other.dt} s, inputs {first.inputs} and {other.inputs}, outputs "
                    f"{first.outputs} and {other.outputs}; expected the same: identify all of them alike"
                )

    def with_estimates(self, values: np.ndarray) -> Self | None:
        """Coefficients by output, speed and regressor, as they were fitted together; None without such a fit."""
        info, ny, first = self.fit_info, len(self.outputs), self.models[0]
        count = 0 if info is None else len(info.names) // (ny * len(self.models))
        lags, inputs = first.na * ny, first.nb
        alike = all((m.na, m.nb, m.nk) == (first.na, first.nb, first.nk) for m in self.models)
        if info is None or not alike or not lags + inputs <= count <= lags + inputs + 1:
            return None
        rows = np.asarray(values, dtype=float).reshape(ny, len(self.models), count)
        models = []
        for j, model in enumerate(self.models):
            A = -rows[:, j, :lags].reshape(ny, first.na, ny).transpose(1, 0, 2)
            B = rows[:, j, lags : lags + inputs].T[:, :, None]
            c = rows[:, j, -1] if count > lags + inputs else model.c
            models.append(replace(model, A=A, B=B, c=c))
        return replace(self, models=tuple(models), fit_info=replace(info, values=np.array(values, dtype=float)))

    @cached_property
    def coefficients(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (n_models, na, ny, ny), B (n_models, reach, ny) and c (n_models, ny), absent lags being zero.

        ``y(k+1) = -A[0] y(k) - A[1] y(k-1) ... + B[0] u(k) + B[1] u(k-1) ... + c`` for each model.
        """
        ny, count = len(self.outputs), len(self.models)
        A, B = np.zeros((count, self.na, ny, ny)), np.zeros((count, self.reach, ny))
        c = np.zeros((count, ny))
        for j, model in enumerate(self.models):
            A[j, : model.na] = model.A
            B[j, model.nk - 1 : model.nk - 1 + model.nb] = model.B[:, :, 0]
            c[j] = model.c
        return A, B, c

    def weights(self, v_x: Scalar) -> list[Scalar]:
        """Weight of each model at a speed [m/s], see `speed_weights`."""
        return speed_weights(v_x, self.speeds, self.shape)

    @derived
    def region(self) -> Region:
        """Speeds that it was fitted to or, where nobody tells, those of the models."""
        if self.fit_info is not None and self.fit_info.region is not None:
            return self.fit_info.region
        ends = np.array(self.speeds)[[0, -1], None]
        return Region(channels=("v_x",), low=ends[0], high=ends[1], hull=np.empty((0, 6, 2)), beyond=HELD)

    def outside(self, v_x: float) -> bool:
        """Whether a speed [m/s] lies outside the range of the models."""
        return not self.speeds[0] <= v_x <= self.speeds[-1]

    # ---- the state: lagged outputs once or of each model, newest first, then past inputs -----------------------------

    @derived
    def states(self) -> tuple[str, ...]:
        """Lagged outputs, then lagged inputs."""
        lags = [(i, n) for i in range(self.na) for n in self.outputs]
        if self.one_prediction:
            past = [n if i == 0 else f"{n}[k-{i}]" for i, n in lags]
        else:
            past = [f"{n}{j}[k-{i}]" for j in range(self._copies) for i, n in lags]
        return (*past, *(f"{self.inputs[0]}[k-{i}]" for i in range(1, self.reach)))

    def initial_state(self, data: Dataset) -> np.ndarray:
        """Lags read from the first `memory` samples, the same for every model."""
        y, u = data.select(outputs=self.outputs).y, data.select(inputs=self.inputs[:1]).u[:, 0]
        last = self.memory - 1
        past = u[last - 1 :: -1][: self.reach - 1] if self.reach > 1 else u[:0]
        return np.concatenate([*[y[last::-1][: self.na].ravel()] * self._copies, past])

    def _split(self, x: Vector) -> tuple[list[Vector], Vector | None]:
        """Lagged outputs of each prediction, and past inputs where there are some."""
        each, split = len(self.outputs) * self.na, len(self.outputs) * self.na * self._copies
        return [x[a : a + each] for a in range(0, split, each)], x[split:] if len(self.states) > split else None

    def _together(self, newest: Sequence[Vector], lags: Sequence[Vector], inputs: Vector | None) -> Vector:
        """State from the newest outputs of each prediction and the older ones behind them."""
        parts = [part for y, older in zip(newest, lags, strict=True) for part in ((y, older) if self.na > 1 else (y,))]
        return concatenate(parts if inputs is None else [*parts, inputs])

    def step(self, x: Vector, u: Vector) -> Vector:
        """Next outputs in front, lags shifted by one."""
        lags, past = self._split(x)
        inputs = u[:1] if past is None else concatenate([u[:1], past])
        keep = len(self.outputs) * (self.na - 1)
        later = None if past is None else inputs[: self.reach - 1]
        return self._together(self._next(lags, inputs, u[1]), [own[:keep] for own in lags], later)

    @abc.abstractmethod
    def _next(self, lags: Sequence[Vector], inputs: Vector, v_x: Scalar) -> list[Vector]:
        """Next outputs of each prediction."""

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The newest outputs take their measured values."""
        lags, past = self._split(x)
        return self._together([y] * len(lags), [own[len(self.outputs) :] for own in lags], past)

    def _own_next(self, j: int, lags: Vector, inputs: Vector) -> Vector:
        """Next outputs of model ``j`` from lagged outputs and u(k), u(k-1), ..."""
        A, B, c = self.coefficients
        return shifted(matmul(np.hstack(list(-A[j])), lags) + matmul(B[j].T, inputs), c[j])


@dataclass(frozen=True, kw_only=True)
class MultiARXModel(SpeedBlend):
    """ARX models blended at every step: one model whose coefficients depend on the speed.

    The state holds the lags that all models share: outputs, newest first, then past inputs. Inputs are the models'
    input and the speed v_x [m/s].
    """

    one_prediction = True

    def _next(self, lags: Sequence[Vector], inputs: Vector, v_x: Scalar) -> list[Vector]:
        newest: Vector = 0.0
        for j, weight in enumerate(self.weights(v_x)):
            newest = newest + weight * self._own_next(j, lags[0], inputs)
        return [newest]

    def output(self, x: Vector, u: Vector) -> Vector:
        """The newest outputs."""
        return x[: len(self.outputs)]


@dataclass(frozen=True, kw_only=True)
class ParallelARX(SpeedBlend):
    """ARX models side by side, each running on its own predictions, with blended outputs. [1]_ eq. 7-3

    This is the prediction in the cost of MARX-MPC. The state holds every model's lagged outputs, then past inputs;
    `correct` gives all models the measured outputs.
    """

    one_prediction = False

    def _next(self, lags: Sequence[Vector], inputs: Vector, v_x: Scalar) -> list[Vector]:
        return [self._own_next(j, own, inputs) for j, own in enumerate(lags)]

    def output(self, x: Vector, u: Vector) -> Vector:
        """The blended newest outputs."""
        ny = len(self.outputs)
        return sum(w * own[:ny] for w, own in zip(self.weights(u[1]), self._split(x)[0], strict=True))
