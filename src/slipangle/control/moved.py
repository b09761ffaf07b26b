"""A plan of several phases, read some time after it was made: what the next one begins with, and what there is else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from slipangle.optimal.guess import Guess
from slipangle.optimal.ocp import OCP, Reference, at_nodes
from slipangle.optimal.solution import finite

NOTHING = 1e-9  # of a stage, by which a node may lie behind the end of a phase without being behind it


def moved(phases: Sequence[Any], problems: Sequence[OCP], wanted: Sequence[Reference], later: float) -> list[Guess]:
    """States, inputs and decided values of each phase so much later, on the plan's own clock.

    The first phase whose duration is decided has so much less of it left, at least its shortest, and ends where it
    ended; those before it, or all where none is, move on as a horizon does: what comes behind the end of one holds its
    last input, and its states follow from that.

    Parameters
    ----------
    phases : sequence of PhasePlan
        As they were planned.
    problems : sequence of OCP
        Of each phase.
    wanted : sequence of Reference
        Of each phase.
    later : float
        Time since then. [s]
    """
    begin, left, guesses = later, later, []
    for phase, ocp, reference in zip(phases, problems, wanted, strict=True):
        own, decided = phase.times - phase.times[0], dict(phase.decided)
        length = float(own[-1])
        if "duration" in decided and ocp.duration is not None:
            decided["duration"] = max(length - left, ocp.duration[0])
            left -= length - decided["duration"]
        at = begin + own / length * decided.get("duration", length)
        x, u = _read(phase, ocp, at)
        if not ocp.composed:
            _go_on(x, u, ocp, reference, at - phase.times[-1])
        guesses.append(Guess(x=x, u=u, decided=decided, states=phase.states, controls=phase.controls))
        begin += at[-1] - at[0]
    return guesses


def _read(phase: Any, ocp: OCP, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States at these instants, on straight lines, and the inputs in the middle between them; the last ones behind."""
    x = np.column_stack([np.interp(at, phase.times, column) for column in phase.x.T])
    stage = np.searchsorted(phase.times, 0.5 * (at[:-1] + at[1:]), side="right") - 1
    return x, np.array(phase.u[np.clip(stage, 0, ocp.horizon - 1)])


def _go_on(x: np.ndarray, u: np.ndarray, ocp: OCP, wanted: Reference, behind: np.ndarray) -> None:
    """States behind the end of the phase, by so much time, follow from the inputs where these lead to numbers."""
    w = at_nodes(np.asarray(wanted.exogenous, dtype=float), ocp.horizon)
    for i in np.flatnonzero(behind[1:] > NOTHING * ocp.dt):
        later = np.asarray(ocp.dynamics(x[i], u[i], w[i])).ravel()
        x[i + 1] = later if finite(later) else x[i]
