"""Whether a track's line is one that a car can follow: no fold, no noise of its points, no bend between its samples."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.spatial import cKDTree

from slipangle.errors import ModelWarning, ParameterError
from slipangle.paths.path import Path

_STRETCH = 10.0  # m, for a car of usual size and larger ones, in which a track does not turn to and fro by much
_NOISY = 0.08  # rad to and fro in a stretch, in the mean; race tracks have 0.001
_CROOKED = 1.2  # rad to and fro in one stretch; race tracks have 0.15
_ROUND, _TURNED = 4.0, 2.6  # m, for a car of usual size, in which no track turns by so many rad
_NEAR, _ALONG = 2.0, 0.9  # m, for a car of usual size, and cosine of an angle, where a line is on its own start
_BEHIND, _TWICE = 12.0, 0.2  # m, for a car of usual size, along a line before it is its own again; share that is
_MISSED = 0.1  # rad between two samples, that the curvature does not have


def require_resolved(track: Path, size: float) -> None:
    """Raise ParameterError if the track's line laps itself, folds back or has bends that its samples miss.

    Warns with ModelWarning of a line that turns to and fro as noise makes it, and of an open one that goes along
    itself; a slalom and a skidpad do so too, and are no mistake.
    ``size`` is that of the car over a usual one. [-]
    """
    again = _again(track, size)
    if again is not None:
        raise ParameterError(
            f"the line of '{track.name}' comes past its start again {again:.0f} m after it, {track.length - again:.0f} "
            "m before its end; expected one lap in driving order: cut the points that overlap"
        )
    _refuse_laps(track, size)
    h, k = track.spacing, track.curvature
    missed = np.abs(np.diff(track.psi) - 0.5 * h * (k[1:] + k[:-1]))
    folded = np.abs(_within(track, track.psi, _ROUND * size))
    if missed.max() > _MISSED or folded.max() > _TURNED:
        fold = folded.max() > _TURNED
        at = int(np.argmax(folded)) * h + 0.5 * _ROUND * size if fold else (int(np.argmax(missed)) + 0.5) * h
        what = f"{folded.max():.2g} rad within {_ROUND * size:.2g} m" if fold else f"{missed.max():.2g} rad unseen"
        raise ParameterError(
            f"the line of '{track.name}' folds back {at % track.length:.0f} m after its start ({what}), as points do "
            "that lie behind the one before; expected one lap in driving order: cut an overlap, give "
            "Path.from_points or a job's [lap] smoothing, or a smaller spacing= for a small track"
        )
    _warn_of_noise(track, _STRETCH * min(size, 1.0))


def _again(track: Path, size: float) -> float | None:
    """Where a closed line lies on its own start and goes along it, elsewhere than there; None where nowhere. [m]"""
    if not track.closed:
        return None
    width = sum(np.inf if edge is None else float(edge[0]) for edge in (track.left, track.right))
    near = min(_NEAR * size, 0.25 * width)
    apart = max(_ROUND * size, 2.0 * near)
    at = np.hypot(track.X - track.X[0], track.Y - track.Y[0]) < near
    at &= np.abs(np.cos(track.psi - track.psi[0])) > _ALONG
    at &= (track.s > apart) & (track.s < track.length - apart)
    return float(track.s[np.argmax(at)]) if at.any() else None


def _refuse_laps(track: Path, size: float) -> None:
    """Raise ParameterError if a closed line holds several laps, as a recording does; warn where an open one may."""
    every = max(round(size / track.spacing), 1)
    rows = slice(0, len(track.s) - int(track.closed), every)
    s, X, Y, psi = (column[rows] for column in (track.s, track.X, track.Y, track.psi))
    near = np.full(len(s), 2.0 * _NEAR * size)
    if track.right is not None and track.left is not None:
        near = np.minimum(near, 0.5 * (track.right + track.left)[rows])
    i, j = cKDTree(np.column_stack([X, Y])).query_pairs(2.0 * _NEAR * size, output_type="ndarray").T
    apart = np.abs(s[i] - s[j])
    apart = np.minimum(apart, track.length - apart) if track.closed else apart
    along = (apart > _BEHIND * size) & (np.cos(psi[i] - psi[j]) > _ALONG)
    along &= np.hypot(X[i] - X[j], Y[i] - Y[j]) < np.minimum(near[i], near[j])
    share = len(np.unique(np.concatenate([i[along], j[along]]))) / len(s)
    if share <= _TWICE:
        return
    said = (
        f"the line of '{track.name}' goes along itself again from {np.maximum(s[i], s[j])[along].min():.0f} m on, over "
        f"{share:.0%} of its length"
    )
    if track.closed:
        raise ParameterError(f"{said}; expected one lap in driving order: cut a recording of several laps to one")
    warnings.warn(
        f"{said}; if it is a recording of several laps, what is found is the time of them all: cut it to one lap",
        ModelWarning,
        stacklevel=4,
    )


def _warn_of_noise(track: Path, stretch: float) -> None:
    h, k = track.spacing, track.curvature
    turned, both = (_within(track, _summed(h, c), stretch) for c in (k, np.abs(k)))
    shaken = both - np.abs(turned)
    if shaken.mean() > _NOISY or shaken.max() > _CROOKED:
        at = (int(np.argmax(shaken)) * h + 0.5 * stretch) % track.length
        warnings.warn(
            f"the line of '{track.name}' turns to and fro by {shaken.max():.2g} rad within {stretch:.3g} m, {at:.0f} m "
            f"after its start, and by {shaken.mean():.2g} rad in the mean; if that is noise of its points, no slalom, "
            "its lap is nonsense: give Path.from_points or from_file smoothing=, the standard deviation of the points "
            "[m], a job smoothing in [lap], and cut an overlap past the start",
            ModelWarning,
            stacklevel=4,
        )


def _summed(h: float, k: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * h * (k[1:] + k[:-1]))])


def _within(track: Path, total: np.ndarray, length: float) -> np.ndarray:
    """What a total over the samples gains within a length from each sample on, across the start if closed."""
    n = min(max(round(length / track.spacing), 1), len(total) - 1)
    if track.closed:
        total = np.concatenate([total, total[1 : n + 1] + total[-1] - total[0]])
    return total[n:] - total[:-n]
