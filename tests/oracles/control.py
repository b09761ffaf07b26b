"""Tracking problem of a linear car in plain NumPy. L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. 5-3 to 5-8.

``J = sum of |y_i - q_i|^2_Q + |u_i - r_i|^2_R + |u_i - u_(i-1)|^2_S over the steps, + |y_N - q_N|^2_end``. A stage of
several steps holds its input: its first two terms count once a step, its change from the stage before over the distance
between both stages' middles.
"""

import numpy as np

from tests.oracles import vehicles


def path_errors(car, v_x, errors, delta, curvature):
    """Rates of e_y, e_y', e_psi, e_psi' of the linear bicycle beside a path of constant curvature.

    ``e_y' = v_y + v_x e_psi`` and ``e_psi' = r - v_x curvature``, differentiated once more.
    """
    _, e_y_dot, e_psi, e_psi_dot = errors
    v_y, r = e_y_dot - v_x * e_psi, e_psi_dot + v_x * curvature
    v_y_dot, r_dot = vehicles.bicycle(car, v_y, r, delta, v_x)
    return [e_y_dot, v_y_dot + v_x * e_psi_dot, e_psi_dot, r_dot]


def responses(A, B, x, lengths):
    """States at the start of every stage and at the end: without input, and by each input of each stage."""
    n, m, stages = len(A), B.shape[1], len(lengths)
    free, forced = [np.array(x, dtype=float)], [np.zeros((n, stages * m))]
    for i, steps in enumerate(lengths):
        state, by = free[-1], forced[-1]
        for _ in range(steps):
            state, by = A @ state, A @ by
            by[:, i * m : (i + 1) * m] += B
        free.append(state)
        forced.append(by)
    return np.array(free), np.array(forced)


def squares(A, B, x, before, lengths, *, Q, R, S, end, wanted, wanted_inputs):
    """Matrix and vector with ``J = |matrix @ u - vector|^2``, for u stage by stage; Q and end are over the states."""
    m = B.shape[1]
    free, forced = responses(A, B, x, lengths)
    rows, right = [], []
    for i in range(len(lengths) + 1):
        weight = np.sqrt(end if i == len(lengths) else lengths[i] * np.asarray(Q))
        rows.append(weight[:, None] * forced[i])
        right.append(weight * (wanted[i] - free[i]))
    for i, steps in enumerate(lengths):
        here = np.zeros((m, m * len(lengths)))
        here[:, i * m : (i + 1) * m] = np.eye(m)
        rows.append(np.sqrt(steps * np.asarray(R))[:, None] * here)
        right.append(np.sqrt(steps * np.asarray(R)) * wanted_inputs[i])
        last = np.zeros_like(here)
        if i:
            last[:, (i - 1) * m : i * m] = np.eye(m)
        weight = np.sqrt(np.asarray(S) / apart(lengths)[i])
        rows.append(weight[:, None] * (here - last))
        right.append(weight * (np.zeros(m) if i else np.asarray(before)))
    return np.vstack(rows), np.concatenate(right)


def apart(lengths):
    """Steps between the middles of a stage and of the one before; 1 for the first, which follows a single step."""
    before = np.concatenate([[1], lengths[:-1]])
    return (before + np.asarray(lengths)) / 2


def limits(A, B, x, before, lengths, dt, *, inputs, rates, states):
    """``rows @ u`` and its bounds, shape (n_rows,) each: inputs, their changes, states at the end of each stage.

    ``inputs`` and ``rates`` are one (low, high) per input, ``states`` maps a state's number to its (low, high).
    """
    m, size = B.shape[1], B.shape[1] * len(lengths)
    eye, far = np.eye(size), apart(lengths)
    low, high = (np.tile([pair[k] for pair in inputs], len(lengths)) for k in (0, 1))
    change = eye - np.eye(size, k=-m)
    base = np.concatenate([before, np.zeros(size - m)])
    slow, fast = (np.concatenate([[pair[k] * dt * f for pair in rates] for f in far]) + base for k in (0, 1))
    free, forced = responses(A, B, x, lengths)
    rows, lows, highs = [eye, change], [low, slow], [high, fast]
    for j, (bottom, top) in states.items():
        rows.append(forced[1:, j])
        lows.append(bottom - free[1:, j])
        highs.append(top - free[1:, j])
    return np.vstack(rows), np.concatenate(lows), np.concatenate(highs)
