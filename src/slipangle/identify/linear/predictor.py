"""Derivatives of a linear predictor's outputs, block by block, and least squares that keeps only triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.identify.linear.scales import sizes
from slipangle.numerics.linear_response import LTI, recurrence


@dataclass(frozen=True, kw_only=True)
class Point:
    """The predictor ``s+ = F s + G (u - u_0) + K (y - y_0)``, ``y_hat = C s + D (u - u_0) + y_0`` and its x0."""

    F: np.ndarray
    G: np.ndarray
    C: np.ndarray
    D: np.ndarray
    K: np.ndarray
    u_offset: np.ndarray
    y_offset: np.ndarray
    x0: np.ndarray


@dataclass
class Work:
    """Samples over which errors, and each of their derivatives, were run: what fits cost, whatever the machine."""

    done: float = 0.0
    most: float = np.inf  # from which on no step is begun

    @property
    def used_up(self) -> bool:
        """Whether no step is begun any more."""
        return self.done >= self.most


class Bank:
    """Responses of ``x+ = F x + e_i z_j, y = C x`` to every signal z_j from every unit vector e_i.

    These are the building blocks of all derivatives of a linear predictor. Whole blocks of samples are one matrix
    product. A record is fed in chunks, whole multiples of ``block`` except for the last.

    F has shape (n, n), C (n_outputs, n). Behind the ``n_signals`` signals comes one of zeros whose state starts at the
    unit matrix: the derivative with respect to the initial state.
    """

    def __init__(self, F: np.ndarray, C: np.ndarray, n_signals: int, block: int = 16) -> None:
        n, ny = len(F), len(C)
        self.block, self.n, self.ny, self.q = block, n, ny, n_signals + 1
        observe, powers = np.empty((block, ny, n)), np.empty((block, n, n))
        power: Any = np.eye(n)
        for i in range(block):
            observe[i], powers[i] = C @ power, power
            power = power @ F
        self.power = power
        toeplitz = np.zeros((block, ny, n, block))
        for i in range(1, block):
            toeplitz[i, :, :, :i] = observe[i - 1 :: -1].transpose(1, 2, 0)
        self.toeplitz = toeplitz.reshape(block * ny * n, block)
        self.observe = observe.reshape(block * ny, n)
        self.reach = powers[::-1].transpose(1, 2, 0).reshape(n * n, block)
        self.restart()

    def restart(self) -> None:
        """From rest again, for the next experiment."""
        self.state = np.zeros((self.n, self.q, self.n))
        self.state[:, -1] = np.eye(self.n)

    def respond(self, z: np.ndarray) -> np.ndarray:
        """Responses to the next samples of the signals, shape (n_samples, n_outputs, n, n_signals + 1)."""
        n_samples = len(z)
        n_blocks = -(-n_samples // self.block)
        padded = np.zeros((n_blocks * self.block, self.q))
        padded[:n_samples, :-1] = z
        columns = padded.reshape(n_blocks, self.block, self.q).transpose(1, 0, 2).reshape(self.block, -1)
        driven = (self.reach @ columns).reshape(self.n, self.n, n_blocks, self.q).transpose(1, 3, 2, 0)
        starts = recurrence(self.power, driven, self.state)  # unit vector, signal, block, state
        self.state = starts[:, :, -1].copy()
        before = starts[:, :, :-1].transpose(3, 0, 2, 1).reshape(self.n, -1)
        out = self.toeplitz @ columns
        out = out.reshape(self.block * self.ny, -1)
        out += self.observe @ before
        out = out.reshape(self.block, self.ny, self.n, n_blocks, self.q).transpose(3, 0, 1, 2, 4)
        return out.reshape(-1, self.ny, self.n, self.q)[:n_samples]

    def chunk(self) -> int:
        """Samples per call that keep the responses within tens of megabytes."""
        return max(1, min(4096, 2_000_000 // (self.ny * self.n * self.q)) // self.block) * self.block


class Triangles:
    """Least squares of rows ``[local, shared | target]``, local unknowns differing by experiment.

    Memory is that of a few triangles, whatever the number of rows.
    """

    def __init__(self, n_local: int, n_shared: int) -> None:
        self.n_local, self.n_shared = n_local, n_shared
        self.shared = np.zeros((0, n_shared + 1))
        self.locals: list[np.ndarray] = []
        self._inverses: list[np.ndarray] = []
        self._open = np.zeros((0, n_local + n_shared + 1))

    def add(self, rows: np.ndarray) -> None:
        """More rows of the current experiment."""
        self._open = reduce_rows(np.vstack([self._open, rows]))

    def close(self) -> None:
        """End the current experiment: its local unknowns are eliminated.

        Where the rows do not determine all of them (states that the output does not show), the rows left over hold
        shared unknowns only and stay with those.
        """
        k = self.n_local
        top, rest = self._open[:k], self._open[k:, k:]
        if k:
            factors: Any = linalg.qr(top[:, :k], pivoting=True)
            size = np.abs(np.diag(factors[1]))
            rank = int(np.sum(size > 1e-11 * size.max(initial=0.0)))
            if rank < len(top):
                top = factors[0].T @ top
                top, rest = top[:rank], np.vstack([top[rank:, k:], rest])
        self.locals.append(top.copy())
        if len(rest):
            self.shared = reduce_rows(np.vstack([self.shared, rest]))
        self._open = np.zeros_like(self._open[:0])

    def solve_locals(self, shared: np.ndarray) -> np.ndarray:
        """Local unknowns for given shared ones, shape (n_experiments, n_local)."""
        k = self.n_local
        while len(self._inverses) < len(self.locals):
            self._inverses.append(np.linalg.pinv(self.locals[len(self._inverses)][:, :k], rcond=1e-12))
        found = [i @ (t[:, -1] - t[:, k:-1] @ shared) for i, t in zip(self._inverses, self.locals, strict=True)]
        return np.array(found).reshape(len(self.locals), k)

    def joined(self, *others: Triangles) -> Triangles:
        """Least squares of these rows and others together."""
        every, work = (self, *others), Triangles(self.n_local, self.n_shared)
        work.shared = reduce_rows(np.vstack([one.shared for one in every]))
        work.locals = [t for one in every for t in one.locals]
        work._inverses = [t for one in every for t in one._inverses]
        return work


def reduce_rows(rows: np.ndarray) -> np.ndarray:
    """Triangle with the same inner products: by Cholesky where columns are well apart, else by QR."""
    n, p = rows.shape
    if n > 2 * p:
        gram = rows.T @ rows
        scale = np.sqrt(np.diag(gram))
        if np.isfinite(scale).all() and scale.min() > 0:
            scaled = gram / np.outer(scale, scale)
            size = np.linalg.eigvalsh(scaled)
            if size[0] > 1e-9 * size[-1]:  # at least half of the digits survive
                return np.linalg.cholesky(scaled).T * scale
    return np.asarray(np.linalg.qr(rows, mode="r"))


@dataclass(frozen=True, kw_only=True)
class LinearFit:
    """B, D, the initial state of each experiment and the outputs' level, for given A, C, K.

    Errors of several outputs count in units of their ``sizes``, by default the standard deviations of the signals. The
    one-step-ahead error is linear in what is looked for. With ``offset`` the inputs' means become the input at rest and
    the outputs' level at that input is estimated.
    """

    A: np.ndarray
    C: np.ndarray
    K: np.ndarray
    direct: bool
    offset: bool
    data: Dataset
    sizes: tuple[np.ndarray, np.ndarray] | None = None  # (n_inputs,), (n_outputs,), of the channels

    def solve(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Least squares over all experiments: parts of the model, and what its `FitInfo` says of them."""
        data, work = self.data, self._triangles(self.data)
        theta, pinv = self._estimate(work)
        n, nu, ny, p = len(self.A), len(data.inputs), len(self.C), work.n_shared
        left = float(work.shared[p, p] ** 2) if len(work.shared) > p else 0.0
        dof = max(1, data.n_samples * ny - p - n * len(data.starts))
        names = [f"B[{i},{j}]" for i in range(n) for j in range(nu)]
        names += [f"D[{i},{j}]" for i in range(ny) for j in range(nu)] if self.direct else []
        names += [f"y_offset[{o}]" for o in data.outputs] if self.offset else []
        by = self._units(p)
        values, pinv = theta * by, pinv * by[:, None]
        values[p - ny :] += self._levels[1] if self.offset else 0.0
        noise = np.sqrt(left / dof) * self._sizes[1]
        told = {"names": tuple(names), "values": values, "covariance": pinv @ pinv.T * left / dof, "noise_std": noise}
        return self._parts(theta) | {"x0": work.solve_locals(theta)}, told

    def left_out(self, groups: Sequence[Dataset]) -> list[dict[str, Any]]:
        """Parts of the model but x0 by all groups of experiments, and by all but each in turn, for one pass over them.

        The groups together are the data.
        """
        each = [self._triangles(group) for group in groups]
        kept = [each, *([one for one in each if one is not left] for left in each)]
        return [self._parts(self._estimate(first.joined(*others))[0]) for first, *others in kept]

    @cached_property
    def _sizes(self) -> tuple[np.ndarray, np.ndarray]:
        return sizes(self.data) if self.sizes is None else self.sizes

    @cached_property
    def _scaled(self) -> tuple[np.ndarray, np.ndarray]:
        """C and K of signals in those sizes."""
        y = self._sizes[1]
        return self.C / y[:, None], self.K * y

    def _units(self, count: int) -> np.ndarray:
        """What the shared unknowns are multiplied by."""
        u, y = self._sizes
        each = [np.tile(1 / u, len(self.A)), *([np.outer(y, 1 / u).ravel()] if self.direct else [])]
        return np.concatenate([*each, *([y] if self.offset else [])])[:count]

    @cached_property
    def _levels(self) -> tuple[np.ndarray, np.ndarray]:
        """Of inputs and outputs, which the errors are linear around."""
        data = self.data
        if not self.offset:
            return np.zeros(len(data.inputs)), np.zeros(len(data.outputs))
        return np.array([data[c].mean() for c in data.inputs]), np.array([data[c].mean() for c in data.outputs])

    @cached_property
    def _systems(self) -> tuple[Bank, LTI]:
        """Responses to the inputs and the level, and the part of the prediction that K makes of the outputs."""
        F, ny = self.A - self.K @ self.C, len(self.C)
        C, K = self._scaled
        own = LTI(A=F, B=K, C=C, D=np.zeros((ny, ny)))
        return Bank(F, C, len(self.data.inputs) + self.offset), own

    def _triangles(self, data: Dataset) -> Triangles:
        """Of all rows, from experiments that are some of the data."""
        n, ny, nu = len(self.A), len(self.C), len(data.inputs)
        work = Triangles(n, n * nu + (ny * nu if self.direct else 0) + (ny if self.offset else 0))
        (bank, own), (u0, y0) = self._systems, self._levels
        size = bank.chunk()
        inputs, outputs = [data.index(c) for c in data.inputs], [data.index(c) for c in data.outputs]
        for start, stop in zip(data.starts, data.stops, strict=True):
            bank.restart()
            state = np.zeros(n)
            for a in range(start, stop, size):
                rows = data.values[a : min(a + size, stop)]
                u, y = (rows[:, inputs] - u0) / self._sizes[0], (rows[:, outputs] - y0) / self._sizes[1]
                known, state = own.respond(state, y)
                signals = np.hstack([u, np.ones((len(u), 1))]) if self.offset else u
                work.add(self._rows(bank.respond(signals), u, y - known))
            work.close()
        return work

    def _rows(self, response: np.ndarray, u: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Regressors of one chunk: x0, B, D, level; then the target."""
        n_samples, ny, n, _ = response.shape
        nu = u.shape[1]
        parts = [response[..., -1], response[..., :nu].reshape(n_samples, ny, n * nu)]
        unit = np.eye(ny)
        if self.direct:
            straight = unit[:, :, None] * u[:, None, None, :]  # sample, output, row of D, input
            back = np.einsum("kyij,il->kylj", response[..., :nu], self._scaled[1])
            parts.append((straight - back).reshape(n_samples, ny, ny * nu))
        if self.offset:
            parts.append(unit - np.einsum("kyi,il->kyl", response[..., nu], self._scaled[1]))
        parts.append(target[:, :, None])
        return np.concatenate(parts, axis=2).reshape(n_samples * ny, -1)

    def _estimate(self, work: Triangles) -> tuple[np.ndarray, np.ndarray]:
        """Least squares of the shared unknowns, and the inverse that made them."""
        p, ny = work.n_shared, len(self.C)
        r, target = work.shared[:p, :p], work.shared[:p, p]
        scale = np.maximum(np.linalg.norm(r, axis=0), 1e-300)
        pinv = np.linalg.pinv(r / scale, rcond=1e-12) / scale[:, None]
        theta = pinv @ target
        if self.offset:  # beside an integrator the initial state explains any level: keep the mean
            loose = np.arange(p) >= p - ny
            loose &= np.linalg.norm(r, axis=0) < 0.01 * np.sqrt(self.data.n_samples)
            theta[loose] = 0.0
            kept = ~loose
            theta[kept] = np.linalg.pinv(r[:, kept] / scale[kept], rcond=1e-12) @ target / scale[kept]
        return theta, pinv

    def _parts(self, theta: np.ndarray) -> dict[str, Any]:
        """B, D and levels of the shared unknowns."""
        n, ny, nu = len(self.A), len(self.C), len(self.data.inputs)
        (u0, y0), theta = self._levels, theta * self._units(len(theta))
        B, rest = theta[: n * nu].reshape(n, nu), theta[n * nu :]
        D = rest[: ny * nu].reshape(ny, nu) if self.direct else np.zeros((ny, nu))
        level = rest[-ny:] if self.offset else np.zeros(ny)
        return {"B": B, "D": D, "u_offset": u0, "y_offset": y0 + level}
