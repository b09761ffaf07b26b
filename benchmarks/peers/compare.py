"""One problem's quadratic programs, solved by us and by every peer that is installed; answers come before times.

Each solver is given the same programs in the order of the drive, with a tolerance of 1e-8, set up once before; counted
is the call from Python that hands over a program's new matrices and vectors and solves it. Of us: condensing or the
factor by stages, and the solution, inside C, from the rows that were active in the plan before. Of each program the
least time of the rounds counts; the machine's load does not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from benchmarks.peers.hpipm import Hpipm, HpipmJoined
from benchmarks.peers.programs import Drive, Program, Shown, Situation, situations
from benchmarks.peers.solvers import (
    TOLERANCE,
    Clarabel,
    Daqp,
    Osqp,
    OsqpCondensed,
    Piqp,
    PiqpCondensed,
    Proxqp,
    Solver,
)

from slipangle.control.mpc import MPC
from slipangle.report.records import Record

SOLVERS: tuple[type[Solver], ...] = (
    Daqp, Hpipm, HpipmJoined, Osqp, OsqpCondensed, Piqp, PiqpCondensed, Clarabel, Proxqp,
)  # fmt: skip
SAME_INPUT = 1e-4  # largest difference of the first input, in units of half its range, of an answer that counts
SAME_COST = 1e-5  # largest excess of the cost, relative to one plus its size
MOST = 50  # programs
LONG = 10.0  # after which no further round begins [s]


def compared(name: str, mpc: MPC, drive: Drive, rounds: int) -> list[Record]:
    """Times of all solvers on the programs of a drive."""
    every = situations(mpc, drive)
    some = [every[i] for i in np.unique(np.linspace(0, len(every) - 1, MOST).astype(int))] if every else []
    if not some:
        return [Record(row=name, quantity="quadratic program [us]", thesis=None, here="-", note="no situation")]
    shown = Shown(mpc, "condensed")
    programs = []
    for s in some:
        shown.pose(s.x, s.applied, s.reference, s.memory)
        programs.append(shown.program())
    found = []
    for way, label in (("condensed", "condense"), ("riccati", "factor by stages")):
        own = Shown(mpc, way)
        found += _ours(f"{name}, ours, {way}", label, own, some, programs, rounds)
    ours = min(float(r.here) for r in found if r.quantity.endswith("median"))
    for kind in SOLVERS:
        found += _theirs(name, kind, programs, rounds, ours)
    return found


def _two(row: str, quantity: str, times: np.ndarray, note: str) -> list[Record]:
    least = 1e6 * np.min(times, axis=0)
    return [
        Record(
            row=row, quantity=f"{quantity} [us], {what}", thesis=None, here=float(value), note=note * (what != "p99")
        )
        for what, value in (("median", np.median(least)), ("p99", np.percentile(least, 99)))
    ]


def _ours(
    row: str, label: str, own: Shown, some: Sequence[Situation], programs: Sequence[Program], rounds: int
) -> list[Record]:
    """Of our two ways: posing and solving together, and the latter alone in the note."""
    posed, solved, far = [], [], 0.0
    for _ in range(rounds):
        posed.append([])
        solved.append([])
        for s, program in zip(some, programs, strict=True):
            posed[-1].append(own.pose(s.x, s.applied, s.reference, s.memory))
            solved[-1].append(own.solve())
            far = max(far, float(np.abs(own.answer - program.answer)[0].max()))
    alone = 1e6 * np.min(solved, axis=0)
    note = f"of which to {label} {1e6 * np.median(np.min(posed, axis=0)):.1f}, to solve {np.median(alone):.1f}, p99 "
    note += f"{np.percentile(alone, 99):.1f}; first input as the other way to {far:.0e}"
    return _two(row, "quadratic program in C", np.add(posed, solved), note)


def _theirs(name: str, kind: type[Solver], programs: Sequence[Program], rounds: int, ours: float) -> list[Record]:
    row, quantity = f"{name}, {kind.name}", "quadratic program, handed over and solved [us]"
    form = kind.form(programs)
    given = [form.matrices(p) for p in programs]
    times: list[list[float]] = []
    far = dear = 0.0
    try:
        solver = kind(given[0], form)
        ready = [solver.ready(m) for m in given]
        began = time.perf_counter()
        for _ in range(rounds):
            spent: list[float] = []
            for what, program in zip(ready, programs, strict=True):
                before = time.thread_time()
                z = solver.solve(what)
                spent.append(time.thread_time() - before)
                v = np.asarray(z)[form.inputs].reshape(program.answer.shape)
                best = program.cost(program.answer)
                far = max(far, float(np.abs(v - program.answer)[0].max()))
                dear = max(dear, (program.cost(v) - best) / (1 + abs(best)))
            times.append(spent)
            if time.perf_counter() - began > LONG:
                break
    except ImportError as missing:
        return [Record(row=row, quantity=quantity, thesis=None, here="-", note=str(missing))]
    except ArithmeticError as said:
        note = f"no answer within {TOLERANCE:g} to one of the programs: {said}"
        return [Record(row=row, quantity=quantity, thesis=None, here="-", note=note)]
    said = f"first input as ours to {far:.0e} of half its range, cost to {dear:.0e}"
    if not (far <= SAME_INPUT and dear <= SAME_COST):
        note = f"{said}: not the same answer, so its time does not count"
        return [Record(row=row, quantity=quantity, thesis=None, here="-", note=note)]
    ratio = 1e6 * float(np.median(np.min(times, axis=0))) / ours
    return _two(row, quantity.removesuffix(" [us]"), np.array(times), f"{ratio:.1f} times ours; {said}")
