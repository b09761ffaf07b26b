"""Linear systems in continuous time behind a held, late input: their exact response, and a fit to it.

.. [1] G. H. Golub, V. Pereyra, SIAM J. Numerical Analysis 10(2), 1973: what is linear is solved for inside.
"""

from __future__ import annotations

import abc
import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from scipy import special

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, TooShortError
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.linear.estimator import channels, described
from slipangle.models.black_box.continuous import ContinuousTimeModel
from slipangle.numerics.covariance import covariance, loose_directions, unlimited
from slipangle.numerics.held import Late, late
from slipangle.numerics.linear_response import LTI

SLOPE = 1e-5  # relative step of numerical derivatives
_DOUBT = 0.9  # quantile of the F distribution from which an input is not taken for constant before its record


class HeldResponse(abc.ABC):
    """One record, and systems ``x' = A x + B u(t - T_d)``, ``y = gains @ C x`` whose A follows from `shape`.

    The input is held over each sample. The search is over ``z``: something for each of `shape`, then the delay;
    gains, level and the first state of every experiment are solved for inside ([1]_).

    A late input from before an experiment acts on its first samples, and nobody knows it. Unless ``cut``, it is taken
    for the first sample of the experiment; with ``cut`` as many samples are left out as the largest delay has, the same
    number for every delay, and the free state is that after them.
    """

    names: tuple[str, ...]  # of the values that a fit gives
    shape: tuple[str, ...]  # those that tell A and C
    order: int
    integrates: bool = False  # so that there is no level of rest
    low: np.ndarray  # smallest z
    high: np.ndarray  # largest z

    def __init__(self, data: Dataset, *, late: bool, max_delay: float, delay: float = 0.0, cut: bool = False) -> None:
        if len(data.inputs) != 1 or len(data.outputs) != 1:
            raise ParameterError(
                f"'{data.name}' has inputs {', '.join(data.inputs) or 'none'} and outputs "
                f"{', '.join(data.outputs) or 'none'}; expected one of each: data.select(inputs=[...], outputs=[...])"
            )
        self.data, self.dt, self.late, self.known = data, data.dt, late, delay
        self.longest = data.n_longest * data.dt
        self.max_delay = min(max_delay, 0.5 * self.longest)
        self.unknown = int(np.ceil((self.max_delay if late else delay) / data.dt - 1e-9))  # samples with such an input
        self.first = self.unknown if cut else 0
        parts = zip(data.starts, data.stops, strict=True)
        self.records = [(a, b) for a, b in parts if b - a > self.first]
        self.lengths = [b - a - self.first for a, b in self.records]
        ends = np.cumsum([0, *self.lengths])
        self.pieces = list(itertools.pairwise(ends))  # the same among the samples that are used
        self.u = data.u[:, 0]
        self.y = np.concatenate([np.zeros(0), *(data.y[a + self.first : b, 0] for a, b in self.records)])

    # ---- the system --------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def rates(self, shape: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A and B in continuous time, shapes (order, order), (order,)."""

    @abc.abstractmethod
    def outputs(self, shape: np.ndarray) -> np.ndarray:
        """Rows of what the gains multiply, from the states, shape (n_gains, order)."""

    def sampled(self, shape: np.ndarray, delay: float) -> Late:
        """The same over one sample, the input being held and late."""
        return late(*self.rates(shape), delay, self.dt)

    def columns(self, shape: np.ndarray, delay: float) -> tuple[np.ndarray, np.ndarray]:
        """What the linear unknowns multiply: those of the gains; then level and first states."""
        one, C = self.sampled(shape, delay), self.outputs(shape)
        system = LTI(A=one.A, B=np.column_stack([one.older, one.newer]), C=C, D=np.zeros((len(C), 2)))
        n, k = self.order, self.first
        forced, free = np.zeros((len(self.y), len(C))), np.zeros((len(self.y), n * len(self.pieces)))
        for i, ((a, b), (start, stop)) in enumerate(zip(self.records, self.pieces, strict=True)):
            u = np.concatenate([np.full(one.whole + 1, self.u[a]), self.u[a:b]])[k : b - a + 1]
            rest = np.linalg.lstsq(self.rates(shape)[0], -self.rates(shape)[1] * self.u[a], rcond=None)[0]
            before = np.zeros(n) if self.integrates else rest
            forced[start:stop] = system.respond(before, np.column_stack([u[:-1], u[1:]]))[0]
            free[start:stop, n * i : n * (i + 1)] = unforced(one.A, C[:1], stop - start)
        level = np.zeros((len(self.y), 0)) if self.integrates else np.ones((len(self.y), 1))
        return forced, np.hstack([level, free])

    # ---- the search --------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def of_search(self, z: np.ndarray) -> np.ndarray:
        """`shape` of a point of the search."""

    def split(self, z: np.ndarray) -> tuple[np.ndarray, float]:
        """`shape` and delay of a point of the search."""
        return self.of_search(z[: len(self.shape)]), float(z[-1]) if self.late else self.known

    def solved(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Linear unknowns at their best, and the errors that are left."""
        forced, other = self.columns(*self.split(z))
        both = np.hstack([forced, other])
        size = np.maximum(np.linalg.norm(both, axis=0), 1e-300)
        found = np.linalg.lstsq(both / size, self.y, rcond=1e-10)[0] / size
        return found, self.y - both @ found

    def errors(self, z: np.ndarray) -> np.ndarray:
        """Errors that are left at a point of the search, shape (n_samples,)."""
        found = self.solved(z)[1]
        return np.where(np.isfinite(found), found, 1e100)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Derivatives of `errors`, shape (n_samples, n)."""
        found = []
        for i in range(len(z)):
            h = SLOPE * (max(1.0, abs(z[i])) if i < len(self.shape) else self.dt * 10)
            ends = np.clip([z + s * h * np.eye(len(z))[i] for s in (1, -1)], self.low, self.high)
            found.append((self.errors(ends[0]) - self.errors(ends[1])) / (ends[0][i] - ends[1][i]))
        return np.column_stack(found)

    def ends(self, z: np.ndarray) -> tuple[str, ...]:
        """A sentence for each unknown that ended where it may go no further."""
        names = (*self.shape, *(("T_d",) if self.late else ()))
        at = np.minimum(z - self.low, self.high - z) < 1e-6 * (self.high - self.low)
        return tuple(
            f"{n} ended at the end of its range; the record does not tell it: leave it out of the model, or allow more"
            for n, stuck, value in zip(names, at, z, strict=True)
            if stuck and not (n == "T_d" and value < 1e-9)
        )

    # ---- the result --------------------------------------------------------------------------------------------

    def left_out(self) -> str:
        """What is taken for the input before an experiment, in words; empty where nothing of it acts."""
        if not self.unknown:
            return ""
        if not self.first:
            return ", the input before an experiment being its first sample"
        return f", without the first {self.first} samples of an experiment, on which the input before it acts"

    @abc.abstractmethod
    def natural(self, z: np.ndarray) -> np.ndarray:
        """Values of `names` at their best."""

    @abc.abstractmethod
    def parts(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Gains, `shape` and delay of such values."""

    @abc.abstractmethod
    def step(self, name: str, value: float) -> float:
        """By how much a value is moved for its derivative."""

    def slopes(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the output by the values of `names`, then by what else is linear; and the errors."""
        gains, shape, delay = self.parts(values)
        forced, other = self.columns(shape, delay)
        states = np.linalg.lstsq(other, self.y - forced @ gains, rcond=1e-10)[0]

        def output(v: np.ndarray) -> np.ndarray:
            gains, shape, delay = self.parts(v)
            forced, other = self.columns(shape, delay)
            return forced @ gains + other @ states  # how a first state fades tells of the poles too

        found = []
        for i, name in enumerate(self.names):
            h = self.step(name, values[i])
            up, down = values.copy(), values.copy()
            up[i] += h
            down[i] -= h if name != "T_d" else min(h, values[i])
            found.append((output(up) - output(down)) / (up[i] - down[i]))
        rest = self.y - forced @ gains
        size = np.maximum(np.linalg.norm(other, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(other / size, full_matrices=False)
        basis = u[:, s > 1e-10 * s[0]]
        return np.column_stack([*found, basis]), rest - basis @ (basis.T @ rest)

    def fitted(self, z: np.ndarray, began: float, method: str, units: tuple[str, ...]) -> ContinuousTimeModel:
        """The model of a point of the search, with intervals of `names`."""
        values = self.natural(z)
        jacobian, error = self.slopes(values)
        spread, said = covariance(error, jacobian, 1, lengths=self.lengths)
        count = len(values)
        loose = loose_directions(jacobian)[:count]
        known, loose = spread[:count, :count], loose[:, loose.any(axis=0)]
        dof = max(1, len(error) - jacobian.shape[1])
        info = described(
            self.data,
            began,
            names=self.names,
            values=values,
            covariance=unlimited(known, loose),
            noise_std=np.array([np.sqrt(float(error @ error) / dof)]),
            n_samples=len(error),
            method=f"{method}{self.left_out()}; {said}",
            warnings=self.ends(z),
            loose=loose if loose.size else None,
            known_covariance=known if loose.size else None,
        )
        return replace(self.model(values), fit_info=replace(info, units=units, seconds=time.perf_counter() - began))

    def model(self, values: np.ndarray) -> ContinuousTimeModel:
        """The system of such values, and how it moves with them."""
        gains, shape, delay = self.parts(values)
        forced, other = self.columns(shape, delay)
        rest = np.linalg.lstsq(other, self.y - forced @ gains, rcond=1e-10)[0]
        level = 0.0 if self.integrates else float(rest[0])
        found = []
        for i, name in enumerate(self.names):
            h = self.step(name, values[i])
            ends = [self._entries(values + s * h * np.eye(len(values))[i]) for s in (1, -1)]
            found.append((ends[0] - ends[1]) / (2 * h))
        others: dict[str, Any] = {"y_offset": np.array([level]), "slopes": np.array(found), **channels(self.data)}
        (F, G), H = self.rates(shape), gains @ self.outputs(shape)
        return ContinuousTimeModel.of(F, G, H, delay=delay, **others)

    def _entries(self, values: np.ndarray) -> np.ndarray:
        """Entries of F, G, H and the delay, one after the other."""
        gains, shape, delay = self.parts(values)
        F, G = self.rates(shape)
        return np.concatenate([F.ravel(), G, gains @ self.outputs(shape), [delay]])


R = TypeVar("R", bound=HeldResponse)


def searched(problem: Callable[[bool], R]) -> tuple[R, np.ndarray]:
    """The problem to take, and the best point of its search: uncut, unless the first samples tell against that.

    ``problem`` makes it, cut or not. Errors of the samples whose input is unknown, taken for constant, must not be
    larger than the others are, by an F test; where they are left out though they need not be, little is lost.

    Raises ExcitationError or TooShortError where the data cannot tell, or too few samples are left without them.
    """
    cut = problem(True)
    require_identifiable(cut.data, len(cut.names))
    if not cut.unknown:
        return cut, cut.search()
    n, least = len(cut.y), len(cut.names) + cut.order * len(cut.pieces) + 2
    if n < least:
        raise TooShortError(
            f"'{cut.data.name}' has {n} samples beyond the first {cut.first} of each experiment, on which an unknown "
            f"input from before it acts, for {len(cut.names)} parameters; expected at least {least}: record longer, or "
            "give a shorter delay"
        )
    whole = problem(False)
    ends = [(one, one.search()) for one in (cut, whole)]
    (_, few), (_, all_) = ((one, float(np.sum(one.errors(z) ** 2))) for one, z in ends)
    more, dof = len(whole.y) - n, n - least + 1
    doubt = (all_ - few) / more > special.fdtri(more, dof, _DOUBT) * few / dof
    return ends[0] if doubt else ends[1]


def unforced(A: np.ndarray, C: np.ndarray, n: int) -> np.ndarray:
    """``C A^k`` for k below n, shape (n, n_states), C being one row."""
    rows, power = C, A
    while len(rows) < n:
        rows, power = np.vstack([rows, rows @ power]), power @ power
    return rows[:n]
