"""The fastest lap: ours beside a plain CasADi and Ipopt program of the same car, on race tracks and random ones.

A car of 350 kW with downforce on the race tracks of TUM's database and on fifty random closed tracks (seed 0: a ring
of 80 to 300 m bent by harmonics 2 to 5, 8 to 14 m wide). The plain program is what one writes first: CasADi's Opti,
the trapezoidal rule on even points, the same equations, limits and weights, Ipopt's defaults, from the middle of the
track at 20 m/s. Processor time, as others may share the machine; ours is cold from the middle too, with its cheap
stages, after the car's equations were compiled once. Both minimise time and a cost of smoothness, so costs are
compared too, beside the optimum with four times the points, and each solution's intervals are driven in small steps.
Database lines are driven by the same car to within 5 cm.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipangle.data.public.registry import fetch
from slipangle.errors import SolverError
from slipangle.optimal.lap.car import LapCar, rates, slip
from slipangle.optimal.lap.fastest_lap import fastest_lap
from slipangle.optimal.lap.lap import Lap
from slipangle.optimal.lap.program import GRIP, N_STATES, saturation, scales, without_peak
from slipangle.paths.path import Path
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

CAR = LapCar(
    **dict(mass=1200.0, inertia_z=1500.0, wheelbase=2.7, l_f=1.5, C_f=1.6e5, C_r=2.2e5, mu_f=1.5, mu_r=1.6),
    **dict(power=3.5e5, drag=0.7, downforce_f=0.7, downforce_r=1.0, width=1.9, brake_rear=0.4),
)
TRACKS = ("Norisring", "Silverstone", "Monza", "Budapest", "Spielberg")
TIMED = {"Norisring": (800, 2.0), "Silverstone": (1200, 5.0)}  # points, s
RANDOM, SEED, POINTS = 50, 0, 300


def bench(progress: Progress) -> Reproduction:
    """Time beside the plain program, convergence everywhere, finer points, the database's own lines."""
    tracks = {name: Path.from_csv(fetch("tracks", f"{name}.csv")[f"{name}.csv"]) for name in TRACKS}
    records = []
    for i, (name, (points, most)) in enumerate(TIMED.items()):
        progress(0.1 + 0.2 * i, f"{name}, {points} points")
        fastest_lap(CAR, tracks[name], points=points)  # compiled
        seconds, lap = timed(lambda track=tracks[name], n=points: fastest_lap(CAR, track, points=n))
        note = f"{lap.iterations} iterations, lap {lap.time:.3f} s"
        records.append(Record.judged(name, f"s, {points} points", None, seconds, at_most=most, note=note))
        other, theirs = timed(lambda track=tracks[name], la=lap, n=points: plain(track, n, la))
        note = f"{theirs.status}, {theirs.iterations} iterations, lap {theirs.time:.3f} s"
        records.append(Record.judged(f"{name}, plain program", f"s, {points} points", None, other, note=note))
        records += matched(name, tracks[name], lap, theirs)
        progress(0.3 + 0.2 * i, f"{name}, plain program with twice the points")
        twice = plain(tracks[name], 2 * points, lap)
        note = f"{twice.status}, cost {twice.cost:.3f} s; ours, {points} points: lap {lap.time:.3f} s"
        records.append(Record(f"{name}, plain program", f"lap, s, {2 * points} points", None, twice.time, note=note))
    progress(0.5, "four times the points")
    fine = fastest_lap(CAR, tracks["Norisring"], points=3200).time
    coarse = fastest_lap(CAR, tracks["Norisring"], points=800).time
    records.append(
        Record.judged("Norisring", "800 beside 3200 points, %", None, 100 * abs(coarse / fine - 1), at_most=0.1)
    )
    for i, name in enumerate(TRACKS):
        progress(0.6 + 0.04 * i, f"{name} beside the database's line")
        records.append(beside_line(name, tracks[name]))
    solved = 0
    rng = np.random.default_rng(SEED)
    for i in range(RANDOM):
        progress(0.8 + 0.2 * i / RANDOM, f"random track {i + 1}")
        solved += converges(random_track(rng))
    records.append(Record.judged("random tracks", f"solved of {RANDOM}", None, solved, at_least=RANDOM))
    return Reproduction.told(__doc__, records)


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    """Processor seconds of a call, and what it gives."""
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def beside_line(name: str, track: Path) -> Record:
    """Lap time on the database's line over that of our own, which has to be shorter."""
    X, Y = np.loadtxt(fetch("racelines", f"{name}.csv")[f"{name}.csv"], delimiter=",").T
    line = Path.from_points(X, Y, closed=True, name=f"{name}, line of the database")
    points = round(track.length / 6.0)
    theirs = fastest_lap(CAR, line, line="given", points=points).time
    ours = fastest_lap(CAR, track, points=points).time
    note = f"{ours:.3f} s, {theirs:.3f} s on the database's line"
    return Record.judged(
        f"{name}, free line", "s faster than on the database's", None, theirs - ours, at_least=0, note=note
    )


