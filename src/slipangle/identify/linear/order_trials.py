"""What candidates of ARX models come to: fits and free runs over stretches that they have not seen.

One pass over the data makes the Gram matrix of the largest regressor, held-out group by held-out group; every smaller
candidate and every fold is a block of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import TooShortError
from slipangle.identify.linear.candidate_fits import Fits
from slipangle.identify.linear.candidate_runs import Stretches
from slipangle.identify.linear.estimator import criteria
from slipangle.identify.linear.lags import Windows
from slipangle.identify.linear.neighbours import Orders
from slipangle.identify.linear.speed_blocks import SpeedBlocks, gram_of_speeds
from slipangle.models.model import Candidate
from slipangle.models.wrappers.multi_arx import speed_weights

FOLDS, BLOCKS = 5, 20  # groups held out in turn; stretches that they are made of where a record is one
LENGTH = 1000  # samples of a stretch that free runs are judged on, from its beginning
_TIE, _EXACT = 1.01, 1e-6  # errors apart by less, or below, are alike: the fewest coefficients win


@dataclass(frozen=True)
class Choice:
    """Everything that was compared, the winner first."""

    ranked: tuple[tuple[Orders, Candidate], ...]

    def said(self, orders: Orders) -> str:
        """What was done, for the method's line."""
        return f"{orders.said}, chosen of {len(self.ranked)} by free run over stretches held out in turn"

    @property
    def candidates(self) -> tuple[Candidate, ...]:
        """For the model's `FitInfo`."""
        return tuple(candidate for _, candidate in self.ranked)


