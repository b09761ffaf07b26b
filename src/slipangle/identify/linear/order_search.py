"""Which order of several to take, by errors on held-out data of which the better known ones cost more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from slipangle.identify.linear.predictor import Work
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.model import Candidate
from slipangle.shown import Shown

ROUGH = 1e-3  # share of the squared error by which a refinement's last step lowers it: as many again make 1 %
FINISHED = 0.0  # the same of a refinement to the end
HOPELESS = 1.2  # error over the least, from which on an order is out of question
TIE = 1.01  # error over another, below which they are alike
_CLOSE = 1e-5  # share by which a closely judged order's last step lowers its squared error
_OPEN = 2e-3  # share of the error that a rough refinement may leave open
_EXACT = 1e-6  # error in standard deviations of the outputs, below which orders differ by rounding
_FITS = 4.5  # of the chosen order, that all refinements may cost together; steps that overrun make it 5
_CHANCE = 2  # standard errors that a start must be better by to be refined: the best of several may be by one
_AGAIN = 2  # linearisations at the ends of a refinement, which one fit in one go would not make twice
_LESS, _FAR_LESS = 0.98, 0.9  # of an error, below which a delay or a direct path is worth it
_BLOCKS = 10  # stretches of what is held out, by which errors of two orders are compared
_FEW = 3  # linearisations: a refinement that may not cost as many is not begun


@dataclass(frozen=True, kw_only=True)
class OrderChoice(Shown):
    """How an order was chosen."""

    orders: tuple[int, ...]  # candidates
    # (n_orders,), error on held-out data, in units of the outputs' standard deviations; infinite where the fit failed;
    # of the subspace start where the order was out of question without refinement: for several experiments A, C and K
    # of that are fitted to all of them
    errors: np.ndarray
    singular_values: np.ndarray  # (n,), of the subspace projection of all data
    # the smallest order within 1 % of the least error, or below which nothing but rounding is left; of several
    # experiments errors may count for more, in proportion to the parameters, where the choice does not hang by it
    order: int
    holdout: str  # what the errors were measured on
    failures: tuple[str, ...] = ()  # why an order could not be judged
    refined: tuple[int, ...] = ()  # orders whose errors are those of refined models
    candidates: tuple[Candidate, ...] = ()  # the same as a table, the chosen one first
    direct: bool = False  # whether outputs depend on inputs of the same sample
    waits: tuple[int, ...] = ()  # samples of each input's delay that are no part of the order
    outside: bool = False  # whether a refined model of the order has a pole outside the unit circle
    inside: bool = False  # whether poles are held inside the unit circle, which was not asked for

    def _words(self) -> str:
        return self.said

    @property
    def said(self) -> str:
        """What was done, for the method's line."""
        held = ", poles held inside the unit circle, as held-out data are for no other" if self.inside else ""
        return f"order = {self.order}, chosen of {len(self.orders)} on {self.holdout}{held}"