def converges(track: Path) -> bool:
    """Whether a lap is found."""
    try:
        fastest_lap(CAR, track, points=POINTS)
    except SolverError as error:
        print(error, file=sys.stderr)
        return False
    return True


def random_track(rng: np.random.Generator) -> Path:
    """A closed track without corners tighter than 12 m; another is drawn until there is one."""
    angle = np.linspace(0, 2 * np.pi, 400)[:-1]
    while True:
        radius = np.ones_like(angle)
        for k in range(2, 6):
            radius += 0.5 * rng.uniform(0, 1) / k * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
        radius *= rng.uniform(80, 300)
        half = 0.5 * rng.uniform(8, 14)
        track = Path.from_points(radius * np.cos(angle), radius * np.sin(angle), closed=True, right=half, left=half)
        if radius.min() > 20 and np.abs(track.curvature).max() < 1 / 12:
            return track


class Plain(NamedTuple):
    """How the plain program ended, its lap time and cost [s], its points, and states and rates there, shape (n, 9)."""

    status: str
    iterations: int
    time: float
    cost: float
    s: np.ndarray
    columns: np.ndarray


class Driven(NamedTuple):
    """Intervals of a solution, each driven from its own first state by its own inputs in small steps.

    ``jump`` is the largest distance across the track to where the next interval begins [m], ``excess`` the largest
    excess over a limit of tires or power, which are 1, or 0; ``time`` the sum of the intervals. [s]
    """

    time: float
    jump: float
    excess: float


def matched(name: str, track: Path, lap: Lap, other: Plain) -> list[Record]:
    """Ours and the plain program's solution beside the optimum that both come near with more points.

    Times and costs at a finite number of points are those of a rule, not of a drive: what is below the optimum of four
    times the points was gained by the rule's error. How large that is, is seen where each interval is driven finely.
    """
    fine = fastest_lap(CAR, track, points=4 * len(lap.s))
    ends = np.append(0.0, lap.ends[1:])
    own = np.vstack([lap.columns[-1], lap.columns[1::2]])
    held = np.vstack([lap.columns[0::2, N_STATES:], lap.columns[:1, N_STATES:]])
    ours = finely(track, ends, np.column_stack([own[:, :N_STATES], held]))
    around = np.vstack([other.columns, other.columns[:1]])
    theirs = finely(track, np.append(other.s, track.length), around)
    said = f"{len(lap.s)} points"
    note = f"ours {lap.cost:.3f} s, plain program {other.cost:.3f} s"
    what = f"what both minimise, ours less the plain program's, s, {said}"
    records = [Record.judged(name, what, None, lap.cost - other.cost, at_most=0.0, note=note)]
    for who, cost, time_of, driven in (
        ("ours", lap.cost, lap.time, ours),
        ("plain program", other.cost, other.time, theirs),
    ):
        note = f"lap {time_of:.3f} s, {fine.time:.3f} s with four times the points; driven finely {driven.time:.3f} s"
        off = 100.0 * abs(cost / fine.cost - 1.0)
        what = f"cost off that of four times the points, %, {said}"
        good: dict[str, Any] = {"at_most": 0.1} if who == "ours" else {}
        records.append(Record.judged(f"{name}, {who}", what, None, off, note=note, **good))
        records.append(Record.judged(f"{name}, {who}", f"largest jump between intervals, m, {said}", None, driven.jump))
        what = f"largest excess over a limit, %, {said}"
        records.append(Record.judged(f"{name}, {who}", what, None, 100.0 * driven.excess))
    return records


