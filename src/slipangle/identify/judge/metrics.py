"""RMSE, R2, fit and VAF. [1]_ eqs. 4-10 to 4-13.

References
----------
.. [1] L. C. Sousa, PhD thesis, PUC-Rio, 2023.
"""

from __future__ import annotations

import numpy as np

from slipangle.errors import ExcitationError


def rmse(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Root mean squared error of each column, in the unit of the output.

    >>> float(rmse(np.array([1.0, 2.0]), np.array([1.0, 4.0])).round(6))
    1.414214
    """
    return np.sqrt(np.mean((measured - predicted) ** 2, axis=0))


def r2(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Multiple correlation coefficient of each column; 1 is perfect. [-]"""
    centred = _centred(measured)
    return 1 - np.sum((measured - predicted) ** 2, axis=0) / np.sum(centred**2, axis=0)


def fit(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Normalised fit F of each column; 100 is perfect, 0 is the mean. [%]"""
    centred = _centred(measured)
    return 100 * (1 - np.linalg.norm(measured - predicted, axis=0) / np.linalg.norm(centred, axis=0))


def vaf(measured: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Variance accounted for, of each column; blind to a constant offset. [%]"""
    _centred(measured)
    return 100 * (1 - np.var(measured - predicted, axis=0) / np.var(measured, axis=0))


def _centred(measured: np.ndarray) -> np.ndarray:
    centred = measured - measured.mean(axis=0)
    if np.any(np.all(centred == 0, axis=0)):
        raise ExcitationError(
            "a measured output is constant on the test data, so fit, R2 and VAF are undefined; expected an output "
            "that moves: choose another test part or channel"
        )
    return centred
