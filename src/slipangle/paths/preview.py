"""What is seen of a path: the foot of a point, and the rows ahead that a controller tracks."""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Self

import numpy as np

from slipangle.errors import ParameterError


class Projection(NamedTuple):
    """Foot of a point on a path: arc length [m], signed distance to the left of the path [m], heading there [rad]."""

    s: float
    e_y: float
    psi: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Preview:
    """The path at some arc lengths [m], one row per instant; all arrays have shape (n,).

    The pose of the centre line [m, m, rad] has a continuous heading, laps add up; the curvature is positive when the
    path turns left [1/m]; the speed is NaN where the path has no profile and none was given [m/s]; right and left are
    the distances to the edges of the lane, infinite where there is none [m]. ``t`` are the instants of the rows, from
    now, of a look ahead in time [s].
    """

    s: np.ndarray
    X: np.ndarray
    Y: np.ndarray
    psi: np.ndarray
    curvature: np.ndarray
    v_x: np.ndarray
    right: np.ndarray  # distance to the lane's right edge, infinite where there is none [m]
    left: np.ndarray  # the same to the left [m]
    t: np.ndarray | None = None

    @classmethod
    def of(cls, s: np.ndarray, rows: np.ndarray, t: np.ndarray | None = None) -> Self:
        """From places and ``rows`` of X, Y, psi, curvature, v_x, right, left there, shape (7, n)."""
        X, Y, psi, curvature, v_x, right, left = rows
        return cls(s=s, X=X, Y=Y, psi=psi, curvature=curvature, v_x=v_x, right=right, left=left, t=t)

    def __len__(self) -> int:
        return len(self.s)

    def require_times(self, times: np.ndarray) -> None:
        """Raise unless the rows are those of a controller's `times`, as far as the number and the last instant say.

        Raises ParameterError with what there is and what is expected.
        """
        if len(self) != len(times):
            raise ParameterError(
                f"the preview has {len(self)} rows; expected horizon + 1 = {len(times)}: use path.ahead(s, mpc.times)"
            )
        if self.t is not None and not abs(self.t[-1] - times[-1]) <= 1e-6 * times[-1]:
            raise ParameterError(
                f"the preview looks {self.t[-1]:g} s ahead; expected {times[-1]:g} s, as far as the controller plans: "
                "use path.ahead(s, mpc.times)"
            )

    def v_x_dot(self, times: np.ndarray) -> np.ndarray:
        """Mean acceleration along the path from each row's instant, of ``times`` [s], to the next one's. [m/s2]"""
        rate = np.diff(self.v_x) / np.diff(times)
        return np.append(rate, rate[-1:])

    @property
    def marked(self) -> bool:
        """Whether an edge of the lane is marked anywhere there."""
        return bool(np.isfinite(self.left).any() or np.isfinite(self.right).any())

    @property
    def r(self) -> np.ndarray:
        """Yaw rate of following the path at its speed. [rad/s]"""
        return self.curvature * self.v_x


@lru_cache(maxsize=64)
def strides_between(instants: bytes) -> tuple[tuple[int, float], ...]:
    """How many strides of which length lead from each instant to the next, none longer than the first interval.

    ``instants`` are the bytes of an array, since a loop asks for the same ones at every step. Raises ParameterError if
    the instants do not rise from 0.
    """
    times = np.frombuffer(instants)
    gaps = np.diff(np.atleast_1d(times))
    if not (len(gaps) and times[0] == 0 and (gaps > 0).all() and np.isfinite(times[-1])):
        raise ParameterError(
            f"the instants to look at are {times}; expected two or more that rise from 0 s, such as mpc.times, or a "
            "number of steps and dt"
        )
    first = float(gaps[0])
    strides = []
    for gap in gaps.tolist():
        count = max(math.ceil(gap / first - 1e-6), 1)
        strides.append((count, first if math.isclose(gap, count * first, rel_tol=1e-9) else gap / count))
    return tuple(strides)
