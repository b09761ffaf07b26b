"""A `Program` as the matrices that general solvers take: by stages, sparse, or condensed to the inputs, dense.

Excess over soft limits gets variables of its own, one per limit, behind those of its stage. All programs of one problem
have the same pattern, which `Form.of` takes from all of them, so that solvers need be set up once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from benchmarks.peers.programs import Program

NOWHERE = 1e4  # a limit that is there in other programs of the problem


@dataclass(frozen=True, eq=False)
class Matrices:
    """Least 1/2 z'P z + q'z with A z = b, low <= G z <= high, z between ``bounds`` (n, 2)."""

    P: Any
    q: np.ndarray
    A: Any
    b: np.ndarray
    G: Any
    low: np.ndarray
    high: np.ndarray
    bounds: np.ndarray

    def joined(self) -> tuple[Any, np.ndarray, np.ndarray]:
        """All as rows between two numbers, bounds too: matrix, low, high."""
        rows = [self.A, self.G, sp.identity(len(self.q), format="csc")]
        low, high = np.r_[self.b, self.low, self.bounds[:, 0]], np.r_[self.b, self.high, self.bounds[:, 1]]
        some = np.isfinite(low) | np.isfinite(high)
        return sp.vstack(rows, format="csc")[some], low[some], high[some]


class Form:
    """Builds `Matrices` of one pattern from programs of one problem; ``inputs`` says where these are."""

    def __init__(self, programs: Sequence[Program]) -> None:
        first = programs[0]
        self.soft = np.isfinite(first.plain)
        self.plain, self.square = first.plain[self.soft], first.square[self.soft]
        low, high = (np.array([getattr(p, side) for p in programs]) for side in ("low", "high"))
        self.has_low, self.has_high = np.isfinite(low).any(axis=0), np.isfinite(high).any(axis=0)
        # rows of limits: hard ones once, soft ones once for each side that has a limit
        order = np.arange(len(first.plain))
        self.row = np.concatenate(
            [order[~self.soft], order[self.soft & self.has_low], order[self.soft & self.has_high]]
        )
        hard, lows = int((~self.soft).sum()), int((self.soft & self.has_low).sum())
        self.side = np.zeros(len(self.row), dtype=int)
        self.side[hard : hard + lows], self.side[hard + lows :] = 1, -1
        self.of_soft = np.cumsum(self.soft) - 1  # which of the excesses is that of a row

    def limits(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the rows of G."""
        low = np.where(self.has_low & np.isinf(low), -NOWHERE, low)[self.row]
        high = np.where(self.has_high & np.isinf(high), NOWHERE, high)[self.row]
        return np.where(self.side < 0, -np.inf, low), np.where(self.side > 0, np.inf, high)


class Condensed(Form):
    """Inputs of all stages, then the excesses; dense."""

    def __init__(self, programs: Sequence[Program]) -> None:
        super().__init__(programs)
        self.many = len(programs[0].dense_g)
        self.inputs = np.arange(self.many)
        self.size = self.many + len(self.plain)

    def matrices(self, program: Program) -> Matrices:
        """Of one program, dense."""
        n, size = self.many, self.size
        P, q = np.zeros((size, size)), np.concatenate([program.dense_g, self.plain])
        P[:n, :n] = program.dense_H
        P[range(n, size), range(n, size)] = self.square
        G = np.zeros((len(self.row), size))
        G[:, :n] = program.dense_rows[self.row]
        for i, (row, side) in enumerate(zip(self.row, self.side, strict=True)):
            if side:
                G[i, n + self.of_soft[row]] = side
        low, high = self.limits(program.dense_low, program.dense_high)
        bounds = np.vstack([program.bounds.reshape(-1, 2), np.tile([0.0, np.inf], (size - n, 1))])
        return Matrices(P, q, np.zeros((0, size)), np.zeros(0), G, low, high, bounds)


