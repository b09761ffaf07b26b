"""What a race log needs beyond a log: metres from degrees or from speeds, laps, corners with their phases."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy import integrate, ndimage

from slipangle.data.dataset import Dataset, join
from slipangle.errors import ParameterError, TooShortError

EARTH = 6_378_137.0  # radius of the equator [m], WGS 84
_FLAT = 0.00669437999014  # square of the ellipsoid's eccentricity, WGS 84
Phase = Literal["entry", "middle", "exit"]
PHASES = ("straight", "entry", "middle", "exit")


def equirectangular(
    latitude: np.ndarray, longitude: np.ndarray, *, origin: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """East and north of the origin, from angles in radians. [m, m]

    Good over a race track: the error grows with the square of the distance, about 0.1 m at 1 km and 45 degrees. The
    radii of curvature are those of the ellipsoid WGS 84 at the origin, as satellite receivers have it.

    Raises ParameterError if a latitude is beyond a pole (such as degrees would be) or there is no sample.

    Source: J. P. Snyder, Map Projections: A Working Manual, USGS, 1987, sec. 12; radii: eq. (4-18) and (4-20).

    Parameters
    ----------
    latitude, longitude : array, shape (n,)
        North and east positive. [rad]
    origin : (float, float), optional
        Latitude and longitude of the origin [rad]; by default the first sample.

    >>> x, y = equirectangular(np.array([0.0, 1e-4]), np.array([0.0, 0.0]))
    >>> round(float(y[1]), 2), float(x[1])
    (633.54, 0.0)
    """
    lat, lon = np.asarray(latitude, dtype=float), np.asarray(longitude, dtype=float)
    if len(lat) == 0 or np.abs(lat).max() > np.pi / 2 or np.abs(lon).max() > 2 * np.pi:
        raise ParameterError(
            f"{len(lat)} latitudes up to {np.abs(lat).max(initial=0.0):g} rad; expected at least one, within pi/2: "
            "convert degrees with slipangle.units.deg"
        )
    lat0, lon0 = origin if origin is not None else (float(lat[0]), float(lon[0]))
    around = np.angle(np.exp(1j * (lon - lon0)))  # across the date line too
    squeeze = 1.0 - _FLAT * np.sin(lat0) ** 2
    across, along = EARTH / np.sqrt(squeeze), EARTH * (1.0 - _FLAT) / squeeze**1.5
    return across * np.cos(lat0) * around, along * (lat - lat0)


def with_position(
    data: Dataset,
    latitude: str = "latitude",
    longitude: str = "longitude",
    *,
    origin: tuple[float, float] | None = None,
) -> Dataset:
    """The data with X (east) and Y (north) [m] from channels in radians, of an origin; see `equirectangular`."""
    x, y = equirectangular(data[latitude], data[longitude], origin=origin)
    return data.with_channel("X", x, "m").with_channel("Y", y, "m")


def with_dead_reckoning(data: Dataset) -> Dataset:
    """Add psi [rad], X and Y [m], integrated from ``r``, ``v_x`` and, if measured, ``v_y``; each experiment from 0.

    Good for a map, not for measuring: errors add up.
    """
    columns = []
    for part in data.experiments:
        v_y = part["v_y"] if "v_y" in part else 0.0
        psi = integrate.cumulative_trapezoid(part["r"], dx=part.dt, initial=0.0)
        east = part["v_x"] * np.cos(psi) - v_y * np.sin(psi)
        north = part["v_x"] * np.sin(psi) + v_y * np.cos(psi)
        x, y = (integrate.cumulative_trapezoid(v, dx=part.dt, initial=0.0) for v in (east, north))
        columns.append(np.column_stack([x, y, psi]))
    table = np.vstack(columns)
    for k, (name, unit) in enumerate((("X", "m"), ("Y", "m"), ("psi", "rad"))):
        data = data.with_channel(name, table[:, k], unit)
    return data.with_note("X, Y and psi are dead-reckoned from r, v_x and v_y: for maps only")


def lap_starts(data: Dataset, *, gate: tuple[float, float], heading: float, width: float = 30.0) -> np.ndarray:
    """Rows, rising, of the first samples after crossing a gate in its direction; none where it is never crossed.

    Raises ParameterError if the width is not positive.

    Parameters
    ----------
    data : Dataset
        With X and Y. [m]
    gate, width : (float, float), float
        Middle of the gate and how wide it is. [m]
    heading : float
        Direction of travel through it, from the X axis. [rad]
    """
    if not width > 0:
        raise ParameterError(f"the gate is {width} m wide; expected a positive width")
    crossings, offset = [], 0
    for part in data.experiments:
        dx, dy = part["X"] - gate[0], part["Y"] - gate[1]
        along = dx * np.cos(heading) + dy * np.sin(heading)
        across = -dx * np.sin(heading) + dy * np.cos(heading)
        crossed = (along[:-1] < 0) & (along[1:] >= 0) & (np.abs(across[1:]) <= 0.5 * width)
        crossings.append(offset + 1 + np.flatnonzero(crossed))
        offset += part.n_samples
    return np.concatenate(crossings).astype(int)


def laps(data: Dataset, starts: np.ndarray) -> Dataset:
    """Complete laps as experiments; what lies before the first and after the last crossing is left out.

    Raises TooShortError if there are fewer than two crossings in every experiment.
    """
    parts = []
    for a, b in zip(data.starts, data.stops, strict=True):
        rows = [int(row) for row in starts if a <= row < b]
        parts += [data.rows(i, j) for i, j in pairwise(rows)]
    if not parts:
        raise TooShortError(
            f"'{data.name}' crosses the gate {len(starts)} times; expected at least twice in one piece for a lap: "
            "move the gate or take a longer record"
        )
    return join(*parts, name=data.name)


@dataclass(frozen=True, kw_only=True)
class Corner:
    """A stretch of turning: its first row and the row after the last, the row of the largest lateral acceleration."""

    start: int
    stop: int
    apex: int
    left: bool

    def phase(self, row: int) -> Phase:
        """Entry until halfway to the apex, exit from halfway after it, the middle between."""
        if row < self.start + (self.apex - self.start) / 2:
            return "entry"
        return "exit" if row >= self.apex + (self.stop - self.apex) / 2 else "middle"


def corners(data: Dataset, *, a_y: float = 3.0, shortest: float = 1.0, smooth: float = 0.5) -> tuple[Corner, ...]:
    """Stretches in which the lateral acceleration ``v_x r`` stays above a threshold, in one direction.

    Parameters
    ----------
    data : Dataset
        With v_x [m/s] and r [rad/s].
    a_y : float
        Threshold, positive. [m/s2]
    shortest, smooth : float
        Shorter stretches are no corners; length of the moving mean that the acceleration passes first. [s]
    """
    if not a_y > 0:
        raise ParameterError(f"a_y is {a_y} m/s2; expected a positive threshold, such as 3")
    bends, offset = [], 0
    for part in data.experiments:
        size = max(1, round(smooth / part.dt))
        lateral = ndimage.uniform_filter1d(part["v_x"] * part["r"], size, mode="nearest")
        for sign in (1.0, -1.0):
            labels, count = ndimage.label(sign * lateral > a_y)  # type: ignore[misc]
            for rows in ndimage.find_objects(labels, max_label=count):
                a, b = rows[0].start, rows[0].stop
                if (b - a) * part.dt >= shortest:
                    apex = a + int(np.argmax(np.abs(lateral[a:b])))
                    bends.append(Corner(start=offset + a, stop=offset + b, apex=offset + apex, left=sign > 0))
        offset += part.n_samples
    return tuple(sorted(bends, key=lambda corner: corner.start))


def rmse_by_phase(error: np.ndarray, found: tuple[Corner, ...]) -> dict[str, float]:
    """RMSE of samples in corner entries, middles and exits and on straights, in the error's unit; NaN where none.

    ``error`` is measured minus predicted, shape (n_samples,), NaN left out; ``found`` are the corners of the same data.
    """
    names = np.full(len(error), "straight", dtype="<U8")
    for corner in found:
        for row in range(corner.start, corner.stop):
            names[row] = corner.phase(row)
    by = {}
    for kind in PHASES:
        rows = (names == kind) & np.isfinite(error)
        by[kind] = float(np.sqrt(np.mean(error[rows] ** 2))) if rows.any() else float("nan")
    return by


def rmse_by_level(error: np.ndarray, level: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """RMSE of the samples whose ``|level|``, such as the lateral acceleration, lies in each bin; NaN where none.

    ``error`` and ``level`` have shape (n_samples,), the rising ``edges`` (n_bins + 1,); the last bin takes its upper
    end too.
    """
    where = np.digitize(np.abs(level), edges) - 1
    where[np.abs(level) == edges[-1]] = len(edges) - 2
    return np.array(
        [np.sqrt(np.mean(error[where == k] ** 2)) if (where == k).any() else np.nan for k in range(len(edges) - 1)]
    )
