"""`Watch`: what a driver looks at beside its plan, and for which the car should stop."""

from __future__ import annotations

import math
from typing import ClassVar

from slipangle.control.commands import HINDERED, UNSURE
from slipangle.data.headings import TURN
from slipangle.models.wrappers.on_ground import POSE
from slipangle.paths.path import Path

# For a road car; lengths scale with the wheelbase, times and speeds with its root.
UNCERTAIN = 1.0  # m of standard deviation of the position from which a car should stop
SPEED_GAP, POSE_GAP = 1.0, 2.0  # s without a speed, or a pose, after which it is not known any more
WAY_OFF, TURN_OFF = 0.01, 0.003  # share and rad/s by which a measured speed and yaw rate are taken to be off
WINDOW, LONG = (
    1.0,
    1.5,
)  # s over which the way by the speed is set beside that between two positions; of that, from which turns count
APART, SLOW = 0.25, 1.0  # share and m/s by which these may differ
TURN_SLOW = 0.3  # rad/s by which a yaw rate and headings may, beside that share
TWICE = 2  # windows in a row in which they do, from which they contradict each other
MOST_TURN = 2.5  # rad, of which the nearest turn of a heading is the right one
AWAY = 2.0  # rad off the path's heading from which a car does not come back by driving on
FAR = 10.0  # m beside the path from which it is said, and by which it may then grow

_FIRST, _END = len(HINDERED), len(HINDERED) + len(UNSURE)
LOST, SPEED_LOST, CONTRADICTED, TURN_CONTRADICTED, ENDED, FACING_AWAY, RECEDING, BESIDE = range(_FIRST, _END)


class Blind:
    """How far a position may be off since it was believed last, by errors of speed and yaw rate that no filter knows.

    Attributes
    ----------
    off : float
        That. [m]
    """

    numbers: ClassVar[dict[str, float]] = {"WAY_OFF": WAY_OFF, "TURN_OFF": TURN_OFF}  # for its C

    def __init__(self) -> None:
        self.off, self._seen = 0.0, 0.0

    def move(self, way: float, now: float) -> None:
        """The car moved on so far [m], until now. [s]"""
        self.off += abs(way) * (WAY_OFF + TURN_OFF * (now - self._seen))

    def see(self, now: float) -> None:
        """The position is believed now, or is all that is known of a car that stands. [s]"""
        self.off, self._seen = 0.0, now


class Watch:
    """Whether the car may go on.

    Parameters
    ----------
    path : Path
        That is followed.
    size : float
        Wheelbase over that of a road car. [-]
    lost : float
        Standard deviation of the position from which it counts as not known. [m]
    """

    def __init__(self, path: Path, size: float, lost: float) -> None:
        self._path, self._lost, self._far = path, lost, FAR * size
        self._window, self._slow = WINDOW * math.sqrt(size), SLOW * math.sqrt(size)
        self._turn_slow = TURN_SLOW / math.sqrt(size)
        self._told: dict[str, float] = {}
        self._from: tuple[float, float, float] | None = None
        self._way, self._odd, self._read, self._blind = 0.0, 0, math.nan, Blind()
        self._headed: tuple[float, float] | None = None
        self._turned, self._odd_turns = 0.0, 0
        self._nearest = math.inf  # least distance since the car was far beside the path

    @property
    def numbers(self) -> dict[str, float]:
        """What it goes by, for its C."""
        known = {"SPEED_GAP": SPEED_GAP, "POSE_GAP": POSE_GAP}
        known |= {"WINDOW": self._window, "SLOW": self._slow, "APART": APART, "TWICE": TWICE, "LONG": LONG}
        known |= {"TURN_SLOW": self._turn_slow}
        known |= {"MOST_TURN": MOST_TURN, "AWAY": AWAY, "FAR": self._far}
        return Blind.numbers | {f"WATCH_{n}": v for n, v in known.items()}

    def note(self, name: str, t: float) -> None:
        """A channel said at a time [s] what can be, new or as before."""
        self._told[name] = t

    def speed_known(self, now: float) -> bool:
        """Whether the speed was said lately."""
        return now - self._told.get("v_x", -math.inf) <= SPEED_GAP

    def pose_known(self, now: float) -> bool:
        """Whether the pose was said lately."""
        return all(now - self._told.get(name, -math.inf) <= POSE_GAP for name in POSE)

    def move(self, now: float, v_x: float, seconds: float, position: tuple[float, float] | None) -> None:
        """Count the way by the speed [m/s] since the last call, and set it beside that from position to position.

        A speed that contradicts the positions is believed again when they agree and it reads otherwise than then: one
        that is stuck agrees as well, when the car has come down to it.
        """
        way = 0.0 if math.isnan(v_x) else v_x * seconds
        self._blind.move(way, now)
        self._way += way
        if position is None:
            return
        if self._from is not None:
            passed = now - self._from[0]
            if passed < self._window:
                return
            between = math.sqrt((position[0] - self._from[1]) ** 2 + (position[1] - self._from[2]) ** 2)
            bent = between < self._way and passed > LONG * self._window  # a turn may have brought the car back
            if abs(between - self._way) > APART * max(between, self._way) + self._slow * passed and not bent:
                self._odd, self._read = self._odd + 1, v_x
            elif self._odd < TWICE or v_x != self._read:
                self._odd = 0
        self._from, self._way = (now, *position), 0.0

    def turn(self, now: float, r: float, seconds: float, psi: float | None) -> None:
        """Count the turn by the yaw rate [rad/s] since the last call, and set it beside that from heading to heading.

        Where they contradict each other only a turn in which they agree is believed: a car that stands shows nothing.
        An unknown yaw rate is NaN.
        """
        self._turned += r * seconds
        if psi is None:
            return
        if self._headed is not None:
            passed = now - self._headed[0]
            if passed < self._window:
                return
            between, turned = math.remainder(psi - self._headed[1], TURN), abs(self._turned)
            if turned < MOST_TURN:
                most, left = max(abs(between), turned), self._turn_slow * passed
                if abs(between - self._turned) > APART * most + left:
                    self._odd_turns += 1
                elif self._odd_turns < TWICE or abs(between) > left:
                    self._odd_turns = 0
        self._headed, self._turned = (now, psi), 0.0

    def see(self, now: float) -> None:
        """The position was taken in, or is all that is known of a car that stands."""
        self._blind.see(now)

    def reason(self, now: float, std: float, at: tuple[float, float, float]) -> int:
        """Why the car should stop, or that it is far beside the path: a place in `UNSURE` after `HINDERED`; else 0.

        ``std`` is that of the position as the filter knows it [m], ``at`` the place on the path: s [m], e_y [m], e_psi
        [rad].
        """
        s, e_y, e_psi = at
        if not std + self._blind.off <= self._lost:
            return LOST
        if not self.speed_known(now):
            return SPEED_LOST
        if self._odd >= TWICE:
            return CONTRADICTED
        if self._odd_turns >= TWICE:
            return TURN_CONTRADICTED
        if not self._path.closed and s > self._path.length:
            return ENDED
        if not abs(e_psi) <= AWAY:
            return FACING_AWAY
        if abs(e_y) <= self._far:
            self._nearest = math.inf
            return 0
        self._nearest = min(self._nearest, abs(e_y))
        return BESIDE if abs(e_y) <= self._nearest + self._far else RECEDING
