"""Delays of linearised models: continuous time with late inputs to samples, and back."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import linalg, optimize

from slipangle.models.wrappers.delayed import interpolation
from slipangle.numerics.held import held, late

_SAME = 1e-7  # relative error up to which a sampled model is that of a continuous one


class LateInputs(NamedTuple):
    """A linear system whose inputs act late; in samples, ``delay`` is empty and the last states are past inputs."""

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, n_inputs)
    C: np.ndarray  # (n_outputs, n)
    D: np.ndarray  # (n_outputs, n_inputs)
    delay: np.ndarray  # (n_inputs,) [s]
    states: tuple[str, ...]


def sampled(system: LateInputs, inputs: tuple[str, ...], h: float) -> LateInputs:
    """Exactly what a system in continuous time does at its samples, inputs held over each of ``h`` seconds."""
    n, nu = system.B.shape
    parts = [late(system.A, system.B[:, j], float(system.delay[j]), h) for j in range(nu)]
    reach = [p.whole + (system.delay[j] > h * (p.whole + 1e-9)) for j, p in enumerate(parts)]  # past samples that count
    first = n + np.concatenate([[0], np.cumsum(reach)])
    size = int(first[-1])
    A, B = np.zeros((size, size)), np.zeros((size, nu))
    C, D = np.zeros((len(system.C), size)), np.zeros_like(system.D)
    A[:n, :n], C[:, :n] = held(system.A, system.B, h)[0], system.C
    names = list(system.states)
    for j, part in enumerate(parts):
        for column, back in ((part.newer, part.whole), (part.older, part.whole + 1)):
            if back > reach[j]:
                continue
            if back:
                A[:n, first[j] + back - 1] += column
            else:
                B[:n, j] += column
        if reach[j]:
            B[first[j], j] = 1.0
            A[first[j] + 1 : first[j + 1], first[j] : first[j + 1] - 1] += np.eye(int(reach[j]) - 1)
            C[:, first[j + 1] - 1] += system.D[:, j]
        else:
            D[:, j] = system.D[:, j]
        names += [f"{inputs[j]}(k-{i + 1})" for i in range(int(reach[j]))]
    return LateInputs(A, B, C, D, np.zeros(0), tuple(names))


def continuous(system: LateInputs, h: float) -> LateInputs | None:
    """The system in continuous time, inputs held and late, that does the same at the samples; None where none does.

    States that hold past inputs alone become delays. Where a late input is interpolated between samples, as `Delayed`
    does, it is the system and the delay that were interpolated.
    """
    own, A, taps, direct = _taps(system)
    nu = system.B.shape[1]
    poles: Any = linalg.eigvals(A) if len(A) else np.zeros(0)
    if any(p.real <= 1e-8 and abs(p.imag) < 1e-12 for p in poles):
        return None
    F = np.real(np.asarray(linalg.logm(A))) / h if len(A) else A
    G, D, delay = np.zeros((len(A), nu)), np.zeros((len(system.C), nu)), np.zeros(nu)
    for j in range(nu):
        found = _exact(F, taps[:, :, j], direct[:, :, j], h) or _interpolated(F, taps[:, :, j], direct[:, :, j], h)
        if found is None:
            return None
        G[:, j], D[:, j], delay[j] = found
    return LateInputs(F, G, system.C[:, own], D, delay, tuple(np.array(system.states, dtype=object)[own]))


def _taps(system: LateInputs) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """States that are no past inputs, their matrix, what moves them, shape (lags, n, n_inputs), and the outputs."""
    n = len(system.A)
    past = np.zeros(n, dtype=bool)
    while True:
        more = ~past & ~np.any(system.A[:, ~past] != 0, axis=1)
        if not more.any():
            break
        past |= more
    own, gone = np.flatnonzero(~past), np.flatnonzero(past)
    moved, seen = [system.B[own]], [system.D]
    held_back = system.B[gone]
    for _ in range(len(gone)):
        moved.append(system.A[np.ix_(own, gone)] @ held_back)
        seen.append(system.C[:, gone] @ held_back)
        held_back = system.A[np.ix_(gone, gone)] @ held_back
    return own, system.A[np.ix_(own, own)], np.array(moved), np.array(seen)


def _integral(F: np.ndarray, t: float) -> np.ndarray:
    """Of expm(F s) for s from 0 to t."""
    return held(F, np.eye(len(F)), t)[1]


def _exact(
    F: np.ndarray, taps: np.ndarray, direct: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """G, D and the delay of an input held over each sample, from what it does to states and outputs by lag."""
    size, n = np.abs(taps).max(initial=0.0), taps.shape[1]
    nonzero = np.flatnonzero(np.abs(taps).max(axis=1, initial=0.0) > _SAME * size) if size else np.zeros(0, dtype=int)
    seen = np.flatnonzero(np.abs(direct).max(axis=1, initial=0.0) > 0)
    if len(seen) > 1 or (len(nonzero) and nonzero[-1] > nonzero[0] + 1):
        return None
    if not len(nonzero):
        lag = int(seen[0]) if len(seen) else 0
        return np.zeros(n), direct[lag], lag * h
    whole = int(nonzero[0])
    back = np.linalg.inv(linalg.expm(F * h))
    both = taps[whole] + (back @ taps[whole + 1] if whole + 1 < len(taps) else 0.0)
    inverse = np.linalg.inv(_integral(F, h))

    def drive(part: float) -> np.ndarray:
        return inverse @ linalg.expm(F * part) @ both

    def error(part: float) -> float:
        return float(np.linalg.norm(_integral(F, h - part) @ drive(part) - taps[whole]) / size)

    part = 0.0
    if len(nonzero) > 1:
        grid = np.linspace(0.0, h, 21)
        k = int(np.argmin([error(p) for p in grid]))
        ends = grid[max(k - 1, 0)], grid[min(k + 1, 20)]
        part = float(optimize.minimize_scalar(error, bounds=ends, method="bounded", options={"xatol": 1e-13 * h}).x)
        for _ in range(3):  # the error has a tip at its end
            step = 1e-6 * h
            now = _integral(F, h - part) @ drive(part) - taps[whole]
            slope = (_integral(F, h - part - step) @ drive(part + step) - taps[whole] - now) / step
            part = float(np.clip(part - slope @ now / max(float(slope @ slope), 1e-300), 0.0, h))
    if error(part) > _SAME or (len(seen) and int(seen[0]) != whole + (part > 0)):
        return None
    return drive(part), direct[seen[0]] if len(seen) else direct[0], whole * h + part


def _interpolated(
    F: np.ndarray, taps: np.ndarray, direct: np.ndarray, h: float
) -> tuple[np.ndarray, np.ndarray, float] | None:
    """G, D and the delay where lags differ by a factor alone: weights that add up to 1 and keep straight lines."""
    both = np.hstack([taps, direct])
    whole = both.sum(axis=0)
    size = float(whole @ whole)
    if not size:
        return None
    weights = both @ whole / size
    if np.abs(both - weights[:, None] * whole).max() > _SAME * np.sqrt(size):
        return None
    lag = float(weights @ np.arange(len(weights)))
    wanted = interpolation(lag, len(weights)) if 0 <= lag <= len(weights) - 2 and len(weights) > 2 else [np.inf]
    if len(wanted) != len(weights) or np.abs(np.array(wanted, dtype=float) - weights).max() > 1e-6:
        return None
    n = taps.shape[1]
    return np.linalg.solve(_integral(F, h), whole[:n]), whole[n:], lag * h


def moved(A: np.ndarray, B: np.ndarray, t: float, impulse: bool) -> np.ndarray:
    """State at a time after an impulse or the begin of a step of one input, ``B`` of shape (n,)."""
    at, by = held(A, B[:, None], t)
    return at @ B if impulse else by[:, 0]