def finely(track: Path, s: np.ndarray, columns: np.ndarray, steps: int = 20) -> Driven:
    """Intervals between places ``s`` [m] from their first states and held rates, shape (n, 9), the last one the end."""
    x, u, start, h = columns[:-1, :N_STATES].T.copy(), columns[:-1, N_STATES:].T, s[:-1], np.diff(s) / steps
    flags, most, total = without_peak(CAR), 0.0, np.zeros(len(h))

    def slope(x: np.ndarray, place: np.ndarray) -> np.ndarray:
        n, chi, v_x, v_y, r, delta, F = x
        k = track.at(place).curvature
        motion = rates(v_x, v_y, r, delta, F, CAR)
        pace = (1 - n * k) / (v_x * np.cos(chi) - v_y * np.sin(chi))
        across = v_x * np.sin(chi) + v_y * np.cos(chi)
        return np.array([across, r - k / pace, motion.v_x, motion.v_y, motion.r, u[0], u[1], 1 + 0 * r]) * pace

    for i in range(steps):
        place = start + i * h
        k1 = slope(x, place)
        k2 = slope(x + 0.5 * h * k1[:7], place + 0.5 * h)
        k3 = slope(x + 0.5 * h * k2[:7], place + 0.5 * h)
        k4 = slope(x + h * k3[:7], place + h)
        step = h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x, total = x + step[:7], total + step[7]
        _, _, v_x, v_y, r, delta, F = x
        acting = rates(v_x, v_y, r, delta, F, CAR).forces
        slips = saturation(*slip(v_x, v_y, r, delta, CAR), CAR, flags)
        used = (acting.front.use / GRIP, acting.rear.use / GRIP)
        over = [*map(np.abs, (*slips, *used)), F * v_x / CAR.power]
        most = max(most, float(np.max(over)) - 1.0)
    return Driven(float(total.sum()), float(np.abs(x[0] - columns[1:, 0]).max()), most)


def plain(track: Path, points: int, like: Lap) -> Plain:
    """The plain program, solved."""
    size, opti = scales(CAR), ca.Opti()
    place = track.at(np.linspace(0.0, track.length, points + 1)[:-1])
    h = track.length / points
    Z = opti.variable(9, points)
    cost, lap_time = 0, 0
    point, low = _point(size), np.array([-1, -1, -GRIP, -GRIP, -np.inf])
    now = [point(Z[:, i], place.curvature[i]) for i in range(points)]
    for i in range(points):
        j = (i + 1) % points
        (f, pace, limited, jerk), (f_next, pace_next, _, jerk_next) = now[i], now[j]
        passed = 0.5 * h * (pace + pace_next)
        opti.subject_to(Z[:5, j] == Z[:5, i] + 0.5 * h * (f + f_next))
        opti.subject_to(Z[5:7, j] == Z[5:7, i] + passed * Z[7:, i] * (size[7:] / size[5:7]))
        opti.subject_to(opti.bounded(low, limited, np.array([1, 1, GRIP, GRIP, 1])))
        room = 0.5 * CAR.width
        opti.subject_to(opti.bounded(room - place.right[i], size[0] * Z[0, i], place.left[i] - room))
        lap_time += passed
        effort = like.weights[1] * (size[7] * Z[7, i]) ** 2 + like.weights[2] * (size[8] * Z[8, i]) ** 2
        cost += passed * (1 + effort) + 0.5 * h * like.weights[0] * (jerk + jerk_next)
    for row, bound in ((1, 1.3), (5, CAR.delta_max), (7, CAR.delta_rate), (8, CAR.force_rate * CAR.weight)):
        opti.subject_to(opti.bounded(-bound / size[row], Z[row, :], bound / size[row]))
    opti.subject_to(Z[2, :] >= 0.02)
    opti.minimize(cost)
    opti.set_initial(Z[2, :], 20.0 / size[2])
    opti.set_initial(Z[4, :], 20.0 * place.curvature / size[4])
    opti.solver("ipopt", {"expand": True, "print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 500})
    with suppress(RuntimeError):  # it says below how it ended
        opti.solve()
    stats = opti.stats()
    found = np.asarray(opti.debug.value(Z)).T * size
    lap_of, cost_of = (float(opti.debug.value(value)) for value in (lap_time, cost))
    s = h * np.arange(points)
    return Plain(str(stats["return_status"]), int(stats["iter_count"]), lap_of, cost_of, s, found)


def _point(size: np.ndarray) -> ca.Function:
    z, k = ca.SX.sym("z", 9), ca.SX.sym("k")
    n, chi, v_x, v_y, r, delta, F = (z[i] * size[i] for i in range(7))
    motion = rates(v_x, v_y, r, delta, F, CAR)
    pace = (1 - n * k) / (v_x * ca.cos(chi) - v_y * ca.sin(chi))
    change = ca.vertcat(v_x * ca.sin(chi) + v_y * ca.cos(chi), r, motion.v_x, motion.v_y, motion.r) * pace
    slips = saturation(*slip(v_x, v_y, r, delta, CAR), CAR, without_peak(CAR))
    acting = motion.forces
    limited = ca.vertcat(*slips, acting.front.use, acting.rear.use, F * v_x / CAR.power)
    outputs = [(change - ca.vertcat(0, k, 0, 0, 0)) / size[:5], pace, limited, motion.r**2 * pace]
    return ca.Function("point", [z, k], outputs)


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
