"""A linear model for tests, and the finite-horizon LQR by Riccati recursion."""

from dataclasses import dataclass, field

import numpy as np

from slipangle.models.model import Model
from slipangle.ops import matmul


@dataclass(frozen=True, eq=False)
class Linear(Model):
    """x+ = A x + B u, y = C x + D u."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float = 0.1
    states: tuple[str, ...] = ("p", "v")
    inputs: tuple[str, ...] = ("a",)
    outputs: tuple[str, ...] = ("y",)
    memory: int = field(default=1)

    def initial_state(self, data):
        return np.zeros(self.n_states)

    def step(self, x, u):
        return matmul(self.A, x) + matmul(self.B, u)

    def output(self, x, u):
        return matmul(self.C, x) + matmul(self.D, u)


def double_integrator(dt=0.1, feedthrough=0.0):
    return Linear(
        A=np.array([[1.0, dt], [0.0, 1.0]]),
        B=np.array([[0.5 * dt * dt], [dt]]),
        C=np.array([[1.0, 0.5]]),
        D=np.array([[feedthrough]]),
        dt=dt,
    )


def two_masses(dt=0.05):
    """Two inputs, four states."""
    k, c = 8.0, 0.6
    continuous = np.array([[0, 1, 0, 0], [-2 * k, -2 * c, k, c], [0, 0, 0, 1], [k, c, -2 * k, -2 * c]])
    drive = np.array([[0, 0], [1.0, 0], [0, 0], [0, 2.0]])
    from scipy.linalg import expm

    block = expm(dt * np.block([[continuous, drive], [np.zeros((2, 6))]]))
    return Linear(
        A=block[:4, :4],
        B=block[:4, 4:],
        C=np.eye(1, 4),
        D=np.zeros((1, 2)),
        dt=dt,
        states=("p1", "v1", "p2", "v2"),
        inputs=("a1", "a2"),
    )


def lqr(A, B, Q, R, S, end, horizon, x, before):
    """Optimal inputs, shape (horizon, n_inputs), for the cost of OCP; the change of input is the new input."""
    n, m = B.shape
    F = np.block([[A, B], [np.zeros((m, n)), np.eye(m)]])
    G = np.vstack([B, np.eye(m)])
    Qz = np.block([[Q, np.zeros((n, m))], [np.zeros((m, n)), R]])
    Nz, Rz = np.vstack([np.zeros((n, m)), R]), R + S
    P = np.block([[end, np.zeros((n, m))], [np.zeros((m, n)), np.zeros((m, m))]])
    gains = []
    for _ in range(horizon):
        K = np.linalg.solve(Rz + G.T @ P @ G, (Nz + F.T @ P @ G).T)
        P = Qz + F.T @ P @ F - (Nz + F.T @ P @ G) @ K
        gains.append(K)
    z, out = np.concatenate([x, before]), []
    for K in reversed(gains):
        z = F @ z - G @ (K @ z)
        out.append(z[n:])
    return np.array(out)
