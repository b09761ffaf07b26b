"""`Region`: where the data lay that a model learned from, and what of a run lies beyond it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.equal import Equal
from slipangle.units import read_in

OUTSIDE = "lie outside of the training data"
# Half ranges outside from which a sample counts, and the share of such samples from which there is a word: of 60 pairs
# of made drives of one kind, three minutes each, none had one, of 30 that were faster, wilder or on ice all had.
WORDS = ((0.2, 0.05), (0.5, 0.01))
_SPARE = 1000  # samples of which one at either end widens nothing, as an outlier
_LEAST = 0.02  # half range of a channel over its largest value, at least: what hardly moved is no range
_TURNS = np.array([[np.cos(a), np.sin(a)] for a in np.pi / 8 * np.array([1, 2, 3, 5, 6, 7])])  # between two axes
_UNBOUND = ("X", "Y", "psi", "distance")  # places, of which nothing depends on how far they are


@dataclass(frozen=True, kw_only=True)
class Region(Equal):
    """Range of every channel of the training data, and for each two of them the convex hull of where they lay together.

    The hull of two channels is a polygon of sixteen sides: high speed and large steering may both be in the data, and
    never together. Ranges leave out one sample of a thousand at either end.

    Parameters
    ----------
    channels : tuple of str
        Inputs and outputs that are looked at; X, Y, psi and distance are not.
    low, high : array, shape (n_channels,)
        Ends of their ranges, SI units.
    hull : array, shape (n_pairs, 6, 2)
        For each two channels in the order of `itertools.combinations`, how far the data reach, down and up, along
        directions every 22.5 degrees between their axes, without the axes. [half ranges]
    beyond : str
        What a model does there, in words.

    Source: E. Barnard, L. F. A. Wessels, Extrapolation and interpolation in neural network classifiers, IEEE Control
    Systems Magazine 12(5), 1992, who take the convex hull of the training data for where a network interpolates.
    """

    channels: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    hull: np.ndarray = field(repr=False)
    beyond: str = "the model extrapolates there: train on such data too, or doubt what it says"

    @classmethod
    def of(cls, data: Dataset, channels: Sequence[str] | None = None) -> Self:
        """That of some channels of the data, by default of all inputs and outputs."""
        names = tuple(n for n in channels or (*data.inputs, *data.outputs) if n not in _UNBOUND)
        values = data.columns(names)
        low, high = _ends(values)
        bare = cls(channels=names, low=low, high=high, hull=np.empty((0, len(_TURNS), 2)))
        z = bare._scaled(values)
        hulls = [np.stack(_ends(z[:, pair] @ _TURNS.T), axis=1) for pair in bare._pairs]
        return cls(channels=names, low=low, high=high, hull=np.array(hulls).reshape(-1, len(_TURNS), 2))

    def behind(self, gains: Mapping[str, float], zeros: Mapping[str, float]) -> Self:
        """The same of sensors that read ``channel / gain + zero``.

        Parameters
        ----------
        gains : mapping of str to float
            By channel, above zero; 1 of all others. [-]
        zeros : mapping of str to float
            What each channel reads at zero, SI units; 0 of all others.
        """
        gain, zero = (
            np.array([given.get(n, other) for n in self.channels]) for given, other in ((gains, 1), (zeros, 0))
        )
        return replace(self, low=self.low / gain + zero, high=self.high / gain + zero)

    def only(self, names: Collection[str]) -> Self:
        """The same of those channels that are among these."""
        kept = [i for i, n in enumerate(self.channels) if n in names]
        if len(kept) == len(self.channels):
            return self
        hull = self.hull[[i in kept and j in kept for i, j in self._pairs]]
        channels = tuple(self.channels[i] for i in kept)
        return replace(self, channels=channels, low=self.low[kept], high=self.high[kept], hull=hull)

    @property
    def _pairs(self) -> list[list[int]]:
        return [[i, j] for i, j in combinations(range(len(self.channels)), 2)]

    def _scaled(self, values: np.ndarray) -> np.ndarray:
        """Values about the middle of each range, in half ranges."""
        half = np.maximum(0.5 * (self.high - self.low), _LEAST * np.maximum(np.abs(self.low), np.abs(self.high)))
        return (values - 0.5 * (self.low + self.high)) / np.where(half > 0, half, 1.0)

    def excess(self, values: np.ndarray) -> np.ndarray:
        """How far samples lie outside, shape (n_samples, n_channels + n_pairs), below zero inside. [half ranges]

        First beyond the range of each channel, then beyond the hull of each two.
        """
        z = self._scaled(values)
        sides = [np.abs(z) - 1.0]
        for pair, hull in zip(self._pairs, self.hull, strict=True):
            along = z[:, pair] @ _TURNS.T
            sides.append(np.max(np.maximum(hull[:, 0] - along, along - hull[:, 1]), axis=1, keepdims=True))
        return np.hstack(sides)

    def left(
        self, channels: Mapping[str, np.ndarray], *, t: np.ndarray, what: str, unit: Callable[[str], str]
    ) -> Left | None:
        """What of a run lies outside; None where that is not worth a word, see `WORDS`.

        Parameters
        ----------
        channels : mapping of str to array, shape (n_samples,)
            Samples by channel, SI units.
        t : array, shape (n_samples,)
            Their times. [s]
        what : str
            The run in words.
        unit : callable
            Unit of a channel.
        """
        return self.only(channels)._left(channels, t, what, unit)

    def _left(
        self, channels: Mapping[str, np.ndarray], t: np.ndarray, what: str, unit: Callable[[str], str]
    ) -> Left | None:
        """`left` of a run that has all channels."""
        values, units = np.column_stack([channels[n] for n in self.channels]), [unit(n) for n in self.channels]
        excess, n = self.excess(values), len(self.channels)
        worst = excess.max(axis=1, initial=-1.0)
        if not any(np.mean(worst > far) > share for far, share in WORDS):
            return None
        outside = excess > WORDS[0][0]
        rows, by_one = np.any(outside, axis=1), np.any(outside[:, :n], axis=1)
        left = [i for i in range(n) if outside[:, i].any()]
        words = [self._range_said(i, values[:, i], units[i]) for i in left]
        together = outside[~by_one, n:].sum(axis=0)  # where no channel says it by itself
        if together.any():
            j = int(np.argmax(together))
            k = int(np.argmax(np.where(by_one, -np.inf, excess[:, n + j])))
            both = " with ".join(_said(self.channels[i], values[k, i], units[i]) for i in self._pairs[j])
            words.append(f"{both}, which never came together there")
        share, first = 100 * float(np.mean(rows)), float(t[np.argmax(rows)])
        much, said = f"{share:{'.0f' if share >= 10 else '.2g'}}", "; ".join([*words, self.beyond])
        sentence = f"{much} % of the {what}, first at t = {first:g} s, {OUTSIDE}: {said}"
        return Left(rows=np.asarray(rows), sentence=sentence)

    def _range_said(self, i: int, values: np.ndarray, unit: str) -> str:
        middle = 0.5 * (self.low[i] + self.high[i])
        worst = values[np.argmax(np.abs(values - middle))]
        name = self.channels[i]
        factor, shown = read_in(name, unit)
        ends = f"{factor * self.low[i]:.3g} to {factor * self.high[i]:.3g} {shown}".removesuffix(" -")
        return f"{_said(name, worst, unit)}, there {ends}"


@dataclass(frozen=True, kw_only=True)
class Left:
    """Samples of a run that lie outside of the training data."""

    rows: np.ndarray  # which they are, shape (n_samples,)
    sentence: str  # how many, from when, in which channels and how far


def _ends(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest of each column, but for one sample of a thousand at either end."""
    k = len(values) // _SPARE
    ordered = np.partition(values, (k, len(values) - 1 - k), axis=0)
    return ordered[k], ordered[len(values) - 1 - k]


def _said(name: str, value: float, unit: str) -> str:
    """A value with its name as people read it."""
    factor, shown = read_in(name, unit)
    return f"{name} {factor * value:.3g} {shown}".removesuffix(" -")
