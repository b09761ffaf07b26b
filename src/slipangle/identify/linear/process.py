"""Process models: gain, time constants, zero and delay in continuous time, by the free-run error.

.. [1] L. Ljung, System Identification, 2nd ed., 1999, sec. 4.3 and 7.
.. [2] G. H. Golub, V. Pereyra, SIAM J. Numerical Analysis 10(2), 1973: what is linear is solved for inside.
"""

from __future__ import annotations

import itertools
import re
import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.fields import Positive
from slipangle.identify.linear.estimator import LinearEstimator, channels, described
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.numerics.blas import one_blas_thread
from slipangle.numerics.covariance import covariance
from slipangle.numerics.least_squares import least_squares
from slipangle.numerics.linear_response import LTI

_FORM = re.compile(r"P([123])(D?)(Z?)(I?)(U?)")
_TIMES, _DELAYS, _DAMPINGS = 8, 9, (0.15, 0.4, 0.8, 1.5)  # of the grid on which the search starts
_STARTS = 5
_SLOPE = 1e-5  # relative step of numerical derivatives


@dataclass(frozen=True, kw_only=True)
class ProcessModel(LinearEstimator[StateSpaceModel]):
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
        Largest delay. [s]

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
    def _fit(self, data: Dataset) -> StateSpaceModel:
        began = time.perf_counter()
        if len(data.inputs) != 1 or len(data.outputs) != 1:
            raise ParameterError(
                f"'{data.name}' has inputs {', '.join(data.inputs) or 'none'} and outputs "
                f"{', '.join(data.outputs) or 'none'}; expected one of each: data.select(inputs=[...], outputs=[...])"
            )
        problem = _Problem(self, data)
        best = problem.search()
        values = problem.natural(best)
        jacobian, error = problem.slopes(values)
        spread, said = covariance(error, jacobian, 1)
        count, names = len(values), problem.names
        dof = max(1, len(error) - jacobian.shape[1])
        notes = problem.ends(best)
        info = described(
            data,
            began,
            names=names,
            values=values,
            covariance=spread[:count, :count],
            noise_std=np.array([np.sqrt(float(error @ error) / dof)]),
            n_samples=data.n_samples,
            method=f"free-run error, variable projection from {_STARTS} points of a grid; {said}",
            warnings=notes,
        )
        units = tuple({"K": "-", "zeta": "-"}.get(n, "s") for n in names)
        return replace(problem.model(values), fit_info=replace(info, units=units))


class _Sampled(NamedTuple):
    """States one sample later: from states, from the input ``whole + 1`` and ``whole`` samples ago."""

    A: np.ndarray
    older: np.ndarray
    newer: np.ndarray
    whole: int


