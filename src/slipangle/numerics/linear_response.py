"""Responses of linear systems at the speed of matrix products: whole blocks of samples at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

CHUNK = 1 << 15  # samples whose temporary arrays stay in the cache


@dataclass(frozen=True, kw_only=True)
class LTI:
    """``x(k+1) = A x(k) + B u(k) + f``, ``y(k) = C x(k) + D u(k) + g``, numbers only.

    `respond` cuts the record into blocks of ``block`` samples. Within a block the outputs are one product with
    the impulse response; from block to block the state obeys the same kind of equation with ``A**block``, which is
    solved by the same method. So the cost is that of matrix products, and sequential work is a small share.
    """

    A: np.ndarray  # (n_states, n_states)
    B: np.ndarray  # (n_states, n_inputs)
    f: np.ndarray | None = None  # (n_states,), constant drive of the state
    C: np.ndarray  # (n_outputs, n_states)
    D: np.ndarray  # (n_outputs, n_inputs)
    g: np.ndarray | None = None  # (n_outputs,), constant part of the output

    @property
    def block(self) -> int:
        """Samples per block, a power of two."""
        wide = max(self.B.shape[1], self.C.shape[0])
        return 8 if wide > 8 else 16 if wide > 2 else 32

    @cached_property
    def _blocks(self) -> tuple[np.ndarray, ...]:
        """Transposed maps of one block: inputs to state, state and inputs to outputs, constants; after each sample.

        The last two are the powers of A, (block + 1, n_states, n_states), and the constant part of the states.
        """
        a, b, c, d = self.A, self.B, self.C, self.D
        (nx, nu), ny, length = b.shape, len(c), self.block
        powers, power = np.eye(nx)[None], a
        while len(powers) < length:  # twice as many each time
            powers, power = np.concatenate([powers, powers @ power]), power @ power
        observe, reach = c @ powers, powers @ b
        drift = np.zeros((length + 1, nx))
        if self.f is not None:
            np.cumsum(powers @ self.f, axis=0, out=drift[1:])
        impulse = np.concatenate([d[None], observe[:-1] @ b, np.zeros((length - 1, ny, nu))])  # D, C B, C A B, ..., 0
        lag = np.arange(length)[:, None] - np.arange(length)
        g = np.zeros(ny) if self.g is None else self.g
        return (
            reach[::-1].transpose(0, 2, 1).reshape(length * nu, nx).copy(),
            observe.reshape(length * ny, nx).T.copy(),
            impulse[lag].transpose(1, 3, 0, 2).reshape(length * nu, length * ny),
            (drift[:-1] @ c.T + g).ravel(),
            np.concatenate([powers, power[None]]),
            drift,
        )

    def respond(self, x0: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs at every row of ``u`` and the state one sample after the last.

        From ``x0``, the state at the first row, shape (n_states,), and inputs, shape (n_samples, n_inputs); gives
        shapes (n_samples, n_outputs) and (n_states,).
        """
        x = np.array(x0, dtype=float)
        n, length = len(u), self.block
        y = np.empty((n, len(self.C)))
        per_chunk = max(1, CHUNK // length) * length
        done = 0
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable system; the caller looks
            while n - done >= length:
                size = min(per_chunk, (n - done) // length * length)
                x = self._whole_blocks(x, u[done : done + size], y[done : done + size])
                done += size
            if done < n:
                x = self._part_of_a_block(x, u[done:], y[done:])
        return y, x

    def _whole_blocks(self, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Fill ``y`` for a whole number of blocks; returns the state after them."""
        reach, observe, toeplitz, constant, powers, drift = self._blocks
        wide = np.ascontiguousarray(u, dtype=float).reshape(len(u) // self.block, -1)
        starts = recurrence(powers[-1], wide @ reach + drift[-1], x)
        out = y.reshape(len(wide), -1)
        np.matmul(wide, toeplitz, out=out)
        out += starts[:-1] @ observe
        out += constant
        return starts[-1]

    def _part_of_a_block(self, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The same for fewer samples than a block has."""
        reach, observe, toeplitz, constant, powers, drift = self._blocks
        k, ny, wide = len(u), len(self.C), np.ascontiguousarray(u, dtype=float).ravel()
        out = wide @ toeplitz[: wide.size, : k * ny] + x @ observe[:, : k * ny] + constant[: k * ny]
        y[:] = out.reshape(k, ny)
        return powers[k] @ x + wide @ reach[len(reach) - wide.size :] + drift[k]


def recurrence(A: np.ndarray, v: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """States of ``x(k+1) = A x(k) + v(k)``, shape (..., n + 1, n_states), the first being ``x0``.

    A has shape (n_states, n_states), v (..., n, n_states), x0 (..., n_states).

    >>> recurrence(np.array([[0.5]]), np.ones((3, 1)), np.zeros(1)).ravel().tolist()
    [0.0, 1.0, 1.5, 1.75]
    """
    n, nx = v.shape[-2:]
    x = np.empty((*v.shape[:-2], n + 1, nx))
    x[..., 0, :] = x0
    length = 8
    whole = n // length if n > 4 * length else 0
    if whole:
        powers = [np.eye(nx)]
        for _ in range(length):
            powers.append(powers[-1] @ A)
        toeplitz = np.zeros((length, nx, length, nx))  # v(j) to x(i + 1)
        for i in range(length):
            for j in range(i + 1):
                toeplitz[i, :, j] = powers[i - j]
        flat = toeplitz.reshape(length * nx, length * nx)
        wide = v[..., : whole * length, :].reshape(*v.shape[:-2], whole, length * nx)
        starts = recurrence(powers[length], wide @ flat[-nx:].T, x0)
        inside = wide @ flat.T
        inside += starts[..., :-1, :] @ np.vstack(powers[1:]).T
        x[..., 1 : whole * length + 1, :] = inside.reshape(*v.shape[:-2], whole * length, nx)
    for k in range(whole * length, n):
        x[..., k + 1, :] = x[..., k, :] @ A.T + v[..., k, :]
    return x
