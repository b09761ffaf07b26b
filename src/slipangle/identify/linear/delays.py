"""How many samples each input takes to show in the outputs, told by a long regression rather than by trying all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import scipy
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.errors import TooShortError
from slipangle.identify.linear.lags import Windows

REACH = 100  # samples of delay that are looked for, fewer where records are short
_PAST = 10  # outputs, which make the residual nearly white
_EQUATIONS = 3  # for each coefficient, at least
_CHANCE = 1e-3  # of an effect seen where there is none, over all delays
_LOOP = 0.01, 0.005  # chance of a loop seen where there is none; share of an input that past outputs must tell
_STRONG, _ALIKE = 6.0, 1e-3  # difference of BIC that is strong evidence; one that rounding may make
_FEW = (0, 1, 2, 3, 4, 6, 8, 10)  # lags of the equations that tell which of an input and the outputs answers the other
_RIDGE = 1e-10  # of columns of one length
_CLEAN = 1e-9  # of an output's variance, below which nothing counts


def first_effects(data: Dataset, inputs: Sequence[str]) -> tuple[int, ...]:
    """For each input the first lag that the outputs are seen to depend on; 1 where the data are too short to tell.

    Of the least-squares fit to past outputs and to all lags of all inputs, one input's newest lags are taken away
    until what is left is worse by more than chance makes it (an F test of nested models). Before the first effect the
    true coefficients are zero whatever the inputs' spectrum is and the noise's, as long as the inputs do not answer
    the outputs [1]_. Where they do, an effect at the same sample may be the loop's, and the first one after it counts.

    Second moments have no direction within a sample [2]_: a loop and a direct path with a filtered input may have the
    same. But one of them is simpler. Plant and controller have few coefficients each, and where one is taken for the
    other, neither equation has. So of both orders of events, input before outputs and outputs before input, that of
    the lesser BIC over both equations holds [3]_; where past outputs tell of the input what its own past does not, so
    that a loop is there, a direct path beside it must be the simpler one by 6, which is strong evidence [4]_.

    References
    ----------
    .. [1] L. Ljung, System Identification, 2nd ed., 1999, sec. 13.4, 14.4 and 16.4.
    .. [2] J. Geweke, Measurement of linear dependence and feedback, J. American Statistical Association 77, 1982.
    .. [3] G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
    .. [4] R. Kass, A. Raftery, Bayes factors, J. American Statistical Association 90, 1995, sec. 3.2.
    """
    names, nu, ny = (*data.outputs, *inputs), len(inputs), len(data.outputs)
    reach = _reach(data, ny, nu)
    if reach == 0:
        return (1,) * nu
    gram, count = _gram(data, names, reach)
    lags = {c: [c + (reach - lag) * len(names) + 1 for lag in range(reach + 1)] for c in range(len(names))}
    past = [0, *(column for c in range(ny) for column in lags[c][1 : _PAST + 1])]
    loops = list[int]()  # inputs that answer the outputs, whose present the outputs do not depend on
    while True:
        present = {j: lags[ny + j][int(j in loops) :] for j in range(nu)}
        found, doubts = list[int](), dict[int, float]()
        for i in range(nu):
            others = [column for j in range(nu) if j != i for column in present[j]]
            first = _first(gram, count, [*past, *others], present[i], [lags[c][0] for c in range(ny)])
            found.append(1 if first is None else first + (i in loops))
            if found[i] == 0:
                driven = [0, *(column for j in range(nu) for column in lags[ny + j][1:])]
                beside = [present[j][0] for j in range(nu) if j != i and j not in loops]
                doubts[i] = _simpler_as_loop(gram, count, lags, ny, ny + i, beside)
                doubts[i] += _STRONG * _answers(gram, count, driven, past[1:], lags[ny + i][0])
        if max(doubts.values(), default=0.0) <= _ALIKE:
            return tuple(found)
        loops.append(max(doubts, key=doubts.__getitem__))


def delayed(data: Dataset, by: dict[str, int]) -> Dataset:
    """The data with some inputs as they were so many samples before; each experiment loses its first ones.

    Raises TooShortError if no experiment is longer than the longest of these.
    """
    most = max(by.values(), default=0)
    if most == 0:
        return data
    pieces, starts, times = [], [], []
    for a, b, t0 in zip(data.starts, data.stops, data.start_times, strict=True):
        if b - a <= most:
            continue
        rows = np.array(data.values[a + most : b])
        for name, samples in by.items():
            rows[:, data.index(name)] = data.values[a + most - samples : b - samples, data.index(name)]
        starts.append(sum(map(len, pieces)))
        times.append(t0 + most * data.dt)
        pieces.append(rows)
    if not pieces:
        raise TooShortError(f"no experiment of '{data.name}' is longer than {most} samples; expected a longer one")
    return replace(data, values=np.vstack(pieces), starts=tuple(starts), start_times=tuple(times))


def _reach(data: Dataset, ny: int, nu: int) -> int:
    """How far back the data carry a regression; 0 if not at all."""
    lengths = np.array(data.stops) - np.array(data.starts)
    for reach in range(REACH, _PAST - 1, -1):
        if np.maximum(lengths - reach, 0).sum() >= _EQUATIONS * (1 + _PAST * ny + (reach + 1) * nu):
            return reach
    return 0


def _gram(data: Dataset, names: tuple[str, ...], reach: int) -> tuple[np.ndarray, int]:
    """Products of the constant and all lags, oldest first, scaled to a diagonal of one; and how many windows made them.

    A lag that does not move has zeros.
    """
    shift = np.array([data[n].mean() for n in names])
    windows = Windows(data=data, names=names, lags=reach + 1, shift=shift)
    products, sums = windows.gram()
    gram = np.block([[np.full((1, 1), float(windows.count)), sums[None]], [sums[:, None], products]])
    size = np.sqrt(np.diag(gram))
    size[size == 0] = np.inf
    return gram / np.outer(size, size), windows.count


def _rises(gram: np.ndarray, known: list[int], taken: list[int], targets: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """How much each column that is ``taken`` in turn, after the known ones, lowers the squares; what is left at last.

    Shapes (n_taken, n_targets), (n_targets,).
    """
    at = [*known, *taken]
    factor: Any = linalg.cholesky(gram[np.ix_(at, at)] + _RIDGE * np.eye(len(at)), lower=True)
    told = linalg.solve_triangular(factor, gram[np.ix_(at, targets)], lower=True) ** 2
    whole = np.diag(gram)[targets]
    return told[len(known) :], np.maximum(whole - told.sum(axis=0), _CLEAN * np.maximum(whole, _CLEAN))


def _first(gram: np.ndarray, count: int, known: list[int], own: list[int], targets: list[int]) -> int | None:
    """The most lags of an input, newest first, that can be left out: less by chance than tells; None where all can."""
    rise, left = _rises(gram, known, own[::-1], targets)
    freedom = count - len(known) - len(own)
    lost = np.cumsum(rise[::-1] / left, axis=0).sum(axis=1)[:-1] * freedom  # without the newest 1, 2, ... lags
    dropped = len(targets) * np.arange(1, len(own))
    seen = lost / dropped > scipy.stats.f.isf(_CHANCE / len(own), dropped, freedom)
    return int(np.argmax(seen)) if seen.any() else None


def _answers(gram: np.ndarray, count: int, known: list[int], past: list[int], target: int) -> bool:
    """Whether past outputs tell of an input what past inputs do not."""
    rise, left = _rises(gram, known, past, [target])
    chance, share = _LOOP
    told, freedom = float(rise.sum()), count - len(known) - len(past)
    limit = float(scipy.stats.f.isf(chance, len(past), freedom))
    return told > share * (told + float(left[0])) and told / left[0] * freedom / len(past) > limit


def _simpler_as_loop(
    gram: np.ndarray, count: int, lags: Mapping[int, list[int]], ny: int, own: int, beside: list[int]
) -> float:
    """By how much less BIC an input takes that answers the outputs of its sample than outputs that answer the input.

    ``beside`` are the present columns of other inputs.
    """
    outputs, inputs = range(ny), [c for c in lags if c >= ny]
    at_once, now = [lags[c][0] for c in outputs], lags[own][0]

    def least(targets: list[int], more: list[int]) -> float:
        """The least BIC of the targets' equations over numbers of lags; ``more`` are present columns."""
        found = []
        for a, b in product(_FEW, _FEW):
            past_y = [column for c in outputs for column in lags[c][1 : a + 1]]
            past_u = [column for c in inputs for column in lags[c][1 : b + 1]]
            known = [0, *beside, *past_y, *past_u, *more]
            left = _left(gram, known, targets)
            found.append(count * left + len(targets) * len(known) * np.log(count))
        return min(found)

    return least([now], []) + least(at_once, [now]) - least(at_once, []) - least([now], at_once)


def _left(gram: np.ndarray, known: list[int], targets: list[int]) -> float:
    """Logarithm of the determinant of what the known columns leave of the targets."""
    factor: Any = linalg.cholesky(gram[np.ix_(known, known)] + _RIDGE * np.eye(len(known)), lower=True)
    told = linalg.solve_triangular(factor, gram[np.ix_(known, targets)], lower=True)
    rest = gram[np.ix_(targets, targets)] - told.T @ told
    return float(np.linalg.slogdet(rest + _CLEAN * np.eye(len(targets)))[1])