class Stages(Form):
    """States, inputs and excesses of each stage, one stage behind the other; sparse."""

    def __init__(self, programs: Sequence[Program]) -> None:
        super().__init__(programs)
        first = programs[0]
        self.horizon, self.nx, self.nu = len(first.A), first.A.shape[1], first.B.shape[2]
        n, nx, nu = self.horizon, self.nx, self.nu
        counts = np.bincount(first.stage[self.soft], minlength=n + 1)
        sizes = nx + nu * (np.arange(n + 1) < n) + counts
        starts = np.cumsum(sizes) - sizes
        self.size = int(sizes.sum())
        self.states = starts[:, None] + np.arange(nx)
        self.inputs = (starts[:-1, None] + nx + np.arange(nu)).ravel()
        in_stage = np.arange(len(self.plain)) - (np.cumsum(counts) - counts)[first.stage[self.soft]]
        self.excess = (starts + sizes - counts)[first.stage[self.soft]] + in_stage
        own = np.pad(self.inputs.reshape(n, nu), ((1, 1), (0, 0)), constant_values=-1)  # none before and behind
        self.places = np.hstack([self.states, own[:-1], own[1:]])  # of what H and rows count, by stage
        # patterns of all stages and programs together
        of_H = np.any([(p.H != 0) for p in programs], axis=0)
        of_H[:-1] |= of_H[:-1].any(axis=0)
        self._H = np.argwhere(of_H & (self.places[:, :, None] >= 0) & (self.places[:, None, :] >= 0))
        of_A, of_B = (np.any([getattr(p, m) != 0 for p in programs], axis=(0, 1)) for m in "AB")
        self._A, self._B = np.argwhere(of_A), np.argwhere(of_B)
        of_rows = np.any([p.rows != 0 for p in programs], axis=0)[self.row]
        self._rows = np.argwhere(of_rows & (self.places[first.stage[self.row]] >= 0))
        self._stage = first.stage

    def _sparse(self, rows: Any, columns: Any, values: Any, shape: tuple[int, int]) -> Any:
        return sp.coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape).tocsc()

    def matrices(self, program: Program) -> Matrices:
        """Of one program, sparse."""
        n, nx, size = self.horizon, self.nx, self.size
        i, a, b = self._H.T
        rows, columns, values = [self.places[i, a], self.excess], [self.places[i, b], self.excess], [program.H[i, a, b]]
        P = self._sparse(rows, columns, [*values, self.square], (size, size))
        q = np.zeros(size)
        used = self.places >= 0
        np.add.at(q, self.places[used], program.g[used])
        q[self.excess] = self.plain
        # the first states, then each stage's next ones: next - A x - B u = c
        stage = np.arange(n)[:, None]
        ra, ca = self._A.T
        rb, cb = self._B.T
        own = self.inputs.reshape(n, self.nu)
        A = self._sparse(
            [np.arange((n + 1) * nx), (nx * (stage + 1) + ra).ravel(), (nx * (stage + 1) + rb).ravel()],
            [self.states.ravel(), self.states[:-1][:, ca].ravel(), own[:, cb].ravel()],
            [np.ones((n + 1) * nx), -program.A[:, ra, ca].ravel(), -program.B[:, rb, cb].ravel()],
            ((n + 1) * nx, size),
        )
        rows_at, entry = self._rows.T
        limited = self.row[rows_at]
        with_excess = np.flatnonzero(self.side)
        G = self._sparse(
            [rows_at, with_excess],
            [self.places[self._stage[limited], entry], self.excess[self.of_soft[self.row[with_excess]]]],
            [program.rows[limited, entry], self.side[with_excess].astype(float)],
            (len(self.row), size),
        )
        low, high = self.limits(program.low, program.high)
        bounds = np.tile([-np.inf, np.inf], (size, 1))
        bounds[self.inputs] = program.bounds.reshape(-1, 2)
        bounds[self.excess, 0] = 0.0
        return Matrices(P, q, A, np.concatenate([program.start, program.c.ravel()]), G, low, high, bounds)
