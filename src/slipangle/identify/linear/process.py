"""Process models: gain, time constants, zero and delay in continuous time, by the free-run error.

.. [1] L. Ljung, System Identification, 2nd ed., 1999, sec. 4.3 and 7.
.. [2] G. H. Golub, V. Pereyra, SIAM J. Numerical Analysis 10(2), 1973: what is linear is solved for inside.
"""

from __future__ import annotations

import itertools
import re
import time
from dataclasses import dataclass

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.fields import Positive
from slipangle.identify.linear.continuous import SLOPE, HeldResponse, searched
from slipangle.identify.linear.estimator import LinearEstimator
from slipangle.models.black_box.continuous import ContinuousTimeModel
from slipangle.numerics.blas import one_blas_thread
from slipangle.numerics.least_squares import least_squares

_FORM = re.compile(r"P([123])(D?)(Z?)(I?)(U?)")
_TIMES, _DELAYS, _DAMPINGS = 8, 9, (0.15, 0.4, 0.8, 1.5)  # of the grid on which the search starts
_STARTS = 5


@dataclass(frozen=True, kw_only=True)
class ProcessModel(LinearEstimator[ContinuousTimeModel]):
    """``K (1 + T_z s) exp(-T_d s) / ((1 + T_p1 s) (1 + T_p2 s) ...)`` from one input to one output, in continuous time.

    The input is held over each sample and late by ``T_d``, of any part of a sample; the response is exact. Gain, zero,
    level and the state at the start of every experiment are solved for inside the search over time constants and delay
    ([2]_), which starts from the best points of a grid. The fit's parameters are K, T_p1, T_p2, T_p3 (or T_w and zeta),
    T_z, T_d with their intervals; the model is the sampled state space of them, past inputs being states.

    Parameters
    ----------
    form : str
        "P" and the number of poles, 1 to 3; then, in this order, "D" for a delay, "Z" for a zero (with two poles or
        more, the integrator counted), "I" for an integrator besides, and "U" where two of the poles are those of
        ``1 + 2 zeta T_w s + T_w^2 s^2``, so that they may oscillate. Such as "P1D" or "P2DZU".
    max_delay : float
        Largest delay. [s] Where the input before an experiment was not its first sample, so many seconds of its start
        are left out.

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 4.3, 7.

    For example ``sa.ProcessModel(form="P2DU").fit(train).fit_info``.
    """

    form: str = "P1D"
    max_delay: Positive = 1.0

    _what = "the process model"

    def __post_init__(self) -> None:
        super().__post_init__()
        shape = _FORM.fullmatch(self.form)
        poles = int(shape[1]) if shape else 0
        if not shape or (shape[5] and poles < 2) or (shape[3] and poles + bool(shape[4]) < 2):
            raise ParameterError(
                f"form is {self.form!r}; expected P1, P2 or P3 and then any of D, Z, I, U in this order, Z and U with "
                "two poles or more: such as 'P1D' or 'P2DZU'"
            )

    @one_blas_thread()
    def _fit(self, data: Dataset) -> ContinuousTimeModel:
        began = time.perf_counter()
        problem, point = searched(lambda cut: _Problem(self, data, cut=cut))
        units = tuple({"K": "-", "zeta": "-"}.get(n, "s") for n in problem.names)
        method = f"free-run error, variable projection from {_STARTS} points of a grid"
        return problem.fitted(point, began, method, units)


