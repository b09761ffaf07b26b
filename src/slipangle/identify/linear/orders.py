"""Orders of ARX models, chosen by free runs over stretches that the fits have not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import TooShortError
from slipangle.identify.linear.delays import delayed, first_effects
from slipangle.identify.linear.lags import PerInput
from slipangle.identify.linear.neighbours import Chosen, Orders, each_input, near, with_input
from slipangle.identify.linear.order_trials import Choice, Trials, regression, stretches

__all__ = ["LEVELS", "Choice", "Chosen", "Orders", "choose", "regression"]

LEVELS = (1, 2, 4, 7, 10)  # lags of the first candidates: every number is one of them, or next to one
_SHORT = {2, 4}  # lags of an input whose delay is sought, beside those that did best
_ROUNDS = 3  # from the best to what is near it
_ABOUT = 5  # samples from the first effect that the data tell, about which delays are sought
_LESS, _FAR_LESS = 0.98, 0.9  # of an error, below which a delay elsewhere or a direct path is worth it
_SURE = 1.0  # standard errors, over stretches, by which it must be better


def choose(
    data: Dataset,
    *,
    na: int | Chosen,
    nb: PerInput | Chosen,
    nk: PerInput | Chosen,
    offset: bool,
    speeds: Sequence[float] = (),
    same: bool = False,
    direct: bool = False,
) -> Choice:
    """Orders by free run over held-out stretches; those that are given stay.

    Candidates, 50 to 80, are a coarse grid of lags, then delays of each input with few lags, then the neighbours of the
    best, and more past outputs where that is unstable. A model whose free run would blow up over the longest experiment
    comes after all that hold. Of candidates within 1 % of the least error the one with the fewest coefficients wins.

    Where the data tell of a delay beyond 10 samples, as many again are compared about it; and, where they may be
    ``direct`` and an input acts at its own sample, as many with that. Their best wins if its error is less by 2 % and
    its mean over stretches by one standard error.

    Raises TooShortError if there are too few samples to fit to some stretches and run freely over others.

    Inputs are all but v_x where there are ``speeds`` [m/s], at which the coefficients are blended by v_x. With
    ``same`` all inputs have the same lags and delay.
    """
    inputs = tuple(n for n in data.inputs if n != "v_x" or not speeds)
    fixed: dict[str, Any] = {"na": na, "nb": nb, "nk": nk, "offset": offset, "speeds": speeds, "same": same}
    found = _searched(data, (0,) * len(inputs), (1,) * len(inputs), **fixed)
    if nk != "chosen":
        return found.choice
    first = first_effects(data, inputs)
    first = (min(first),) * len(first) if same else first
    waits = tuple(k - _ABOUT if k > LEVELS[-1] else 0 for k in first)
    if any(waits):
        found = _better(found, data, waits, (1,) * len(waits), **fixed)
    if direct and 0 in first:
        found = _better(found, data, found.waits, tuple(min(k, 1) for k in first), **fixed)
    return found.choice


@dataclass(frozen=True)
class _Search:
    """What was compared, how much of the delays lies before it, and the best one's squared error on each stretch."""

    choice: Choice
    waits: tuple[int, ...]
    squares: np.ndarray

    def beats(self, other: _Search) -> bool:
        """Whether its best is better than the other's by more than a little and than chance makes it."""
        own, its = (search.choice.candidates[0] for search in (self, other))
        if own.stable != its.stable:
            return own.stable
        if len(self.squares) != len(other.squares):  # of records so short that a longer reach leaves fewer
            return own.error < _FAR_LESS * its.error
        gain = np.sqrt(other.squares) - np.sqrt(self.squares)
        chance = np.std(gain, ddof=1) / np.sqrt(len(gain))
        return own.error < _LESS * its.error and bool(np.mean(gain) > _SURE * chance)


def _better(found: _Search, data: Dataset, waits: tuple[int, ...], least: tuple[int, ...], **fixed: Any) -> _Search:
    """The better one of a search and another, with the candidates of both."""
    try:
        other = _searched(data, waits, least, **fixed)
    except TooShortError:
        return found
    one, rest = (other, found) if other.beats(found) else (found, other)
    return replace(one, choice=Choice((*one.choice.ranked, *rest.choice.ranked)))


def _searched(
    data: Dataset,
    waits: tuple[int, ...],
    least: tuple[int, ...],
    *,
    na: int | Chosen,
    nb: PerInput | Chosen,
    nk: PerInput | Chosen,
    offset: bool,
    speeds: Sequence[float],
    same: bool,
) -> _Search:
    """One search, of delays that are ``least`` or more beyond ``waits``."""
    inputs = tuple(n for n in data.inputs if n != "v_x" or not speeds)
    data, nu = delayed(data, dict(zip(inputs, waits, strict=True))), len(inputs)
    open_y, open_b, open_k = (v == "chosen" for v in (na, nb, nk))
    start = least if open_k else each_input(nk, nu)
    fixed = Orders(1 if isinstance(na, str) else na, each_input(nb, nu), start)
    most = _most(data, fixed, (open_y, open_b, open_k))
    levels = sorted({most, *(n for n in LEVELS if n < most)})
    widest = replace(
        fixed,
        na=max(levels[-1], fixed.na) if open_y else fixed.na,
        nb=(levels[-1],) * nu if open_b else fixed.nb,
        nk=(most,) * nu if open_k else fixed.nk,
    )
    trials = Trials(data, widest, offset, speeds)
    lags_y, lags_u = levels if open_y else [fixed.na], levels if open_b else [0]
    trials.add(replace(fixed, na=a, nb=(b,) * nu if b else fixed.nb) for a in lags_y for b in lags_u)
    groups = [range(nu)] if same else [range(i, i + 1) for i in range(nu)]
    for of in groups if open_k else []:
        best = trials.best
        counts = sorted({*_SHORT, best.nb[of[0]]}) if open_b else [best.nb[of[0]]]
        delays = [with_input(best.nk, of, k) for k in range(least[of[0]], most + 1)]
        trials.add(replace(best, nb=with_input(best.nb, of, b), nk=nk) for b in counts for nk in delays)
    trials.add(replace(trials.best, na=a) for a in lags_y)
    for _ in range(_ROUNDS):
        best = trials.best
        trials.add(near(best, groups, (open_y, open_b, open_k), least))
        if trials.best == best:
            break
    if not trials.done[trials.best].stable and open_y:
        trials.add(replace(trials.best, na=a) for a in range(1, most + 1))
    return _Search(trials.choice(waits), waits, trials.by_stretch(trials.best))


def _most(data: Dataset, fixed: Orders, open_: tuple[bool, bool, bool]) -> int:
    """How many lags, and samples of delay, the data allow to be tried."""
    for most in range(LEVELS[-1], 0, -1):
        nb = max(most if open_[1] else 0, *(b for b in fixed.nb))
        nk = max(most if open_[2] else 0, *(k for k in fixed.nk))
        reach = max(most if open_[0] else fixed.na, nb + nk - 1)
        sizes = np.array([b - a for a, b in stretches(data, reach)])
        p = (most if open_[0] else fixed.na) * len(data.outputs) + nb * len(data.inputs)
        if len(sizes) > 1 and np.maximum(sizes - reach, 0).sum() >= max(0.5 * data.n_samples, 4 * p):
            return most
    need = 2 * 4 * (max(fixed.reach, 1) + 1)
    raise TooShortError(
        f"'{data.name}' has {data.n_samples} samples, the longest experiment {data.n_longest}; expected at least "
        f"{need} in a row to choose orders on stretches held out: record longer, or give na, nb and nk"
    )