def stretches(data: Dataset, reach: int) -> list[tuple[int, int]]:
    """First and last-but-one row of the stretches: the experiments, cut where there are few, that hold a free run."""
    spans = [(a, b) for a, b in zip(data.starts, data.stops, strict=True) if b - a > 2 * reach]
    wanted = -(-BLOCKS // max(len(spans), 1)) if len(spans) < 2 * FOLDS else 1
    found = []
    for a, b in spans:
        pieces = int(np.clip((b - a) // (4 * (reach + 1)), 1, wanted))
        edges = np.linspace(a, b, pieces + 1).astype(int).tolist()
        found += list(pairwise(edges))
    return found


def regression(
    data: Dataset, orders: Orders, offset: bool, speeds: Sequence[float]
) -> tuple[np.ndarray, int, np.ndarray, np.ndarray]:
    """Normal equations of all data for one choice, their number, what was taken off the signals and their sizes.

    The Gram matrix is that of the regressors at every speed, then of the targets; signals are outputs, then inputs.

    Raises TooShortError if no experiment is longer than the lags reach back.
    """
    trials = Trials(data, orders, offset, speeds, judged=False)
    p = trials.n_columns
    pick = (np.arange(len(trials.speeds))[:, None] * p + trials._pick(orders)).ravel()
    pick = np.concatenate([pick, len(trials.speeds) * p + np.arange(trials.ny)])
    gram = trials.gram.sum(axis=0)
    return gram[np.ix_(pick, pick)], int(trials.count.sum()), trials.shift, trials.size


class Trials:
    """Gram matrices of every held-out group, the stretches to run over, and what came out for each candidate.

    Signals are divided by their standard deviations, after their means are taken off where there is a constant.
    """

    def __init__(
        self, data: Dataset, widest: Orders, offset: bool, speeds: Sequence[float], *, judged: bool = True
    ) -> None:
        self.inputs = tuple(n for n in data.inputs if n != "v_x" or not speeds)
        self.data, self.offset, self.speeds = data, offset, tuple(speeds) or (0.0,)
        self.ny, self.nu, self.reach, self.na = len(data.outputs), len(self.inputs), widest.reach, widest.na
        self.names = (*data.outputs, *self.inputs)
        size = np.array([np.std(data[n]) for n in self.names])
        self.shift = np.array([data[n].mean() if offset else 0.0 for n in self.names])
        self.size = np.where(size > 0, size, 1.0)
        whole = [(a, b) for a, b in zip(data.starts, data.stops, strict=True) if b - a > self.reach]
        blocks = stretches(data, self.reach) if judged else whole
        if not blocks:
            raise TooShortError(
                f"no experiment of '{data.name}' is longer than the {self.reach} samples that the lags reach back; "
                "expected a longer one: record without gaps or choose fewer lags"
            )
        self.folds = min(FOLDS, len(blocks))
        self.groups = np.arange(len(blocks)) % self.folds
        self.columns = self._columns()
        width = len(self.speeds) * self.n_columns + self.ny
        self.gram, self.count = np.zeros((self.folds, width, width)), np.zeros(self.folds)
        for group in range(self.folds):
            self.gram[group], self.count[group] = self._gram(tuple(blocks[group :: self.folds]))
        if judged:
            self.stretches = self._stretches(blocks)
            self.spread = np.maximum(np.std(self.stretches.wanted[self.stretches.known], axis=0), 1e-300)
        self.longest = data.n_longest
        self.done: dict[Orders, Candidate] = {}
        self._order: list[Orders] = []  # `_ranked`, until more are judged

    def _columns(self) -> list[tuple[int, int]]:
        """Samples back and signal of each regressor: past outputs, inputs from the present on, newest first."""
        past = [(i, c) for i in range(1, self.na + 1) for c in range(self.ny)]
        return past + [(j, self.ny + i) for j in range(self.reach + 1) for i in range(self.nu)]

    @property
    def n_columns(self) -> int:
        """Regressors of the largest model at one speed."""
        return self.na * self.ny + (self.reach + 1) * self.nu + self.offset

    def _pick(self, orders: Orders) -> np.ndarray:
        """Columns of a candidate at one speed."""
        first = self.na * self.ny
        each = enumerate(zip(orders.nb, orders.nk, strict=True))
        inputs = sorted(first + (k + j) * self.nu + i for i, (b, k) in each for j in range(b))
        return np.array([*range(orders.na * self.ny), *inputs] + [self.n_columns - 1] * self.offset)

    def _gram(self, blocks: tuple[tuple[int, int], ...]) -> tuple[np.ndarray, int]:
        """Of the regressors, at every speed, then of the targets."""
        windows = Windows(data=self.data, names=self.names, lags=self.reach + 1, shift=self.shift, stretches=blocks)
        if len(self.speeds) > 1:
            shared: Any = (windows, self.columns, self.ny, self.speeds, self.size)
            return gram_of_speeds(*shared, constant=self.offset), windows.count
        m, nc, p = self.reach, self.ny + self.nu, len(self.columns)
        pick = [(m - lag) * nc + c for lag, c in self.columns] + [m * nc + c for c in range(self.ny)]
        scale = np.tile(self.size, m + 1)
        products, sums = windows.gram()
        gram, at = (products / np.outer(scale, scale))[np.ix_(pick, pick)], (sums / scale)[pick]
        if self.offset:
            gram = np.insert(np.insert(gram, p, at, axis=0), p, np.insert(at, p, windows.count), axis=1)
        return gram, windows.count

    def _stretches(self, blocks: Sequence[tuple[int, int]]) -> Stretches:
        m, several = self.reach, [(a, min(b, a + LENGTH)) for a, b in blocks]
        lengths = np.array([b - a - m for a, b in several])
        signals = np.zeros((len(blocks), m + lengths.max(), self.ny + self.nu + 1))
        v_x = np.zeros((len(blocks), lengths.max()))
        for s, (a, b) in enumerate(several):
            for c, name in enumerate(self.names):
                signals[s, : b - a, c] = (self.data[name][a:b] - self.shift[c]) / self.size[c]
            if len(self.speeds) > 1:
                v_x[s, : lengths[s]] = self.data["v_x"][a + m - 1 : b - 1]
        signals[:, :, -1] = 1.0
        return Stretches(
            signals=signals,
            weights=np.stack(speed_weights(v_x, self.speeds), axis=2),
            lengths=lengths,
            group=self.groups,
            columns=np.array([*self.columns, *[(0, self.ny + self.nu)] * self.offset]),
            lags=self.na,
            n_outputs=self.ny,
        )

    # ---- candidates --------------------------------------------------------------------------------------------------

    def add(self, orders: Iterable[Orders]) -> None:
        """Judge those that were not yet, as far as the data carry them."""
        room = (self.count.sum() - self.count.max()) / 3
        fresh = [o for o in dict.fromkeys(orders) if o not in self.done and o.reach <= self.reach and o.na <= self.na]
        fresh = [o for o in fresh if o.coefficients(self.ny, self.offset) * len(self.speeds) <= room]
        self._order = [] if fresh else self._order
        each = max(1, int(2e7 // max(1, self.stretches.wanted.size)))
        for a in range(0, len(fresh), each):
            self._judge(fresh[a : a + each])
        if not self.done:
            raise TooShortError(
                f"'{self.data.name}' has {int(self.count.sum())} equations for its smallest candidate; expected at "
                "least three per coefficient: record longer, or take fewer speeds"
            )

    def _judge(self, several: Sequence[Orders]) -> None:
        J, ny, n = len(self.speeds), self.ny, self.count.sum()
        picks = [self._pick(orders) for orders in several]
        theta, left, unseen = self._solved(picks)
        free = self._free_run(theta[:, :-1], picks)
        one_step = np.mean(np.sqrt(np.maximum(unseen / n, 0.0)) / self.spread, axis=1)
        log_det = np.linalg.slogdet(left / n)[1]
        lasting = self._lasting(theta[:, -1])
        for c, orders in enumerate(several):
            d = orders.coefficients(ny, self.offset) * J * ny
            self.done[orders] = Candidate(
                orders=orders.said,
                n_parameters=d,
                error=float(free[c]) if np.isfinite(free[c]) else np.inf,
                one_step_error=float(one_step[c]),
                **criteria(float(log_det[c]), d, n),
                stable=bool(lasting[c]),
            )

    def _free_run(self, theta: np.ndarray, picks: Sequence[np.ndarray]) -> np.ndarray:
        """RMSE over standard deviation, mean over outputs, of each candidate's runs, shape (n_candidates,).

        Coefficients of every fold have shape (n_candidates, n_folds, n_speeds, n_columns, n_outputs).
        """
        squares = self.stretches.squares(theta, picks)
        with np.errstate(over="ignore", invalid="ignore"):
            return np.mean(np.sqrt(squares / self.stretches.lengths.sum()) / self.spread, axis=1)

    @cached_property
    def _fits(self) -> tuple[Fits, np.ndarray, np.ndarray]:
        """Without each group, then of all, tested on each, then all; lengths of columns; the targets' products."""
        each = np.concatenate([self.gram, self.gram.sum(axis=0, keepdims=True)])
        blocks = SpeedBlocks.of(each, len(self.speeds), self.n_columns)
        lengths = blocks.lengths
        tested = blocks.over(lengths)
        return Fits(tested.others(), tested), lengths, each[:, -self.ny :, -self.ny :]

    def _solved(self, picks: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each candidate: coefficients fitted without each group, then to all; residual products; squares unseen.

        Shapes (n, n_folds + 1, n_speeds, n_columns, n_outputs), (n, n_outputs, n_outputs), (n, n_outputs).
        """
        fits, lengths, targets = self._fits
        theta, rise = fits.of(picks)
        residual = targets + rise
        left = (residual[:, -1] + residual[:, -1].swapaxes(1, 2)) / 2
        return theta / lengths[:, :, None], left, np.diagonal(residual[:, :-1], axis1=2, axis2=3).sum(axis=1)

    def _lasting(self, theta: np.ndarray) -> np.ndarray:
        """Whether no model of a candidate, at any speed, grows tenfold over the longest experiment; (n_candidates,)."""
        ny, na, edge = self.ny, self.na, 10.0 ** (1.0 / self.longest)
        own = theta[:, :, : na * ny]
        if ny > 1:
            companions = np.tile(np.eye(na * ny, k=-ny), (*own.shape[:2], 1, 1))
            companions[:, :, :ny] = own.swapaxes(2, 3)
            return np.all(np.abs(np.linalg.eigvals(companions)) < edge, axis=(1, 2))
        left, inside = -own[..., 0] / edge ** np.arange(1.0, na + 1), np.ones(len(theta), dtype=bool)
        with np.errstate(all="ignore"):
            for _ in range(na):  # Schur and Cohn: all poles are inside if all reflection coefficients are
                last, rest = left[..., -1:], left[..., :-1]
                inside &= np.all(np.abs(last) < 1, axis=(1, 2))
                left = (rest - last * rest[..., ::-1]) / (1 - last**2)
        return inside

    # ---- the winner --------------------------------------------------------------------------------------------------

    def _ranked(self) -> list[Orders]:
        """The best first; those that would blow up last."""
        if self._order:
            return self._order
        judged = list(self.done.items())
        sure = [c.stable and np.isfinite(c.error) for _, c in judged]
        if not any(sure):
            sure = [True] * len(judged)
        least = min(c.error for (_, c), holds in zip(judged, sure, strict=True) if holds)
        alike = [holds and c.error <= _TIE * max(least, _EXACT) for (_, c), holds in zip(judged, sure, strict=True)]
        place = [
            (not a, not holds, c.n_parameters if a else 0, c.error, o.na, o.nb, o.nk)
            for (o, c), holds, a in zip(judged, sure, alike, strict=True)
        ]
        self._order = [judged[i][0] for i in sorted(range(len(judged)), key=place.__getitem__)]
        return self._order

    @property
    def best(self) -> Orders:
        """So far."""
        return self._ranked()[0]

    def choice(self, waits: Sequence[int]) -> Choice:
        """The outcome, of inputs that wait so long beside what is in the data."""
        later = [(o, o.later(waits)) for o in self._ranked()]
        return Choice(tuple((own, replace(self.done[o], orders=own.said)) for o, own in later))

    def by_stretch(self, orders: Orders) -> np.ndarray:
        """Mean squared error over variance of a candidate's run over each stretch, shape (n_stretches,)."""
        theta = self._solved([self._pick(orders)])[0][:, :-1]
        squares = self.stretches.each(theta)[0] / self.stretches.lengths
        return np.mean(squares / self.spread[:, None] ** 2, axis=0)
