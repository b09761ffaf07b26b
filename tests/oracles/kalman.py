"""Extended Kalman filter in plain NumPy, all outputs at once, derivatives by differences.

D. Simon, Optimal State Estimation, 2006, sec. 13.2.
"""

import numpy as np


def slope(f, x):
    """Jacobian by central differences, exact to about 1e-9 of numbers near one."""
    h = 1e-6
    columns = [(np.asarray(f(x + h * e)) - np.asarray(f(x - h * e))).ravel() / (2 * h) for e in np.eye(len(x))]
    return np.column_stack(columns)


def correct(x, P, error, H, R):
    """State and covariance after a measurement that was off by ``error``."""
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    return x + K @ error, (np.eye(len(x)) - K @ H) @ P


def run(step, output, x, P, Q, R, u, y):
    """States and covariances after each sample; rows of ``y`` hold NaN where nothing was measured.

    ``Q`` is the covariance that a step adds. The first sample corrects only.
    """
    states, covariances = [], []
    for k, now in enumerate(u):
        if k:
            F = slope(lambda z, k=k: step(z, u[k - 1]), x)
            x, P = np.asarray(step(x, u[k - 1])).ravel(), F @ P @ F.T + Q
        seen = np.isfinite(y[k])
        if seen.any():
            H = slope(lambda z, now=now: output(z, now), x)[seen]
            error = (y[k] - np.asarray(output(x, now)).ravel())[seen]
            x, P = correct(x, P, error, H, R[np.ix_(seen, seen)])
        states.append(x)
        covariances.append(P)
    return np.array(states), np.array(covariances)