class Judged(NamedTuple):
    """Models of one order, and how they do on held-out data."""

    model: StateSpaceModel  # fitted to all that is seen
    models: Sequence[StateSpaceModel]  # for each part that is held out, fitted without it
    squares: np.ndarray  # (n_parts, n_outputs), their mean squared errors in units of the outputs' variances
    blocks: np.ndarray  # (n_blocks,), the same by stretches, mean over outputs; NaN where the models only start
    work: float  # that the last refinement of the model took

    @classmethod
    def of(
        cls,
        model: StateSpaceModel,
        models: Sequence[StateSpaceModel],
        runs: Sequence[tuple[np.ndarray, np.ndarray]],
        work: float,
    ) -> Judged:
        """From each part's squared errors, shape (n_samples, n_outputs), and whether the models predicted them."""
        pieces = -(-_BLOCKS // len(runs))
        cut = [zip(*(np.array_split(a, pieces) for a in run), strict=True) for run in runs]
        blocks = [float(np.mean(s[known])) if known.any() else np.nan for run in cut for s, known in run]
        return cls(model, models, np.array([np.mean(s[known], axis=0) for s, known in runs]), np.array(blocks), work)

    @property
    def error(self) -> float:
        """In standard deviations of the outputs."""
        return float(np.sqrt(np.mean(self.squares)))

    def beats(self, other: Judged) -> bool:
        """Whether its error is less than the other's by 2 %, and by more than that in which they are alike."""
        if len(self.blocks) != len(other.blocks):
            return self.error < _FAR_LESS * other.error
        return self.error < _LESS * other.error and other.error > other.alike(self) * self.error

    def alike(self, other: Judged) -> float:
        """Up to which error over the other's they are not told apart: one standard error of the difference."""
        apart = self.blocks - other.blocks
        apart = apart[np.isfinite(apart)]
        if len(apart) < 2:
            return TIE
        doubt = float(np.std(apart, ddof=1)) / np.sqrt(len(apart))
        return max(TIE, float(np.sqrt(1 + doubt / max(other.error, _EXACT) ** 2)))


@dataclass
class Effort:
    """What the refinements of a search cost, in samples of `Work`, and one fit of each order at least."""

    steps: Sequence[float]  # (n_orders,), of one linearisation
    scale: float  # samples over those that are fitted to in the search
    whole: dict[int, float] = field(default_factory=dict[int, float])  # from an order's start to its model of all data
    begun: list[Work] = field(default_factory=list[Work])

    def begin(self, most: float) -> Work:
        """The account of another refinement."""
        self.begun.append(Work(most=most))
        return self.begun[-1]

    def went_on(self, at: int, work: float) -> None:
        """An order's model of all data has been refined, or refined further."""
        again = _AGAIN * self.steps[at] if at in self.whole else 0.0
        self.whole[at] = self.whole.get(at, 0.0) + max(0.0, work - again)

    def fit(self, at: int) -> float:
        """Of one fit of an order at least: the way so far, and a linearisation for its intervals."""
        return self.scale * (self.whole.get(at, np.inf) + self.steps[at])

    def part(self, at: int) -> float:
        """What the next refinement may cost if this order should be chosen: half of what is left."""
        return max(0.0, 0.5 * (_FITS * self.fit(at) - sum(work.done for work in self.begun)))


def searched(
    judge: Callable[..., float],
    shares: Sequence[float],
    effort: Effort,
    alike: Callable[[int, int], float] = lambda *_: TIE,
) -> tuple[np.ndarray, list[int], int]:
    """Errors of all orders, which of them are of refined models, and the place of the order that is chosen.

    ``judge`` tells the error of the order at a place: of its start where it gets None, and else of its refined models,
    given the least error of refined ones so far, a tolerance and what that may cost. The search begins at the smallest
    order that is not out of question; the chosen order, its neighbours and what beats it are refined; where the choice
    hangs by what the tolerance leaves open, further. Errors that were not judged further may be too small by their
    ``shares``, and count for as much more. Of errors within 1 % the smallest order's is chosen. ``alike`` tells of two
    places the error over the other, up to which chance may make the difference: a start must be better by twice that.

    All refinements together cost at most 5 fits of the chosen order, in `Work`. Where a lower bound on the cost of its
    fit does not allow another one, it is refined to the end, which tells that cost; what is too dear then is left, and
    an order whose errors might be too small gives way to a smaller one.
    """
    search = _Search(judge, np.array(shares), effort, alike)
    while not search.over:
        search.go_on()
    return search.errors, sorted(search.refined), search.chosen


class _Search:
    """What is known of the orders, and which one would be chosen by that."""

    def __init__(
        self,
        judge: Callable[..., float],
        share: np.ndarray,
        effort: Effort,
        alike: Callable[[int, int], float],
    ) -> None:
        self.judge, self.share, self.effort, self.alike = judge, share, effort, alike
        self.errors, self.doubt = np.array([judge(i, None) for i in range(len(share))]), 1 + share
        self.refined, self.close, self.ended = list[int](), list[int](), list[int]()
        self.over, self.chosen = False, 0

    def go_on(self) -> None:
        """Refine one order, or end."""
        refined, effort = self.refined, self.effort
        rough, further = self._wanted()
        smaller = [i for i in refined if i < self.chosen and self._doubtful(i, 0.01)]
        cheapest = min([self.chosen, *smaller], key=effort.fit)
        part = effort.part(cheapest)
        at = next((i for i in rough + further if part >= _FEW * effort.steps[i]), None)
        if at is not None:
            least = min(self.errors[refined], default=np.inf)
            if at in rough:
                self.errors[at] = self.judge(at, least, ROUGH, part)
                refined.append(at)
            else:
                self._judge_closely(at, least, part)
        elif rough + further and cheapest not in self.ended:
            most = min((effort.part(i) for i in [self.chosen, *smaller] if i in self.ended), default=np.inf)
            self.ended.append(cheapest)
            self.errors[cheapest] = self.judge(cheapest, np.inf, FINISHED, most)
        else:
            self.over = True
            if further:
                self.chosen = min((i for i in smaller if effort.part(i) > 0), default=self.chosen)

    def _wanted(self) -> tuple[list[int], list[int]]:
        """Orders to refine, and those to refine further, given the one that is best now."""
        refined, counted, count = self.refined, self.errors * self.doubt, len(self.share)
        sound = bool(np.isfinite(counted[refined]).any())
        least = max(float(counted[refined].min() if sound else counted.min()), _EXACT)
        of = min(refined or range(count), key=lambda i: counted[i])
        best = int(np.argmax(counted <= (TIE if refined else HOPELESS) * least))
        self.chosen = chosen = min((i for i in refined if counted[i] <= TIE * least), default=best)
        more = [chosen + 1] if counted[chosen] > _EXACT else []  # where it may help
        margins = np.array([1 + _CHANCE * (self.alike(of, i) - 1) for i in range(count)])
        wanted = [best, *more, chosen - 1, *np.flatnonzero(counted * margins < least).tolist()]
        hangs = self._hanging(counted, least) if sound and least > _EXACT else []
        return (
            [i for i in wanted if 0 <= i < count and i not in refined],
            [i for i in hangs if i in refined and i not in self.close],
        )

    def _doubtful(self, at: int, more: float = 0.0) -> bool:
        """Whether the chosen order beats a smaller one by no more than its error may be too small."""
        allowed = TIE + self.share[self.chosen] + more
        return bool(self.errors[at] < allowed * self.errors[self.chosen])

    def _hanging(self, counted: np.ndarray, least: float) -> list[int]:
        """Orders by whose errors the choice hangs, where these are not known well enough."""
        errors, refined, chosen = self.errors, sorted(self.refined), self.chosen
        edge = [i for i in refined if i <= chosen and abs(counted[i] / least - TIE) < _OPEN]
        found = [*edge, int(np.argmin(counted))] if edge else []
        if any(self._doubtful(i) for i in refined if i < chosen):
            found.append(chosen)
        if max(self.close, default=0) <= chosen:  # else one of the larger ones has answered for all
            found += [i for i in refined if i > chosen and errors[i] * TIE < errors[chosen]][:1]
        return found

    def _judge_closely(self, at: int, least: float, most: float) -> None:
        """Refine further, and learn from that how much too small the other errors may be."""
        before, self.errors[at] = self.errors[at], self.judge(at, least, _CLOSE, most)
        self.close.append(at)
        self.doubt[at] = 1
        if self.errors[at] <= (1 + self.share[at]) * before:  # no worse than it counted for: so are smaller ones
            self.doubt[:at] = 1
        else:
            others = [i for i in range(len(self.share)) if i not in self.close]
            self.doubt[others] = 1 + 2 * self.share[others]