class _Problem(HeldResponse):
    """Lags one after the other; the search is over logarithms of times and damping, then the delay."""

    def __init__(self, settings: ProcessModel, data: Dataset, *, cut: bool) -> None:
        form = _FORM.fullmatch(settings.form)
        if form is None:
            raise ParameterError(f"form is {settings.form!r}; expected one such as 'P1D'")
        super().__init__(data, late=bool(form[2]), max_delay=settings.max_delay, cut=cut)
        self.zero, self.integrates, self.swings = (bool(form[k]) for k in (3, 4, 5))
        self.poles = int(form[1])
        own = ("T_w", "zeta") if self.swings else ()
        self.shape = (*own, *(f"T_p{i + 1}" for i in range(self.poles - len(own))))
        self.names = ("K", *self.shape, *(("T_z",) if self.zero else ()), *(("T_d",) if self.late else ()))
        self.order = self.poles + self.integrates
        short, long = np.log(0.1 * data.dt), np.log(10 * self.longest)
        low = [np.log(1e-3) if n == "zeta" else short for n in self.shape]
        high = [np.log(1e3) if n == "zeta" else long for n in self.shape]
        late = ([0.0], [self.max_delay]) if self.late else ([], [])
        self.low, self.high = np.array([*low, *late[0]]), np.array([*high, *late[1]])

    def rates(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A and B in continuous time: two poles that swing, lags one after the other, the integrator last."""
        n = self.order
        A, B = np.zeros((n, n)), np.zeros(n)
        k = 0
        if self.swings:
            T, zeta = shape[:2]
            A[:2, :2] = [[0.0, 1 / T], [-1 / T, -2 * zeta / T]]
            B[1] = 1 / T
            k = 2
        for T in shape[k:]:
            A[k, k] = -1 / T
            if k == 0:
                B[0] = 1 / T
            else:
                A[k, self._before(k)] = 1 / T
            k += 1
        if self.integrates:
            A[k, self._before(k)] = 1.0
        return A, B

    def _before(self, k: int) -> int:
        """The state that drives state k: of the two that swing the first."""
        return 0 if self.swings and k == 2 else k - 1

    @property
    def last(self) -> int:
        """The state that the gain multiplies."""
        return 0 if self.swings and self.order == 2 else self.order - 1

    def outputs(self, shape: np.ndarray) -> np.ndarray:
        """Rows of what the gain and gain times zero multiply, from the states."""
        row = np.eye(self.order)[[self.last]]
        return np.vstack([row, row @ self.rates(shape)[0]]) if self.zero else row

    def of_search(self, z: np.ndarray) -> np.ndarray:
        return np.exp(z)

    def search(self) -> np.ndarray:
        """The best point of the searches that start from the best of a grid."""
        times = np.log(np.geomspace(2 * self.dt, 0.25 * self.longest, _TIMES))
        own = [times, np.log(_DAMPINGS)] if self.swings else []
        lags = list(itertools.combinations_with_replacement(times[::-1], self.poles - len(own)))
        late = np.linspace(0.0, self.max_delay, _DELAYS) if self.late else np.zeros(1)
        grid = []
        for a in itertools.product(*own):
            for b in lags:
                grid += [np.clip([*a, *b, *([d] if self.late else [])], self.low, self.high) for d in late]
        costs = np.array([float(np.sum(self.errors(z) ** 2)) for z in grid])
        ends = []
        for k in np.argsort(costs, kind="stable")[:_STARTS]:
            bounds = self.low, self.high
            ends.append(least_squares(grid[k], errors=self.errors, jacobian=self.jacobian, bounds=bounds))
        best = min(ends, key=lambda e: e.cost).point
        first = 2 if self.swings else 0
        best[first : len(self.shape)] = np.sort(best[first : len(self.shape)])[::-1]
        return best

    def natural(self, z: np.ndarray) -> np.ndarray:
        times, delay = self.split(z)
        gains = self.solved(z)[0]
        zero = [gains[1] / gains[0]] if self.zero else []
        return np.array([gains[0], *times, *zero, *([delay] if self.late else [])])

    def parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        n = len(self.shape)
        gains = [values[0], *([values[0] * values[1 + n]] if self.zero else [])]
        return np.array(gains), values[1 : 1 + n], float(values[-1]) if self.late else 0.0

    def step(self, name: str, value: float) -> float:
        return SLOPE * (self.dt * 10 if name in ("T_d", "T_z") else max(abs(value), 1e-12))
