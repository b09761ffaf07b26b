"""`race`: laps of a racer on a plant, and what a judge with a stop watch sees of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slipangle.control.commands import Commands
from slipangle.control.racing.racer import Racer
from slipangle.control.racing.sensing import NOISE
from slipangle.data.dataset import Channel, Dataset
from slipangle.optimal.lap.driven import DrivenLap, cut_laps
from slipangle.optimal.lap.lap import Lap
from slipangle.simulate.drive import drive
from slipangle.simulate.plant import Plant
from slipangle.simulate.run import Run

ROLLING = 0.98  # of the lap's speed, that the drive starts with, before the start line
PATIENCE = 1.1  # times the first lap's time, that a lap may take in the mean
CALM = 0.1  # of the lap's largest lateral acceleration: no more where a drive starts
AFTER = 10  # samples behind the start line, by when a racer has learned


@dataclass(frozen=True, kw_only=True)
class OffTrack:
    """A moment with a part of the car beyond an edge.

    Parameters
    ----------
    begin, end : float
        Time of the drive. [s]
    s, depth : float
        Arc length of the track's line where the car was furthest beyond the edge, and how far. [m]
    """

    begin: float
    end: float
    s: float
    depth: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Race:
    """Laps of the true motion, cut at the start line, with the way to it and what came after the last.

    Parameters
    ----------
    run : Run
        The whole drive.
    laps : tuple of DrivenLap
        Those that were finished, no more than were wanted.
    wanted : int
        How many laps were to be driven.
    grip, grip_std : array, shape (n,)
        Friction over the believed one as the filter read it at every sample, and its deviation. [-]
    learned : array, shape (n_laps, 2)
        The same as the racer took it for the whole lap, after each.
    sample : float
        Between samples. [s]
    """

    run: Run
    laps: tuple[DrivenLap, ...]
    wanted: int
    grip: np.ndarray
    grip_std: np.ndarray
    learned: np.ndarray
    sample: float

    @property
    def times(self) -> list[float]:
        """Of the laps. [s]"""
        return [lap.time for lap in self.laps]

    @property
    def room(self) -> np.ndarray:
        """Distance of the car's side to the nearer edge at every sample, negative beyond it, shape (n,). [m]"""
        lane = self.run.path.at(self.run.s)
        return np.minimum(lane.left - self.run.e_y, lane.right + self.run.e_y) - 0.5 * self.run.width

    @property
    def finished(self) -> bool:
        """Whether all wanted laps were driven."""
        return len(self.laps) == self.wanted

    @property
    def judged(self) -> slice:
        """Samples that count: all up to the end of the last wanted lap, or of the drive."""
        return slice(self.rows(self.laps[-1]).stop if self.finished else None)

    def rows(self, lap: DrivenLap) -> slice:
        """Samples of a lap."""
        return slice(round(lap.begin / self.sample), round((lap.begin + lap.time) / self.sample) + 1)

    @property
    def off_track(self) -> tuple[OffTrack, ...]:
        """Moments off the track, in driving order."""
        room = self.room[self.judged]
        off = np.concatenate([[False], room < 0.0, [False]])
        found = []
        for a, b in np.flatnonzero(np.diff(off)).reshape(-1, 2).tolist():
            worst = a + int(np.argmin(room[a:b]))
            s = float(self.run.s[worst] % self.run.path.length)
            begin, end = float(self.run.t[a]), float(self.run.t[b - 1]) + self.sample
            found.append(OffTrack(begin=begin, end=end, s=s, depth=float(-room[worst])))
        return tuple(found)


def race(racer: Racer, plant: Plant, laps: int) -> Race:
    """Let a racer drive laps on a plant, rolling from where the lap last goes straight on before the start line.

    The racer sees what the plant's sensors show of X, Y, psi, v_x, r, a_x and a_y; see `NOISE`. While it plans a lap at
    the start line, the plant waits. Whatever happens, the drive ends after the time of the first lap for every lap, and
    a little more.
    """
    lap = racer.lap
    begin = _straight(lap)
    X, Y, psi, v = (float(column[begin]) for column in (lap.X, lap.Y, lap.psi, lap.v_x))
    read: list[tuple[float, ...]] = []

    def watch(t: float, commands: Commands) -> None:
        learned = racer.learned
        read.append((*learned.latest, learned.grip, learned.grip_std))

    run = drive(
        plant,
        racer,
        duration=(laps + 0.2) * PATIENCE * lap.time + lap.time - float(lap.t[begin]),
        channels=tuple(NOISE),
        x0=plant.straight(ROLLING * v, X=X, Y=Y, psi=psi),
        s0=float(lap.s[begin]) - racer.track.length,
        width=racer.car.width,
        sample=racer.sample,
        watch=watch,
    )
    places = np.column_stack([run["X"], run["Y"], run["v_x"]])
    channels = (Channel("X", "m"), Channel("Y", "m"), Channel("v_x", "m/s"))
    driven = cut_laps(Dataset(values=places, channels=channels, dt=racer.sample), racer.track)[0][:laps]
    table = np.array(read)[: len(run.t)]
    ends = [min(round((one.begin + one.time) / racer.sample) + AFTER, len(table) - 1) for one in driven]
    return Race(
        run=run,
        laps=driven,
        wanted=laps,
        grip=table[:, 0],
        grip_std=table[:, 1],
        learned=table[ends][:, 2:],
        sample=racer.sample,
    )


def _straight(lap: Lap) -> int:
    """Last point of a lap, some before its end, where it drives on and hardly bends; the straightest where none does.

    A car that is put into a bend with straight wheels, or where it should brake, leaves the line before it has steered,
    the further the more its tires hold.
    """
    turning = np.abs(lap.v_x * lap.r)[:-2]
    calm = np.flatnonzero((turning <= CALM * turning.max()) & (lap.F_x[:-2] >= 0.0))
    return int(calm[-1]) if len(calm) else int(np.argmin(turning))
