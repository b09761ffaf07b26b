"""The simulated nonlinear system of Narendra and Parthasarathy, a test of NARX models. [1]_ appendix A.2, [2]_

References
----------
.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. A-1 to A-3.
.. [2] K. S. Narendra, K. Parthasarathy, Identification and control of dynamical systems using neural networks,
   IEEE Transactions on Neural Networks 1, 1990, example 4.
"""

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError

HOLD = 4  # samples of each window of the training input


def respond(u: np.ndarray) -> np.ndarray:
    """Output of the system from rest, shape (n,): ``y(k) = F[y(k-1), y(k-2), y(k-3), u(k-1), u(k-2)]``. [1]_ A-1, A-2

    The input ``u``, shape (n,), lies within -1 to 1. [-]

    >>> respond(np.array([1.0, 0.0, 0.0])).tolist()
    [0.0, 1.0, 0.0]
    """
    y = [0.0, 0.0, 0.0]  # rest before the first sample
    u = np.concatenate([np.zeros(3), np.asarray(u, dtype=float)])
    for k in range(3, len(u)):
        x1, x2, x3, x4, x5 = y[k - 1], y[k - 2], y[k - 3], u[k - 1], u[k - 2]
        y.append(float((x1 * x2 * x3 * x5 * (x3 - 1) + x4) / (1 + x2 * x2 + x3 * x3)))
    return np.array(y[3:])


def estimation(n: int = 800, *, seed: int = 0) -> Dataset:
    """Training data: random signs held for 4 of ``n`` samples, each window times a number drawn from [0, 1].

    ``seed`` is that of the input; [1]_ gives none. A ParameterError says that ``n`` is below 1.
    """
    _require(n)
    rng = np.random.default_rng(seed)
    windows = -(-n // HOLD)
    level = rng.choice([-1.0, 1.0], windows) * rng.uniform(0.0, 1.0, windows)
    return _record(np.repeat(level, HOLD)[:n], f"Narendra-Parthasarathy, random steps, seed {seed}")


def validation(n: int = 800) -> Dataset:
    """Test data: a sine, after 500 of ``n`` samples two; errors as of `estimation`. [1]_ eq. A-3"""
    _require(n)
    t = np.arange(1, n + 1)
    slow = np.sin(2 * np.pi * t / 250)
    u = np.where(t <= 500, slow, 0.8 * slow + 0.2 * np.sin(2 * np.pi * t / 25))
    return _record(u, "Narendra-Parthasarathy, sines")


def _record(u: np.ndarray, name: str) -> Dataset:
    return Dataset.from_arrays({"u": u}, {"y": respond(u)}, 1.0, name=name)


def _require(n: int) -> None:
    if n < 1:
        raise ParameterError(f"n is {n} samples; expected at least 1, such as 800")
