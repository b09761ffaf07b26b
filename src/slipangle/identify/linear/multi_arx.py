"""ARX models at several speeds, fitted together by least squares on the blended model."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ExcitationError, ParameterError, TooShortError
from slipangle.fields import Checked, Count, Finite, Within
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.linear.arx import unstable_said
from slipangle.identify.linear.estimator import channels, described
from slipangle.identify.linear.orders import Chosen, Orders, choose, regression
from slipangle.identify.stability import announced, breakdown_said, noted
from slipangle.models.black_box.arx import ARXModel
from slipangle.models.plausible import growth
from slipangle.models.region import Region
from slipangle.models.wrappers.multi_arx import HELD, MultiARXModel, speed_weights

_APART = 1.15  # ratio of neighbouring speeds, at least
_REACH = 0.05  # of the first or last of these, by which the data go on beyond it before it is put at their end
_PER_SPEED = 500  # samples for each speed, at least, where speeds are chosen
_MOST = 6  # speeds that are chosen
_ROUNDS = 50  # in which they settle
_TRIED = 10  # orders that are fitted to all data where the better ones depend on each other


@dataclass(frozen=True, kw_only=True)
class MultiARX(Checked):
    """Estimator of `MultiARXModel`: ARX models at several speeds, blended by v_x, with the same lags.

    The coefficients of all speeds are found together, by least squares on the one-step-ahead error of the blended
    model, so experiments may run through any speeds. Orders that are not given are chosen as `ARX` does, for all
    speeds at once, with no direct path; of a system that is unstable at most speeds that is said alike.

    Raises ParameterError if the speeds do not rise.

    Parameters
    ----------
    na, nb, nk : int or "chosen"
        Past outputs, coefficients of the input, samples from it to the outputs (at least 1).
    speeds : tuple of float
        At which the models stand, rising [m/s]; by default up to 6 about which the data gather, see
        `chosen_speeds`.
    offset : bool
        Estimate a constant at every speed too; a steering wheel that is not straight at zero makes one.
    """

    na: Count | Chosen = "chosen"
    nb: Count | Chosen = "chosen"
    nk: Annotated[int, Within(1)] | Chosen | None = None
    speeds: tuple[Finite, ...] = ()
    offset: bool = True

    def __post_init__(self) -> None:
        if self.nk is None:
            object.__setattr__(self, "nk", "chosen" if "chosen" in (self.na, self.nb) else 1)
        super().__post_init__()
        if any(not b > a for a, b in pairwise(self.speeds)):
            raise ParameterError(f"speeds is {self.speeds}; expected rising ones [m/s]")

    def fit(self, data: Dataset) -> MultiARXModel:
        """Model of all outputs from the steering and v_x [m/s]; experiments are never joined.

        Raises ParameterError if the inputs are not v_x and one other, ExcitationError or TooShortError if the data
        cannot tell the coefficients of a speed, and SimulationError if the fit diverged.

        Warns with ModelWarning if a free run at one of the speeds would blow up.
        """
        require_dataset(data, "fit() got")
        with breakdown_said("the ARX models", data):
            return announced(self._fit(data))

    def _fit(self, data: Dataset) -> MultiARXModel:
        began = time.perf_counter()
        if len(data.inputs) != 2 or "v_x" not in data.inputs:
            raise ParameterError(
                f"the inputs of '{data.name}' are {', '.join(data.inputs)[:80]}; expected one, such as delta, and v_x "
                "[m/s]: select them"
            )
        require_identifiable(data, len(data.outputs) + 1 + self.offset, scheduling=("v_x",))
        speeds = self.speeds or chosen_speeds(data["v_x"])
        if "chosen" not in (self.na, self.nb, self.nk):
            given: Any = self
            return self._of_orders(data, Orders(given.na, (given.nb,), (given.nk,)), speeds, began)
        choice = choose(data, na=self.na, nb=self.nb, nk=self.nk or 1, offset=self.offset, speeds=speeds)
        refused: ExcitationError | None = None
        for orders, _ in choice.ranked[:_TRIED]:
            try:
                found = {"candidates": choice.candidates}
                model = self._of_orders(data, orders, speeds, began, choice.said(orders) + "; ", **found)
            except ExcitationError as error:
                refused = refused or error
                continue
            driven = data.select(inputs=tuple(n for n in data.inputs if n != "v_x"), outputs=data.outputs)
            return noted(model, unstable_said(_poles(model), driven, self.offset))
        raise refused or ParameterError("no orders were compared")

    def _of_orders(
        self, data: Dataset, orders: Orders, speeds: tuple[float, ...], began: float, said: str = "", **found: Any
    ) -> MultiARXModel:
        ny, J = len(data.outputs), len(speeds)
        gram, count, shift, size = regression(data, orders, self.offset, speeds)
        p = orders.coefficients(ny, self.offset)
        if count < 2 * p * J:
            raise TooShortError(
                f"'{data.name}' gives {count} equations for {p * J} coefficients per output; expected at least twice "
                f"as many: record longer, or take fewer lags or speeds than {J}"
            )
        held = np.array([np.sum(w) for w in speed_weights(data["v_x"], speeds)])
        if held.min() < 2 * p:
            raise _left_open(data.name, speeds[int(np.argmin(held))])
        theta, inverse = _solved(gram, ny, speeds, p, data.name)
        left = gram[-ny:, -ny:] - gram[-ny:, :-ny] @ theta
        sigma = (left + left.T) / 2 / (count - p * J)
        to_si = np.concatenate([np.tile(size[:ny], orders.na), np.repeat(size[ny], orders.nb[0]), [1.0] * self.offset])
        slopes = theta.reshape(J, p, ny) * size[:ny] / to_si[:, None]
        shifts = np.concatenate([np.tile(shift[:ny], orders.na), np.repeat(shift[ny], orders.nb[0])])
        models = []
        for own in slopes:
            A = -own[: orders.na * ny].T.reshape(ny, orders.na, ny).transpose(1, 0, 2)
            B = own[orders.na * ny : orders.na * ny + orders.nb[0]][:, :, None]
            c = own[-1] + shift[:ny] - shifts @ own[:-1] if self.offset else np.zeros(ny)
            steering = next(n for n in data.inputs if n != "v_x")
            channel = channels(data) | {"inputs": (steering,)}
            models.append(ARXModel(A=A, B=B, c=c, nk=orders.nk[0], **channel))
        back = np.diag(1.0 / to_si)
        if self.offset:
            back[-1, :-1] = -shifts / to_si[:-1]
        whole = np.kron(np.eye(J), back)
        sigma = sigma * np.outer(size[:ny], size[:ny])
        info = described(
            data,
            began,
            names=tuple(
                f"{o} at {v:.3g} m/s: {n}" for o in data.outputs for v in speeds for n in self._labels(data, orders)
            ),
            values=np.array([_flat(m, o, self.offset) for o in range(ny) for m in models]).ravel(),
            covariance=np.kron(sigma, whole @ inverse @ whole.T),
            noise_std=np.sqrt(np.diag(sigma)),
            n_samples=count,
            region=replace(Region.of(data, ("v_x",)), beyond=HELD),
            method=f"{said}least squares on the blended model's one-step-ahead error; covariance for white residuals",
            **found,
        )
        model = MultiARXModel(models=tuple(models), speeds=speeds, fit_info=info)
        return noted(model, growth(_poles(model), data.n_longest))

    def _labels(self, data: Dataset, orders: Orders) -> list[str]:
        steering = next(n for n in data.inputs if n != "v_x")
        past = [f"{o}(k-{i})" for i in range(1, orders.na + 1) for o in data.outputs]
        return past + [f"{steering}(k-{orders.nk[0] + j})" for j in range(orders.nb[0])] + ["1"] * self.offset


def _poles(model: MultiARXModel) -> np.ndarray:
    """Those at all speeds."""
    return np.concatenate([m.poles for m in model.models])


def _flat(model: ARXModel, output: int, offset: bool) -> np.ndarray:
    """Coefficients of one output in the order of the regressors."""
    return np.concatenate([-model.A[:, output].ravel(), model.B[:, output, 0], model.c[[output]][: int(offset)]])


def _solved(gram: np.ndarray, ny: int, speeds: tuple[float, ...], p: int, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of scaled signals, and the inverse of their Gram matrix.

    Raises ExcitationError with the speed whose coefficients the data leave open most.
    """
    scale = np.sqrt(np.diag(gram))[:-ny]
    scale = np.where(scale > 0, scale, 1.0)
    left = gram[:-ny, :-ny] / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(left)
    if values[0] < 1e-10 * values[-1]:
        open_ = int(np.argmax(np.abs(vectors[:, 0]))) // p
        raise _left_open(name, speeds[open_])
    factor = linalg.cho_factor(left)
    theta = linalg.cho_solve(factor, gram[:-ny, -ny:] / scale[:, None]) / scale[:, None]
    return theta, linalg.cho_solve(factor, np.eye(len(left))) / np.outer(scale, scale)


