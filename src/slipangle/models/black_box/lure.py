"""Linear state space with static nonlinearities fed back: a system of Lur'e."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.fields import Count
from slipangle.models.black_box.model import BlackBoxModel, numbered, shifted
from slipangle.models.model import derived
from slipangle.ops import Vector, matmul, tanh

Curve = Literal["hardening", "saturation"]


@dataclass(frozen=True, kw_only=True)
class LureModel(BlackBoxModel):
    """``x(k+1) = A x + B d + E phi(W x + V d)``, ``y = C x + D d + y_0``, ``d = u - u_0``.

    A few branches of one static curve turn the linear model into one with, say, a stiffening spring or friction.
    Both curves are a line far out, up to something bounded. So where ``radius`` is below 1 every bounded input gives a
    bounded free run, whatever happens near rest.

    Parameters
    ----------
    A, B, C, D : array, shapes (order, order), (order, n_inputs), (n_outputs, order), (n_outputs, n_inputs)
        The linear part.
    W : array, shape (branches, order)
        What each branch sees of the state.
    V : array, shape (branches, n_inputs)
        What each branch sees of the input.
    E : array, shape (order, branches)
        Where each branch acts.
    curve : {"hardening", "saturation"}
        ``phi(z) = z - tanh(z)``, a cubic that ends as a line, or ``tanh(z)``.
    u_offset, y_offset : array, shapes (n_inputs,), (n_outputs,)
        Input and output at rest.
    memory : int
        Samples from which `initial_state` estimates the state by least squares.

    Source: M. Schoukens, K. Tiels, Automatica 85, 2017: block-oriented models, among them linear ones with nonlinear
    feedback.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    W: np.ndarray
    V: np.ndarray
    E: np.ndarray
    u_offset: np.ndarray
    y_offset: np.ndarray
    curve: Curve = "hardening"
    memory: Count = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        n, ny, nu = len(np.atleast_2d(self.A)), len(self.outputs), len(self.inputs)
        h = len(np.atleast_2d(self.W))
        shapes = {"A": (n, n), "B": (n, nu), "C": (ny, n), "D": (ny, nu), "W": (h, n), "V": (h, nu), "E": (n, h)}
        shapes |= {"u_offset": (nu,), "y_offset": (ny,)}
        self._freeze(shapes, f"{n} states, {nu} inputs, {ny} outputs and {h} branches")

    order = derived(lambda self: len(self.A))
    states = derived(lambda self: numbered(self.order))

    @property
    def radius(self) -> float:
        """Spectral radius of the dynamics far from rest [-]; below 1, no bounded input makes it diverge."""
        return float(np.abs(np.linalg.eigvals(far_out(self.curve, self.A, self.E, self.W))).max())

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        d = shifted(u, -self.u_offset)
        bent = bend(self.curve, matmul(self.W, x) + matmul(self.V, d))
        return matmul(self.A, x) + matmul(self.B, d) + matmul(self.E, bent)

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs at the same sample."""
        return shifted(matmul(self.C, x) + matmul(self.D, shifted(u, -self.u_offset)), self.y_offset)

    def initial_state(self, data: Dataset) -> np.ndarray:
        """State at the last sample of ``data``: Gauss-Newton on the free-run error over all of them.

        Where the samples do not determine the state, the smallest one that explains them is taken.
        """
        y, u = data.select(outputs=self.outputs).y, data.select(inputs=self.inputs).u
        x = np.zeros(self.order)
        errors, by_x = self._fit_error(x, u, y)
        for _ in range(20):
            step: Any = np.linalg.lstsq(by_x, errors, rcond=1e-8)[0]
            for _ in range(8):
                after, slope = self._fit_error(x + step, u, y)
                if after @ after < errors @ errors:
                    break
                step = step / 4
            else:
                break
            done = errors @ errors - after @ after < 1e-10 * (errors @ errors)
            x, errors, by_x = x + step, after, slope
            if done:
                break
        for row in u[:-1]:
            x = self.step(x, row)
        return x

    def _fit_error(self, x: np.ndarray, u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Errors of the free run from ``x`` and its derivative, shapes (n * n_outputs,), (n * n_outputs, order)."""
        advance, see = self._with_slopes
        errors, rows, slope = [], [], np.eye(self.order)
        for k in range(len(u)):
            seen, by_x = see(x, u[k])
            errors.append(y[k] - np.asarray(seen).ravel())
            rows.append(np.asarray(by_x) @ slope)
            nxt, by_x = advance(x, u[k])
            x, slope = np.asarray(nxt).ravel(), np.asarray(by_x) @ slope
        return np.concatenate(errors), np.vstack(rows)

    @cached_property
    def _with_slopes(self) -> tuple[ca.Function, ca.Function]:
        x, u = ca.SX.sym("x", self.order), ca.SX.sym("u", self.n_inputs)
        nxt, seen = self.step(x, u), self.output(x, u)
        return (
            ca.Function("advance", [x, u], [nxt, ca.densify(ca.jacobian(nxt, x))]),
            ca.Function("see", [x, u], [seen, ca.densify(ca.jacobian(seen, x))]),
        )


def bend(curve: Curve, z: Vector) -> Vector:
    """The static curve of each branch."""
    return tanh(z) if curve == "saturation" else z - tanh(z)


def far_out(curve: Curve, A: np.ndarray, E: np.ndarray, W: np.ndarray) -> np.ndarray:
    """A and what the curves add to it far from rest, where they are lines."""
    return A if curve == "saturation" else A + E @ W
