"""Polynomial models: ARX, ARMAX, output-error and Box-Jenkins in one form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.black_box.model import BlackBoxModel
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.model import derived
from slipangle.models.parameters import require_few_lags


def _realised(name: str) -> Any:
    """The method of that name of the realisation."""

    def method(self: PolynomialModel, *arguments: Any) -> Any:
        return getattr(self.realisation, name)(*arguments)

    method.__doc__ = f"`StateSpaceModel.{name}` of the realisation."
    return method


@dataclass(frozen=True, kw_only=True)
class PolynomialModel(BlackBoxModel):
    """``A(z) y = sum_i B_i(z) / F_i(z) (u_i - u_0i) + C(z) / D(z) e``, one output.

    A, C, D and F start with a 1 that is not stored: ``A(z) = 1 + A[0] z^-1 + ...``;
    ``B_i(z) = z^-nk_i (B_i[0] + B_i[1] z^-1 + ...)``.
    The state is that of an innovation form with exactly this one-step-ahead predictor.

    Parameters
    ----------
    A, C, D : array, shapes (na,), (nc,), (nd,)
        Coefficients after the leading 1; empty for none.
    B, F : sequence of array, one per input
        Numerators and denominators of the inputs.
    nk : int or tuple of int
        Samples from each input to the output; 0 where the output depends on the input at the same sample.
    u_offset : array, shape (n_inputs,), optional
        Inputs at rest.
    y_offset : float
        Output at rest.
    memory : int
        Samples from which `initial_state` estimates the state; by default ``3 order + 3``.

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 4.2.
    """

    affine = True
    A: np.ndarray
    B: Sequence[np.ndarray]
    C: np.ndarray
    D: np.ndarray
    F: Sequence[np.ndarray]
    nk: tuple[int, ...]
    u_offset: np.ndarray | None = None
    y_offset: float = 0.0
    memory: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        nu = len(self.inputs)
        if len(self.outputs) != 1:
            raise ParameterError(
                f"a polynomial model got {len(self.outputs)} outputs; expected one: make one model per output, or use "
                "ARX or a state space"
            )
        nk = self.nk * nu if len(self.nk) == 1 else self.nk
        if not len(self.B) == len(self.F) == len(nk) == nu or min(nk) < 0 or any(len(b) == 0 for b in self.B):
            raise ParameterError(
                f"{len(self.B)} numerators, {len(self.F)} denominators and delays {nk} for {nu} inputs; expected one "
                "of each per input, numerators not empty, delays of 0 or more"
            )
        require_few_lags(max(len(b) + k for b, k in zip(self.B, nk, strict=True)), "the polynomial model")
        own = vars(self)
        own.update({key: _frozen(own[key]) for key in ("A", "C", "D")}, nk=nk)
        own.update({key: tuple(map(_frozen, own[key])) for key in ("B", "F")})
        own["u_offset"] = _frozen(np.zeros(nu) if self.u_offset is None else self.u_offset)
        own["memory"] = self.memory or self.realisation.memory

    @cached_property
    def realisation(self) -> StateSpaceModel:
        """The same model as a state space in innovation form.

        An input that acts at once is one sample ahead of one that acts after a sample: with x of the latter model,
        ``x(k) - B u(k)`` is the state of the former.
        """
        A, B, C, K = realise(self.A, self.B, self.C, self.D, self.F, tuple(max(k, 1) for k in self.nk))
        direct = np.array(self.nk) == 0
        matrices: dict[str, Any] = {
            "A": A,
            "B": np.where(direct, A @ B, B),
            "C": C,
            "D": np.where(direct, C @ B, 0.0),
            "K": K,
        }
        offsets: dict[str, Any] = {"u_offset": self.u_offset, "y_offset": np.array([self.y_offset])}
        return StateSpaceModel(
            **matrices, **offsets, memory=self.memory, dt=self.dt, inputs=self.inputs, outputs=self.outputs
        )

    states = derived(lambda self: self.realisation.states)

    def with_estimates(self, values: np.ndarray) -> Self | None:
        """Coefficients in the order of the fit: A, B and F by input, C, D, then the offset; None without a fit."""
        info = self.fit_info
        own = [self.A, *self.B, *self.F, self.C, self.D]
        ends = np.cumsum([len(p) for p in own])
        if info is None or len(info.values) not in (ends[-1], ends[-1] + 1):
            return None
        A, *both, C, D, rest = np.split(np.asarray(values, dtype=float), ends)
        level = float(rest[0]) if len(rest) else self.y_offset
        nu, told = len(self.B), replace(info, values=np.array(values, dtype=float))
        return replace(self, A=A, B=both[:nu], F=both[nu:], C=C, D=D, y_offset=level, fit_info=told)

    @property
    def poles(self) -> np.ndarray:
        """Poles from the inputs to the output, input by input."""
        return np.concatenate([np.roots(np.convolve(one(self.A), one(f))) for f in self.F])

    step, output, correct = _realised("step"), _realised("output"), _realised("correct")
    initial_state, free_run = _realised("initial_state"), _realised("free_run")


def one(coefficients: np.ndarray) -> np.ndarray:
    """Coefficients with the leading 1."""
    return np.concatenate([[1.0], coefficients])


def realise(
    A: np.ndarray, B: Sequence[np.ndarray], C: np.ndarray, D: np.ndarray, F: Sequence[np.ndarray], nk: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Innovation form (A, B, C, K) in observer canonical blocks; all but C are affine in the coefficients.

    Delays are at least 1.

    Without F and D one block of order ``max(na, nc, nb + nk - 1)`` does; otherwise each input, the disturbance and
    the output recursion have a block of their own, whose first states add up to the output.
    """
    reach = [len(b) + k - 1 for b, k in zip(B, nk, strict=True)]
    nu = len(B)
    if len(D) == 0 and all(len(f) == 0 for f in F):
        n = max(len(A), len(C), *reach)
        a, c = _delayed(A, 1, n), _delayed(C, 1, n)
        state = np.eye(n, k=1)
        state[:, 0] -= a
        gain_u = np.column_stack([_delayed(b, k, n) for b, k in zip(B, nk, strict=True)])
        return state, gain_u, np.eye(1, n), (c - a)[:, None]
    sizes = [max(len(f), r) for f, r in zip(F, reach, strict=True)]
    sizes += [max(len(C), len(D)), len(A)]
    n, edges = sum(sizes), np.concatenate([[0], np.cumsum(sizes)])
    state, gain_u, K, see = np.zeros((n, n)), np.zeros((n, nu)), np.zeros((n, 1)), np.zeros((1, n))
    for i, size in enumerate(sizes):
        at = slice(edges[i], edges[i + 1])
        if size == 0:
            continue
        see[0, edges[i]] = 1.0
        state[at, at] = np.eye(size, k=1)
        if i < nu:
            state[at, edges[i]] -= _delayed(F[i], 1, size)
            gain_u[at, i] = _delayed(B[i], nk[i], size)
        elif i == nu:
            d = _delayed(D, 1, size)
            state[at, edges[i]] -= d
            K[at, 0] = _delayed(C, 1, size) - d
    last = slice(edges[-2], edges[-1])
    state[last] -= np.outer(A, see[0])
    K[last, 0] -= A
    return state, gain_u, see, K


def _delayed(b: np.ndarray, nk: int, n: int) -> np.ndarray:
    return np.concatenate([np.zeros(nk - 1), b, np.zeros(n - nk + 1 - len(b))])


def _frozen(values: np.ndarray) -> np.ndarray:
    value = np.array(values, dtype=float).ravel()
    value.setflags(write=False)
    return value
