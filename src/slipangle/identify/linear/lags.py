"""Products of lagged signals, and triangular factors of lagged regressors, without ever storing the regressors.

A window is ``lags`` consecutive samples of all signals. The Gram matrix of all windows costs one product per lag
difference, because entries on a block diagonal differ only by the products at both ends of the record.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError

PerInput = int | tuple[int, ...]
"""Lags or delays: one number for all inputs, or one for each."""
CHUNK = 1 << 15  # samples whose copy stays in the cache
_SHORT = 8  # lags in an experiment, below which its windows are written down


def same_for_all(settings: Any, *names: str) -> None:
    """Make one number of a setting that was given per input, for models that have the same lags of every input.

    Raises ParameterError if the numbers differ.
    """
    for name in names:
        given = getattr(settings, name)
        if isinstance(given, tuple):
            if len(set(given)) != 1:
                raise ParameterError(
                    f"{name} is {given}; expected the same for every input in a {type(settings).__name__}: give one "
                    "number, or use ARX"
                )
            object.__setattr__(settings, name, given[0])


@dataclass(frozen=True, kw_only=True)
class Windows:
    """All windows of ``lags`` samples inside the experiments of a data set; none crosses a border.

    A window's entries are ordered oldest sample first, channels inside a sample in the order of ``names``.
    """

    data: Dataset
    names: tuple[str, ...]
    lags: int
    shift: np.ndarray | None = None  # (n_channels,), subtracted from every sample; by default zero
    stretches: tuple[tuple[int, int], ...] | None = None  # first and last-but-one rows; by default the experiments

    @cached_property
    def _columns(self) -> list[int] | slice:
        indices = [self.data.index(n) for n in self.names]
        if indices == list(range(indices[0], indices[0] + len(indices))):
            return slice(indices[0], indices[0] + len(indices))
        return indices

    def spans(self) -> tuple[tuple[int, int], ...]:
        """First and last-but-one row of every experiment, or stretch, that holds a window."""
        pairs = self.stretches
        if pairs is None:
            pairs = tuple(zip(self.data.starts, self.data.stops, strict=True))
        return tuple((a, b) for a, b in pairs if b - a >= self.lags)

    @property
    def count(self) -> int:
        """How many windows there are."""
        return sum(b - a - self.lags + 1 for a, b in self.spans())

    def block(self, start: int, stop: int) -> np.ndarray:
        """Rows of the record, shifted, as an array of its own, shape (stop - start, n_channels)."""
        z = np.array(self.data.values[start:stop, self._columns], dtype=float, order="C")
        return z if self.shift is None else np.subtract(z, self.shift, out=z)

    def gram(self) -> tuple[np.ndarray, np.ndarray]:
        """Sum of the outer products of all windows, and their sum: shapes (m, m), (m,), m = lags * n_channels."""
        nc, lags = len(self.names), self.lags
        products = np.zeros((lags, nc, lags, nc))
        sums = np.zeros((lags, nc))
        full = np.zeros((lags * nc, lags * nc))
        for start, stop in self.spans():
            if stop - start < _SHORT * lags:
                z = self.block(start, stop)
                rows = np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(z.ravel(), lags * nc)[::nc])
                full += rows.T @ rows
                sums += rows.sum(axis=0).reshape(lags, nc)
                continue
            lagged, total = self._lag_products(start, stop)
            first, last = self.block(start, start + lags - 1), self.block(stop - lags + 1, stop)
            part = np.zeros_like(products)
            part[0] = lagged.transpose(1, 0, 2)
            sums[0] += total
            for i in range(lags - 1):  # from samples k .. k + n - 1 to one sample later
                total = total + last[i] - first[i]
                sums[i + 1] += total
                ends = last[i][:, None, None] * last[i:] - first[i][:, None, None] * first[i:]
                part[i + 1, :, i + 1 :] = part[i, :, i:-1] + ends
            products += part
        full += products.reshape(lags * nc, lags * nc)
        upper = np.triu(full)
        return upper + np.triu(full, 1).T, sums.ravel()

    def _lag_products(self, start: int, stop: int) -> tuple[np.ndarray, np.ndarray]:
        """Sums over the windows' first samples of z(k) z(k + d)', shape (lags, nc, nc), and of z(k)."""
        nc, lags = len(self.names), self.lags
        length = max(lags, 16)
        n = stop - start - lags + 1
        same, next_ = np.zeros((2, length * nc, length * nc))
        total = np.zeros(nc)
        per_chunk = max(1, CHUNK // length)
        blocks = max(0, (stop - start) // length - 1)  # the last one looks into a whole next one
        for done in range(0, blocks, per_chunk):
            size = min(per_chunk, blocks - done)
            a = start + done * length
            z = self.block(a, a + (size + 1) * length)
            wide = z.reshape(size + 1, length * nc)
            same += wide[:-1].T @ wide[:-1]
            next_ += wide[:-1].T @ wide[1:]
            total += (np.ones(size) @ wide[:-1]).reshape(length, nc).sum(axis=0)
        pair = np.concatenate([same.reshape(length, nc, length, nc), next_.reshape(length, nc, length, nc)], axis=2)
        lagged = np.zeros((lags, nc, nc))
        for p in range(length):
            lagged += pair[p, :, p : p + lags].transpose(1, 0, 2)
        done = blocks * length
        if done < n:
            tail = self.block(start + done, stop)
            head = tail[: n - done]
            total += head.sum(axis=0)
            for d in range(lags):
                lagged[d] += head.T @ tail[d : d + n - done]
        elif done > n:  # whole blocks reached past the last window's first sample
            tail = self.block(start + n, stop)
            extra = done - n
            total -= tail[:extra].sum(axis=0)
            for d in range(lags):
                lagged[d] -= tail[:extra].T @ tail[d : d + extra]
        return lagged, total

    def rows(self, size: int) -> Iterator[np.ndarray]:
        """Windows as matrices of at most ``size`` rows, shape (rows, lags * n_channels); views, do not write."""
        nc = len(self.names)
        for start, stop in self.spans():
            n = stop - start - self.lags + 1
            for done in range(0, n, size):
                now = min(size, n - done)
                z = self.block(start + done, start + done + now + self.lags - 1)
                step, item = z.strides
                yield np.lib.stride_tricks.as_strided(z, (now, self.lags * nc), (step, item), writeable=False)


def triangle(windows: Windows, columns: Sequence[int], *, constant: bool = False, scale: np.ndarray) -> np.ndarray:
    """Upper triangular R of the QR factorisation of the windows' columns, made block by block.

    Memory does not depend on the length of the record.

    ``columns`` are the entries of a window that make a row, in order, ``constant`` puts a column of ones first,
    ``scale``, shape (n_columns,), divides each.
    """
    pick = np.asarray(columns)
    width = len(pick) + constant
    size = max(4 * width, 2048)
    r = np.zeros((0, width))
    stack = np.empty((size + width, width), order="F")
    for rows in windows.rows(size):
        top = len(r)
        now = stack[: top + len(rows)]
        now[:top] = r
        if constant:
            now[top:, 0] = 1 / scale[0]
        np.divide(rows[:, pick], scale[constant:], out=now[top:, int(constant) :])
        r = np.asarray(np.linalg.qr(now, mode="r"))
    return r