def _left_open(name: str, v_x: float) -> ExcitationError:
    return ExcitationError(
        f"'{name}' leaves the coefficients at {v_x:.3g} m/s open; expected driving with excitation around every speed: "
        "give other speeds, or fewer lags"
    )


def chosen_speeds(v_x: np.ndarray) -> tuple[float, ...]:
    """Up to 6 speeds [m/s] about which the samples gather, at least 15 % apart, with about 500 samples or more each.

    None lies in a gap between speeds that were driven, where nothing would tell its coefficients. The first and the
    last reach to the ends of what was driven, beyond which a model has constant coefficients.
    """
    count = int(np.clip(len(v_x) // _PER_SPEED, 1, _MOST))
    rising = np.sort(v_x)
    sums = np.concatenate([[0.0], np.cumsum(rising)])
    centres = np.quantile(rising, (np.arange(count) + 0.5) / count)
    for _ in range(_ROUNDS):  # Lloyd's iteration: each centre becomes the mean of the samples next to it
        edges = np.concatenate([[0], np.searchsorted(rising, (centres[1:] + centres[:-1]) / 2), [len(rising)]])
        held = np.diff(edges) >= max(1, _PER_SPEED // 5)
        if not held.any():
            break
        means = (sums[edges[1:]] - sums[edges[:-1]])[held] / np.diff(edges)[held]
        done = len(means) == len(centres) and bool(np.all(np.abs(means - centres) <= 1e-6 * np.abs(centres)))
        centres = means
        if done:
            break
    kept: list[float] = []
    for v in centres.tolist():
        if not kept or v - kept[-1] > (_APART - 1) * abs(kept[-1]):
            kept.append(v)
        else:
            kept[-1] = (kept[-1] + v) / 2
    for i, end in ((0, rising[len(rising) // 500]), (-1, rising[-1 - len(rising) // 500])):
        if len(kept) > 1 and abs(end - kept[i]) > _REACH * abs(kept[i]):
            kept[i] = end
    return tuple(map(float, kept))
