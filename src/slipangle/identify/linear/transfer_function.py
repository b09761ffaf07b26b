"""Transfer functions in continuous time by the free-run error, started by refined instrumental variables.

.. [1] P. C. Young, A. J. Jakeman, Refined instrumental variable methods of recursive time-series analysis, part III,
   Int. J. Control 31(4), 1980.
.. [2] H. Garnier, L. Wang (eds.), Identification of Continuous-time Models from Sampled Data, Springer, 2008, ch. 4.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from dataclasses import dataclass

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ExcitationError, ParameterError
from slipangle.fields import Count, NotNegative, Positive, Whole
from slipangle.identify.linear.continuous import SLOPE, HeldResponse, searched, unforced
from slipangle.identify.linear.estimator import LinearEstimator
from slipangle.models.black_box.continuous import ContinuousTimeModel
from slipangle.numerics.blas import one_blas_thread
from slipangle.numerics.least_squares import least_squares
from slipangle.numerics.linear_response import LTI

_DELAYS, _CORNERS = 6, 5  # of the grid on which the start is looked for
_ROUNDS, _STARTS = 5, 3  # how often instruments refine each of its points; points that the search starts from
_GROWTH = 30.0  # largest real part of a pole times the length of an experiment
_UNSTABLE = 3.0  # such a product from which a stable system is looked for, too
_BEYOND_CHANCE = 14.0  # twice the log-likelihood by which an unstable one has to be better
_FAR = 1e8  # scaled coefficients are smaller


@dataclass(frozen=True, kw_only=True)
class TransferFunction(LinearEstimator[ContinuousTimeModel]):
    """``(b_m s^m + ... + b_0) exp(-T_d s) / (s^n + a_(n-1) s^(n-1) + ... + a_0)``, one input to one output.

    The input is held over each sample and late by ``T_d``, of any part of a sample; the response is exact. Numerator,
    level and the state at the start of every experiment are solved for inside the search over denominator and delay,
    so that noisy outputs do not bias them. It starts from the best of a grid of delays and filters, refined by
    instrumental variables ([1]_, [2]_). Where a stable system explains the data as well as one that grows far over
    them, it is the stable one. The fit's parameters are a_0 to a_(n-1), b_0 to b_m, T_d with their intervals;
    the model is the sampled state space of them, past inputs being states.

    Parameters
    ----------
    poles : int
        Their number, n.
    zeros : int, optional
        Their number, m, smaller than that of the poles; by default one fewer.
    delay : float, optional
        ``T_d`` where it is known; by default it is estimated. [s]
    max_delay : float
        Largest delay that is estimated. [s] Where the input before an experiment was not its first sample, so many
        seconds of its start are left out.

    Source: P. C. Young, A. J. Jakeman, Int. J. Control 31(4), 1980; H. Garnier, L. Wang, Identification of
    Continuous-time Models from Sampled Data, 2008, ch. 4.

    For example ``sa.TransferFunction(poles=2, zeros=1).fit(train).fit_info``.
    """

    poles: Count = 2
    zeros: Whole | None = None
    delay: NotNegative | None = None
    max_delay: Positive = 0.5

    _what = "the transfer function"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.zeros is not None and self.zeros >= self.poles:
            raise ParameterError(
                f"zeros is {self.zeros} with {self.poles} poles; expected fewer zeros than poles: the output of a "
                "vehicle does not jump with its input"
            )

    @one_blas_thread()
    def _fit(self, data: Dataset) -> ContinuousTimeModel:
        began = time.perf_counter()
        problem, point = searched(lambda cut: _Problem(self, data, cut=cut))
        units = tuple(problem.unit(name) for name in problem.names)
        method = f"free-run error, variable projection from {_STARTS} points refined by instrumental variables"
        return problem.fitted(point, began, method, units)


class _Problem(HeldResponse):
    """The controllable form in scaled time; the search is over the scaled denominator, then the delay."""

    def __init__(self, settings: TransferFunction, data: Dataset, *, cut: bool) -> None:
        late = settings.delay is None
        known = settings.delay or 0.0
        super().__init__(data, late=late, max_delay=settings.max_delay, delay=known, cut=cut)
        self.order = n = settings.poles
        self.gains = n if settings.zeros is None else settings.zeros + 1
        self.shape = tuple(f"a_{i}" for i in range(n))
        self.names = (*self.shape, *(f"b_{j}" for j in range(self.gains)), *(("T_d",) if late else ()))
        self.scale = 1.0  # rad/s
        self.growth = _GROWTH
        ends = ([0.0], [self.max_delay]) if late else ([], [])
        self.low, self.high = np.array([*[-_FAR] * n, *ends[0]]), np.array([*[_FAR] * n, *ends[1]])

    def unit(self, name: str) -> str:
        """Unit of a value, the output over the input apart."""
        if name == "T_d":
            return "s"
        power = self.order - int(name[2:])
        return "1/s" if power == 1 else f"1/s{power}"

    # ---- the system --------------------------------------------------------------------------------------------

    def rates(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n = self.order
        A, B = np.zeros((n, n)), np.zeros(n)
        A[:-1, 1:] = self.scale * np.eye(n - 1)
        A[-1] = -shape * self.scale ** (np.arange(n) - n + 1.0)
        B[-1] = self.scale
        return A, B

    def outputs(self, shape: np.ndarray) -> np.ndarray:
        """Derivatives of what the denominator lets through, scaled."""
        return np.eye(self.order)[: self.gains]

    def of_search(self, z: np.ndarray) -> np.ndarray:
        return z * self._scales()

    def _scales(self) -> np.ndarray:
        return self.scale ** (self.order - np.arange(self.order, dtype=float))

    def errors(self, z: np.ndarray) -> np.ndarray:
        if self._poles(self.split(z)[0]).real.max() * self.longest > self.growth:
            return np.full(len(self.y), 1e100)
        return super().errors(z)

    @staticmethod
    def _poles(shape: np.ndarray) -> np.ndarray:
        return np.roots([1.0, *shape[::-1]])

    # ---- the start ---------------------------------------------------------------------------------------------

    def search(self) -> np.ndarray:
        """The best point; of a stable system, unless an unstable one is better beyond chance.

        A pole that grows and a zero that all but cancels it change the errors by nothing, while the free run of such a
        model leaves every record.
        """
        cost, scale, point = self._best()
        self.scale = scale
        if self._poles(self.split(point)[0]).real.max() * self.longest > _UNSTABLE:
            self.growth = 0.0
            with contextlib.suppress(ExcitationError):
                other = self._best()
                if len(self.y) * np.log(other[0] / cost) < _BEYOND_CHANCE:
                    cost, scale, point = other
        self.scale, self.growth = scale, _GROWTH
        return point

    def _best(self) -> tuple[float, float, np.ndarray]:
        """Cost, scale and point of the best of the searches that start from the best of the grid."""
        corners = np.geomspace(3 / self.longest, 1 / self.dt, _CORNERS)
        late = np.linspace(0.0, self.max_delay, _DELAYS) if self.late else [self.known]
        found = []
        for corner, d in itertools.product(corners, late):
            a = self.equation(np.poly(np.full(self.order, -corner))[:0:-1], d)
            for _ in range(_ROUNDS):
                a, before = self._settled(self.equation(a, d, refine=True)), a
                if np.allclose(a, before, rtol=0.01):
                    break
            found.append((self.cost(a, d), a, d))
        found = [each for each in sorted(found, key=lambda e: e[0]) if np.isfinite(each[0])]
        if not found:
            raise ExcitationError(
                f"no transfer function of {self.order} poles follows '{self.data.outputs[0]}' of '{self.data.name}'; "
                "expected an input that moves it: fewer poles, or another record"
            )
        ends, taken = [], []
        for _, a, d in found:  # of the neighbours on the grid one each
            near = any(abs(d - other) < 1e-12 and np.allclose(a, own, rtol=0.05) for own, other in taken)
            if near or len(taken) == _STARTS:
                continue
            taken.append((a, d))
            self.scale = float(np.exp(np.mean(np.log(np.abs(self._poles(a)))))) if a[0] else 1.0
            z = np.clip([*(a / self._scales()), *([d] if self.late else [])], self.low, self.high)
            end = least_squares(z, errors=self.errors, jacobian=self.jacobian, bounds=(self.low, self.high))
            ends.append((end.cost, self.scale, end.point))
        return min(ends, key=lambda e: e[0])

    def cost(self, a: np.ndarray, delay: float) -> float:
        """Sum of squared errors of a denominator and delay; infinite where its poles are out of reach."""
        poles = self._poles(a)
        if not np.isfinite(a).all() or poles.real.max() * self.longest > self.growth:
            return np.inf
        self.scale = 1.0
        found = float(np.sum(self.errors(np.array([*a, *([delay] if self.late else [])])) ** 2))
        return found if np.isfinite(found) and found < 1e100 else np.inf

    def equation(self, filter: np.ndarray, delay: float, *, refine: bool = False) -> np.ndarray:
        """Denominator, shape (n,), by the differential equation through a filter 1 / (s^n + ...) of these coefficients.

        By least squares, or with the derivatives of the model's own output as instruments.
        """
        self.scale = 1.0
        filter = self._settled(filter)
        seen, last, free = self._derivatives(filter, self.y)
        moved = self.columns(filter, delay)[0]
        rows = np.hstack([-seen, moved, np.ones((len(last), 1)), free])
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        rows = rows / size
        if refine:
            gains = self.solved(np.array([*filter, *([delay] if self.late else [])]))[0][: self.gains]
            instruments = rows.copy()
            instruments[:, : self.order] = -self._derivatives(filter, moved @ gains)[0] / size[: self.order]
            left, right = instruments.T @ rows, instruments.T @ last
        else:
            left, right = rows, last
        if not (np.isfinite(left).all() and np.isfinite(right).all()):
            return np.full(self.order, np.nan)
        return (np.linalg.lstsq(left, right, rcond=1e-12)[0] / size)[: self.order]

    def _settled(self, a: np.ndarray) -> np.ndarray:
        """The same with poles that decay, neither slower than the record nor much faster than its samples."""
        if not np.isfinite(a).all():
            return np.poly(np.full(self.order, -1 / self.dt))[:0:-1]
        poles = self._poles(a)
        size = np.clip(np.abs(poles), 0.1 / self.longest, 10 / self.dt)
        turned = np.where(np.abs(poles) > 0, poles / np.maximum(np.abs(poles), 1e-300), -1.0) * size
        turned = np.minimum(turned.real, -0.01 * size) + 1j * turned.imag
        return np.real(np.poly(turned))[:0:-1]

    def _derivatives(self, a: np.ndarray, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Filtered derivatives of a signal, 0 to n - 1 and n, and what a state at the start adds to the latter."""
        one, n = self.sampled(a, 0.0), self.order
        system = LTI(A=one.A, B=one.newer[:, None], C=np.eye(n), D=np.zeros((n, 1)))
        found, free = np.zeros((len(signal), n)), np.zeros((len(signal), n * len(self.pieces)))
        for i, (b, e) in enumerate(self.pieces):
            own = signal[b:e] - signal[b]
            between = 0.5 * (own + np.append(own[1:], own[-1]))  # its mean over each sample
            found[b:e] = system.respond(np.zeros(n), between[:, None])[0]
            free[b:e, n * i : n * (i + 1)] = unforced(one.A, np.eye(n)[:1], e - b)
        start = np.repeat([signal[b] for b, _ in self.pieces], self.lengths)
        return found, signal - start - found @ a, free

    # ---- the result --------------------------------------------------------------------------------------------

    def natural(self, z: np.ndarray) -> np.ndarray:
        shape, delay = self.split(z)
        gains = self.solved(z)[0][: self.gains] * self._gain_scales()
        return np.array([*shape, *gains, *([delay] if self.late else [])])

    def _gain_scales(self) -> np.ndarray:
        """Of the scaled states' gains: x_j is scale^(n - j) times the j-th derivative of u through the denominator."""
        return self.scale ** (self.order - np.arange(self.gains, dtype=float))

    def parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        n = self.order
        gains = values[n : n + self.gains] / self._gain_scales()
        return gains, values[:n], float(values[-1]) if self.late else self.known

    def step(self, name: str, value: float) -> float:
        if name == "T_d":
            return SLOPE * 10 * self.dt
        scales = self._scales() if name in self.shape else self._gain_scales()
        return SLOPE * max(abs(value), 0.01 * scales[int(name[2:])])
