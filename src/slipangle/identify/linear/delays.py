"""How many samples each input takes to show in the outputs, told by a long regression rather than by trying all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
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
_RIDGE = 1e-10  # of columns of one length
_CLEAN = 1e-9  # of an output's variance, below which nothing counts


def first_effects(data: Dataset, inputs: Sequence[str]) -> tuple[int, ...]:
    """For each input the first lag that the outputs are seen to depend on; 1 where the data are too short to tell.

    Of the least-squares fit to past outputs and to all lags of all inputs, one input's newest lags are taken away
    until what is left is worse by more than chance makes it (an F test of nested models). Before the first effect the
    true coefficients are zero whatever the inputs' spectrum is and the noise's, as long as the inputs do not answer
    the outputs. Where they do, so that past outputs tell of an input what its own past does not, an effect at the same
    sample may be the loop's, and counts as one at the next.

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 13.4, 14.4 and 16.4.
    """
    names, nu, ny = (*data.outputs, *inputs), len(inputs), len(data.outputs)
    reach = _reach(data, ny, nu)
    if reach == 0:
        return (1,) * nu
    gram, count = _gram(data, names, reach)
    lags = {c: [c + (reach - lag) * len(names) + 1 for lag in range(reach + 1)] for c in range(len(names))}
    past = [0, *(column for c in range(ny) for column in lags[c][1 : _PAST + 1])]
    found = []
    for i in range(nu):
        others = [column for j in range(nu) if j != i for column in lags[ny + j]]
        first = _first(gram, count, [*past, *others], lags[ny + i], [lags[c][0] for c in range(ny)])
        driven = [0, *(column for j in range(nu) for column in lags[ny + j][1:])]
        loop = first == 0 and _answers(gram, count, driven, past[1:], lags[ny + i][0])
        found.append(1 if loop else first)
    return tuple(found)


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


def _first(gram: np.ndarray, count: int, known: list[int], own: list[int], targets: list[int]) -> int:
    """The most lags of an input, newest first, that can be left out: less by chance than tells; at most all but one."""
    rise, left = _rises(gram, known, own[::-1], targets)
    freedom = count - len(known) - len(own)
    lost = np.cumsum(rise[::-1] / left, axis=0).sum(axis=1)[:-1] * freedom  # without the newest 1, 2, ... lags
    dropped = len(targets) * np.arange(1, len(own))
    seen = lost / dropped > scipy.stats.f.isf(_CHANCE / len(own), dropped, freedom)
    return int(np.argmax(seen)) if seen.any() else 1


def _answers(gram: np.ndarray, count: int, known: list[int], past: list[int], target: int) -> bool:
    """Whether past outputs tell of an input what past inputs do not."""
    rise, left = _rises(gram, known, past, [target])
    chance, share = _LOOP
    told, freedom = float(rise.sum()), count - len(known) - len(past)
    limit = float(scipy.stats.f.isf(chance, len(past), freedom))
    return told > share * (told + float(left[0])) and told / left[0] * freedom / len(past) > limit