class _Problem:
    """One record and the order of the unknowns: logarithms of times and damping, then the delay."""

    def __init__(self, settings: ProcessModel, data: Dataset) -> None:
        shape = _FORM.fullmatch(settings.form)
        if shape is None:
            raise ParameterError(f"form is {settings.form!r}; expected one such as 'P1D'")
        self.late, self.zero, self.integrates, self.swings = (bool(shape[k]) for k in (2, 3, 4, 5))
        self.poles, self.data, self.dt = int(shape[1]), data, data.dt
        own = ("T_w", "zeta") if self.swings else ()
        self.shape = (*own, *(f"T_p{i + 1}" for i in range(self.poles - len(own))))
        self.names = ("K", *self.shape, *(("T_z",) if self.zero else ()), *(("T_d",) if self.late else ()))
        self.order = self.poles + self.integrates
        self.y, self.u = data.y[:, 0], data.u[:, 0]
        longest = max(b - a for a, b in zip(data.starts, data.stops, strict=True)) * data.dt
        short, long = np.log(0.1 * data.dt), np.log(10 * longest)
        low = [np.log(1e-3) if n == "zeta" else short for n in self.shape]
        high = [np.log(1e3) if n == "zeta" else long for n in self.shape]
        self.longest, self.max_delay = longest, min(settings.max_delay, 0.5 * longest)
        late = ([0.0], [self.max_delay]) if self.late else ([], [])
        self.low, self.high = np.array([*low, *late[0]]), np.array([*high, *late[1]])

    # ---- the system --------------------------------------------------------------------------------------------

    def rates(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A and B in continuous time: two poles that swing, lags one after the other, the integrator last."""
        n = self.order
        A, B = np.zeros((n, n)), np.zeros(n)
        k = 0
        if self.swings:
            T, zeta = times[:2]
            A[:2, :2] = [[0.0, 1 / T], [-1 / T, -2 * zeta / T]]
            B[1] = 1 / T
            k = 2
        for T in times[k:]:
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

    def sampled(self, times: np.ndarray, delay: float) -> _Sampled:
        A, B = self.rates(times)
        n = len(A)
        whole = int(np.floor(delay / self.dt + 1e-12))
        part = min(max(delay - whole * self.dt, 0.0), self.dt)
        block = np.zeros((n + 1, n + 1))
        block[:n, :n], block[:n, n] = A, B
        late, rest = (linalg.expm(block * h) for h in (part, self.dt - part))
        return _Sampled(rest[:n, :n] @ late[:n, :n], rest[:n, :n] @ late[:n, n], rest[:n, n], whole)

    def outputs(self, times: np.ndarray) -> np.ndarray:
        """Rows of what the gain and gain times zero multiply, from the states."""
        row = np.eye(self.order)[[self.last]]
        return np.vstack([row, row @ self.rates(times)[0]]) if self.zero else row

    def columns(self, times: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
        """What the linear unknowns multiply: those of the gain and the zero; then level and first states."""
        one, C = self.sampled(times, delay), self.outputs(times)
        system = LTI(A=one.A, B=np.column_stack([one.older, one.newer]), C=C, D=np.zeros((len(C), 2)))
        n, parts = self.order, list(zip(self.data.starts, self.data.stops, strict=True))
        forced, free = np.zeros((len(self.y), len(C))), np.zeros((len(self.y), n * len(parts)))
        for i, (a, b) in enumerate(parts):
            u = np.concatenate([np.full(one.whole + 1, self.u[a]), self.u[a:b]])[: b - a + 1]
            rest = np.linalg.lstsq(self.rates(times)[0], -self.rates(times)[1] * self.u[a], rcond=None)[0]
            start = np.zeros(n) if self.integrates else rest
            forced[a:b] = system.respond(start, np.column_stack([u[:-1], u[1:]]))[0][: b - a]
            rows, power = C[:1], one.A
            while len(rows) < b - a:
                rows, power = np.vstack([rows, rows @ power]), power @ power
            free[a:b, n * i : n * (i + 1)] = rows[: b - a]
        level = np.zeros((len(self.y), 0)) if self.integrates else np.ones((len(self.y), 1))
        return forced, np.hstack([level, free])

    # ---- the search --------------------------------------------------------------------------------------------

    def split(self, z: np.ndarray) -> tuple[np.ndarray, float]:
        return np.exp(z[: len(self.shape)]), float(z[-1]) if self.late else 0.0

    def solved(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear unknowns at their best, and the errors that are left."""
        forced, other = self.columns(*self.split(z))
        both = np.hstack([forced, other])
        size = np.maximum(np.linalg.norm(both, axis=0), 1e-300)
        found = np.linalg.lstsq(both / size, self.y, rcond=1e-10)[0] / size
        return found, self.y - both @ found

    def errors(self, z: np.ndarray) -> np.ndarray:
        found = self.solved(z)[1]
        return np.where(np.isfinite(found), found, 1e100)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        found = []
        for i in range(len(z)):
            h = _SLOPE * (1.0 if i < len(self.shape) else self.dt * 10)
            ends = np.clip([z + s * h * np.eye(len(z))[i] for s in (1, -1)], self.low, self.high)
            found.append((self.errors(ends[0]) - self.errors(ends[1])) / (ends[0][i] - ends[1][i]))
        return np.column_stack(found)

    def search(self) -> np.ndarray:
        times = np.log(np.geomspace(2 * self.dt, 0.25 * self.longest, _TIMES))
        own = [times, np.log(_DAMPINGS)] if self.swings else []
        lags = itertools.combinations_with_replacement(times[::-1], self.poles - len(own))
        late = np.linspace(0.0, self.max_delay, _DELAYS) if self.late else np.zeros(1)
        grid = []
        every = list(lags)
        for a in itertools.product(*own):
            for b in every:
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

    def ends(self, z: np.ndarray) -> tuple[str, ...]:
        """A sentence for each unknown that ended where it may go no further."""
        names = (*self.shape, *(("T_d",) if self.late else ()))
        at = np.minimum(z - self.low, self.high - z) < 1e-6 * (self.high - self.low)
        return tuple(
            f"{n} ended at the end of its range; the record does not tell it: leave it out of form, or allow more"
            for n, stuck, value in zip(names, at, z, strict=True)
            if stuck and not (n == "T_d" and value < 1e-9)
        )

    # ---- the result --------------------------------------------------------------------------------------------

    def natural(self, z: np.ndarray) -> np.ndarray:
        """Values of `names` at their best."""
        times, delay = self.split(z)
        gains = self.solved(z)[0]
        zero = [gains[1] / gains[0]] if self.zero else []
        return np.array([gains[0], *times, *zero, *([delay] if self.late else [])])

    def parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Gains of the outputs' rows, times, delay."""
        n = len(self.shape)
        gains = [values[0], *([values[0] * values[1 + n]] if self.zero else [])]
        return np.array(gains), values[1 : 1 + n], float(values[-1]) if self.late else 0.0

    def slopes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the output by the values of `names`, then by what else is linear; and the errors."""

        def output(v: np.ndarray) -> np.ndarray:
            gains, times, delay = self.parts(v)
            return self.columns(times, delay)[0] @ gains

        gains, times, delay = self.parts(values)
        forced, other = self.columns(times, delay)
        found = []
        for i, name in enumerate(self.names):
            h = _SLOPE * (self.dt * 10 if name in ("T_d", "T_z") else max(abs(values[i]), 1e-12))
            up, down = values.copy(), values.copy()
            up[i] += h
            down[i] -= h if name != "T_d" else min(h, values[i])
            found.append((output(up) - output(down)) / (up[i] - down[i]))
        rest = self.y - forced @ gains
        size = np.maximum(np.linalg.norm(other, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(other / size, full_matrices=False)
        basis = u[:, s > 1e-10 * s[0]]
        return np.column_stack([*found, basis]), rest - basis @ (basis.T @ rest)

    def model(self, values: np.ndarray) -> StateSpaceModel:
        """The sampled state space: the states, then past inputs, the newest first."""
        gains, times, delay = self.parts(values)
        one, C = self.sampled(times, delay), gains @ self.outputs(times)
        n, kept = self.order, one.whole + (np.abs(one.older).max() > 0)
        A, B = np.zeros((n + kept, n + kept)), np.zeros((n + kept, 1))
        A[:n, :n] = one.A
        for column, back in ((one.older, one.whole + 1), (one.newer, one.whole)):
            if back == 0:
                B[:n, 0] += column
            elif back <= kept:
                A[:n, n + back - 1] += column
        if kept:
            B[n, 0] = 1.0
            A[n + 1 :, n : n + kept - 1] += np.eye(kept - 1)
        forced, other = self.columns(times, delay)
        rest = np.linalg.lstsq(other, self.y - forced @ gains, rcond=1e-10)[0]
        level = 0.0 if self.integrates else float(rest[0])
        row = np.concatenate([C, np.zeros(kept)])[None]
        return StateSpaceModel(A=A, B=B, C=row, y_offset=np.array([level]), **channels(self.data))
