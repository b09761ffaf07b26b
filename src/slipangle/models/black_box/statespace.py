"""Linear state space in innovation form."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy import linalg

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.black_box.model import BlackBoxModel, numbered, shifted
from slipangle.models.model import FitInfo, derived
from slipangle.numerics.linear_response import LTI
from slipangle.ops import Vector, concatenate, matmul

_UNLIKE = 10.0  # over another output's residuals, from which units are unlike; from its square on they are for sure


@dataclass(frozen=True, kw_only=True)
class StateSpaceModel(BlackBoxModel):
    """``x(k+1) = A x(k) + B (u - u_0) + K e(k)``, ``y(k) = C x(k) + D (u - u_0) + y_0 + e(k)``.

    The one-step-ahead predictor is ``x(k+1) = A x + B (u - u_0) + K (y - C x - D (u - u_0) - y_0)``, exactly. With an
    invertible A the state is x and measuring moves it by ``A^-1 K e``; otherwise the state holds e too.

    Parameters
    ----------
    A : array, shape (order, order)
    B : array, shape (order, n_inputs)
    C : array, shape (n_outputs, order)
    D : array, shape (n_outputs, n_inputs), optional
        Direct feedthrough; by default zero.
    K : array, shape (order, n_outputs), optional
        Gain of the innovation e; by default zero, all disturbance being noise on the output.
    x0 : array, shape (n_experiments, order), optional
        State at the first sample of each training experiment, where it was estimated.
    u_offset, y_offset : array, shapes (n_inputs,), (n_outputs,), optional
        Input u_0 and output y_0 at rest, in their units; by default zero.
    memory : int
        Samples from which `initial_state` estimates the state by least squares; by default ``3 order + 3``.

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 4.3.
    """

    affine = True
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray = field(default=None)  # type: ignore[assignment]
    K: np.ndarray = field(default=None)  # type: ignore[assignment]
    memory: int = 0
    x0: np.ndarray | None = None
    u_offset: np.ndarray = field(default=None)  # type: ignore[assignment]
    y_offset: np.ndarray = field(default=None)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        super().__post_init__()
        n, ny, nu = len(np.atleast_2d(self.A)), len(self.outputs), len(self.inputs)
        shapes = {"A": (n, n), "B": (n, nu), "C": (ny, n), "D": (ny, nu), "K": (n, ny)}
        shapes |= {"u_offset": (nu,), "y_offset": (ny,)}
        if self.x0 is not None:
            object.__setattr__(self, "x0", np.reshape(self.x0, (-1, n)))
            shapes["x0"] = np.shape(self.x0)
        self._freeze(shapes, f"{n} states, {nu} inputs and {ny} outputs")
        if self.memory < 0:
            raise ParameterError(f"memory is {self.memory}; expected at least 1 sample, or 0 for 3 order + 3")
        if self.memory == 0:
            object.__setattr__(self, "memory", 3 * n + 3)

    order = derived(lambda self: len(self.A))

    @property
    def poles(self) -> np.ndarray:
        """Eigenvalues of A."""
        return np.linalg.eigvals(self.A)

    def with_estimates(self, values: np.ndarray) -> Self | None:
        """Entries of the matrices as the fit names them; None without a fit that does."""
        info = self.fit_info
        if info is None or "A[0,0]" not in info.names:
            return None
        parts: dict[str, np.ndarray] = {}
        for name, value in zip(info.names, values, strict=True):
            key, _, place = name.partition("[")
            part = parts.setdefault(key, np.array(getattr(self, key), dtype=float))
            part[tuple(int(k) for k in place[:-1].split(","))] = value
        return replace(self, **parts, fit_info=replace(info, values=np.array(values, dtype=float)))

    def modes(self) -> FitInfo:
        """Poles and steady gains with their covariance, which, unlike entries of A, do not hang on the states' basis.

        Raises ParameterError if the fit did not tell how uncertain A is, as that of `Subspace` does not.

        Names are ``modulus[i]`` and ``angle[i]`` of every pole that is not below the real axis [rad] nor zero, largest
        modulus first, and ``gain[y,u]`` of every output and input; the covariance is carried over from that of the
        entries to first order.
        """
        info = self.fit_info
        if info is None or "A[0,0]" not in info.names:
            raise ParameterError(
                "the fit does not tell how uncertain A is; expected a state space that StateSpace or PEM fitted"
            )
        n, nu, ny = self.order, len(self.inputs), len(self.outputs)
        each: Any = linalg.eig(self.A, left=True, right=True)
        pole, left, right = each[0], each[1].conj().T, each[2]
        order = np.argsort(-np.abs(pole), kind="stable")
        kept = [i for i in order if np.imag(pole[i]) >= 0 and pole[i] != 0]  # without states that only wait
        scale = np.einsum("ij,ji->i", left[kept], right[:, kept])
        after = np.linalg.solve((np.eye(n) - self.A).T, self.C.T).T
        before = np.linalg.solve(np.eye(n) - self.A, self.B)
        slope = np.zeros((2 * len(kept) + ny * nu, len(info.names)))
        unit = {"A": after, "B": after, "C": np.eye(ny), "D": np.eye(ny)}
        driven = {"A": before, "B": np.eye(nu), "C": before, "D": np.eye(nu)}
        for column, name in enumerate(info.names):
            if name[0] not in unit or name[1] != "[":
                continue
            i, j = (int(k) for k in name[2:-1].split(","))
            slope[2 * len(kept) :, column] = np.outer(unit[name[0]][:, i], driven[name[0]][j]).ravel()
            if name[0] == "A":
                turn = left[kept, i] * right[j, kept] / (scale * pole[kept])  # of the pole's logarithm
                slope[0 : 2 * len(kept) : 2, column] = turn.real * np.abs(pole[kept])
                slope[1 : 2 * len(kept) : 2, column] = turn.imag
        names = [f"{what}[{i}]" for i in range(len(kept)) for what in ("modulus", "angle")]
        names += [f"gain[{o},{u}]" for o in self.outputs for u in self.inputs]
        values = np.column_stack([np.abs(pole[kept]), np.angle(pole[kept])]).ravel()
        return replace(
            info,
            names=tuple(names),
            units=("-", "rad") * len(kept) + ("-",) * (ny * nu),
            values=np.concatenate([values, (after @ self.B + self.D).ravel()]),
            covariance=slope @ info.covariance @ slope.T,
        )

    @derived
    def states(self) -> tuple[str, ...]:
        """``x0``, ``x1``, ...; then the innovations ``e_<output>`` where A is singular."""
        own = numbered(self.order)
        return own if self._gain is not None else (*own, *(f"e_{o}" for o in self.outputs))

    @cached_property
    def _gain(self) -> np.ndarray | None:
        """How far a unit innovation moves the state at its own sample, or None where A cannot be inverted."""
        if not self.K.any():
            return np.zeros_like(self.K)
        return None if np.linalg.cond(self.A) > 1e7 else np.linalg.solve(self.A, self.K)

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        n = self.order
        nxt = matmul(self.A, x[:n]) + matmul(self.B, shifted(u, -self.u_offset))
        if self._gain is not None:
            return nxt
        return concatenate([nxt + matmul(self.K, x[n:]), 0.0 * x[n:]])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs at the same sample."""
        y = matmul(self.C, x[: self.order])
        if self.D.any():
            y = y + matmul(self.D, shifted(u, -self.u_offset))
        return shifted(y, self.y_offset)

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """State after measuring ``y``: with `step` it makes the one-step-ahead predictor."""
        n = self.order
        e = y - self.output(x, u)
        return x + matmul(self._gain, e) if self._gain is not None else concatenate([x[:n], e])

    @cached_property
    def predictor(self) -> LTI:
        """One-step-ahead prediction: a system from ``[u - u_0, y - y_0]`` to ``y_hat - y_0``."""
        K, D = self.K, self.D
        B = np.hstack([self.B - K @ D, K])
        return LTI(A=self.A - K @ self.C, B=B, C=self.C, D=np.hstack([D, np.zeros((len(D), len(D)))]))

    def initial_state(self, data: Dataset) -> np.ndarray:
        """State at the last sample of ``data``: least squares on the one-step-ahead errors over all of them.

        Errors of several outputs count alike as long as the fit's residuals are of like size in their units, up to a
        factor of 10, and from 100 on over the residuals' standard deviations.
        Where the samples do not determine the state, the smallest one that explains them is taken.
        """
        u, y = data.columns(self.inputs) - self.u_offset, data.columns(self.outputs) - self.y_offset
        predictor, n = self.predictor, self.order
        z = np.hstack([u, y])
        free = self._memory_powers if len(z) == self.memory else self._powers(len(z))
        driven, forced = z @ predictor.B.T, np.zeros((len(z), n))
        for k in range(len(z) - 1):  # few samples
            forced[k + 1] = predictor.A @ forced[k] + driven[k]
        last = y - forced @ self.C.T - z @ predictor.D.T
        rows, size = (self.C @ free).reshape(-1, n), self._size
        if size is not None:
            rows, last = rows / np.tile(size, len(z))[:, None], last / size
        first: Any = np.linalg.lstsq(rows, last.ravel(), rcond=1e-10)[0]
        x = forced[-1] + free[-1] @ first
        e = y[-1] - self.C @ x - self.D @ u[-1]
        return x + self._gain @ e if self._gain is not None else np.concatenate([x, e])

    @cached_property
    def _size(self) -> np.ndarray | None:
        """What errors of each output count over, shape (n_outputs,); None where all count alike, or none is known."""
        size = np.zeros(0) if self.fit_info is None else self.fit_info.noise_std
        known = len(size) == self.n_outputs > 1 and np.isfinite(size).all() and size.min() > 0
        unlike = np.log10(size.max() / size.min()) / np.log10(_UNLIKE) - 1.0 if known else 0.0
        return (size / size.max()) ** min(unlike, 1.0) if unlike > 0 else None

    def _powers(self, count: int) -> np.ndarray:
        """Of the predictor's A from the zeroth on, shape (count, order, order)."""
        powers = np.empty((count, self.order, self.order))
        powers[0] = np.eye(self.order)
        for k in range(count - 1):
            np.matmul(self.predictor.A, powers[k], out=powers[k + 1])
        return powers

    @cached_property
    def _memory_powers(self) -> np.ndarray:
        return self._powers(self.memory)

    @cached_property
    def _system(self) -> LTI:
        B, D, u0 = self.B, self.D, self.u_offset
        return LTI(A=self.A, B=B, C=self.C, D=D, f=-B @ u0, g=self.y_offset - D @ u0)

    def free_run(self, x0: np.ndarray, u: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Whole blocks of samples at once."""
        first = np.asarray(self.step(x0, u[0]))[: self.order]
        return self._system.respond(first, u[1:])[0]

    @cached_property
    def _tracker(self) -> LTI:
        """The predictor with its states as outputs."""
        n, seen = self.order, self.predictor
        return replace(seen, C=np.eye(n), D=np.zeros((n, seen.B.shape[1])))

    def track(self, x0: np.ndarray, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whole blocks of samples at once."""
        first = np.asarray(self.step(x0, u[0]))[: self.order]
        x = self._tracker.respond(first, np.hstack([u - self.u_offset, y - self.y_offset])[1:])[0]
        return x if self._gain is not None else np.hstack([x, np.zeros((len(x), self.n_outputs))])

    def outputs_at(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """As two products."""
        return x[:, : self.order] @ self.C.T + (u - self.u_offset) @ self.D.T + self.y_offset

    def transformed(self, T: np.ndarray) -> Self:
        """The same model with the state ``T x``."""
        inverse: Any = linalg.inv(T)
        x0 = None if self.x0 is None else self.x0 @ T.T
        return replace(self, A=T @ self.A @ inverse, B=T @ self.B, C=self.C @ inverse, K=T @ self.K, x0=x0)
