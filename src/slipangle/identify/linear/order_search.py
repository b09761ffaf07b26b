"""Which order of several to take, by errors on held-out data of which the better known ones cost more."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

_CLOSE = 1e-5  # share of the squared error by which a closely judged order's last step lowers it
_OPEN = 2e-3  # share of the error that a rough refinement may leave open
_EXACT = 1e-6  # error in standard deviations of the outputs, below which orders differ by rounding


def searched(judge: Callable[..., float], shares: Sequence[float]) -> tuple[np.ndarray, list[int], int]:
    """Errors of all orders, which of them are of refined models, and the place of the order that is chosen.

    ``judge`` tells the error of the order at a place: of its start where it gets None, and else of its refined models,
    given the least error of refined ones so far and, by default a rough one, a tolerance. The chosen order, its
    neighbours and what beats it are refined; where the choice hangs by what the tolerance leaves open, further. Errors
    that were not judged further may be too small by their ``shares``, and count for as much more.
    """
    count, share = len(shares), np.array(shares)
    errors, doubt = np.array([judge(i, None) for i in range(count)]), 1 + share
    refined, close = list[int](), list[int]()
    while True:
        counted = errors * doubt
        known = counted[refined]
        least = max(float(known.min() if np.isfinite(known).any() else counted.min()), _EXACT)
        best = int(np.argmax(counted <= 1.01 * least))
        near = [best, best + 1, best - 1] if counted[best] > _EXACT else [best, best - 1]  # where more may help
        wanted = [i for i in near if 0 <= i < count] + list(np.flatnonzero(counted * 1.01 < least))
        at = next((int(i) for i in wanted if i not in refined), None)
        if at is not None:
            errors[at] = judge(at, min(errors[refined], default=np.inf))
            refined.append(at)
            continue
        hangs = _hanging(errors, counted, share, sorted(refined), best, close) if least > _EXACT else []
        at = next((i for i in hangs if i in refined and i not in close), None)
        if at is None:
            return errors, sorted(refined), best
        rough, errors[at] = errors[at], judge(at, min(errors[refined]), _CLOSE)
        close.append(at)
        doubt[at] = 1
        if errors[at] <= (1 + share[at]) * rough:  # no worse than it counted for: those of fewer states are right
            doubt[:at] = 1
        else:
            others = [i for i in range(count) if i not in close]
            doubt[others] = 1 + 2 * share[others]


def _hanging(
    errors: np.ndarray, counted: np.ndarray, share: np.ndarray, refined: list[int], best: int, close: list[int]
) -> list[int]:
    """Places of the orders by whose errors the choice of the best hangs, where these are not known well enough."""
    least = counted[refined].min()
    low, high = (1.01 - _OPEN) * least, (1.01 + _OPEN) * least
    edge = [i for i in refined if i <= best and low < counted[i] < high]
    found = [*edge, int(np.argmin(counted))] if edge else []
    if any(errors[i] < (1.01 + share[best]) * errors[best] for i in refined if i < best):
        found.append(best)
    if max(close, default=0) <= best:  # else one of the larger ones has answered for all
        found += [i for i in refined if i > best and errors[i] * 1.01 < errors[best]][:1]
    return found
