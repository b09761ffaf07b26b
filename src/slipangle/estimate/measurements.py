"""Measurements as they come in a loop: by name, slow, late, missing or held."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from slipangle.models.model import Model

OPEN = float("inf")  # a gate that lets everything pass
_PLAIN = re.compile(r"^(?:base |discrepancy )*(?P<name>.*?)(?:_s|_lagged|'+|\[k(?:-\d+)?\]|\(k-\d+\))?$")


class Row(NamedTuple):
    """A sample as a filter took it in: what it knew before, and what was measured; arrays of its own."""

    z: np.ndarray
    P: np.ndarray
    before: np.ndarray  # input since the sample before
    u: np.ndarray  # input at this sample
    y: np.ndarray
    seen: np.ndarray
    gate: np.ndarray
    dt: np.ndarray


@dataclass(frozen=True)
class Late:
    """Which outputs arrive how many samples late."""

    steps: tuple[int, ...]

    @property
    def deepest(self) -> int:
        """Samples that must be kept besides the newest."""
        return max(self.steps, default=0)

    def place(self, rows: deque[Row], y: np.ndarray) -> int:
        """Put late outputs of ``y``, shape (n_outputs,), where they belong; how many samples back the oldest is."""
        back = 0
        for i, steps in enumerate(self.steps):
            if steps and np.isfinite(y[i]) and steps < len(rows):
                row = rows[-1 - steps]
                row.y[i], row.seen[i] = y[i], 1.0
                back = max(back, steps)
        return back


def plain_name(state: str) -> str:
    """Channel that a state is a past value of, or lags behind; its own name if none.

    >>> [plain_name(n) for n in ("r", "r[k-1]", "delta(k-2)", "delta_s", "delta_lagged", "base v_y")]
    ['r', 'r', 'delta', 'delta', 'delta', 'v_y']
    """
    found = _PLAIN.match(state)
    return found["name"] if found else state


def by_name(model: Model, measured: Mapping[str, float]) -> np.ndarray:
    """State that the channels measured now say, shape (n_states,); what they do not tell is zero.

    A lag, such as ``r[k-1]`` or ``delta(k-2)``, and the steering behind a lag, ``delta_s``, are as the channel is now.
    """
    values = [measured.get(state, measured.get(plain_name(state), 0.0)) for state in model.states]
    return np.nan_to_num(np.array(values, dtype=float), nan=0.0, posinf=0.0, neginf=0.0)


class Gates:
    """What of each output is an outlier, and when it is believed all the same.

    Parameters
    ----------
    n : int
        How many outputs.
    gate : float or None
        Standard deviations beyond which a value is an outlier; None believes all.
    patience : int
        Outliers of an output in a row on one side of its prediction, after which it is believed until it is none.
    """

    def __init__(self, n: int, gate: float | None, patience: int) -> None:
        self._closed, self._patience = OPEN if gate is None else float(gate) ** 2, patience
        self.squares = np.full(n, self._closed, dtype=float)  # of the gates, over the variance
        self.counts = np.zeros(n, dtype=int)  # of what was not taken in
        self._in_row = np.zeros(n, dtype=int)  # negative below the prediction

    def judge(self, fresh: np.ndarray, error: np.ndarray, variance: np.ndarray, taken: np.ndarray) -> None:
        """Open and close the gates after a sample: which outputs it has, their errors, variances, and if taken in.

        A late output that is older than the first sample has no error and is not counted.
        """
        refused = (taken == 0) & (error != 0)
        off = np.where(self.squares == OPEN, error * error > self._closed * variance, refused)
        self.counts += fresh & refused
        one_side = np.where(error * self._in_row > 0, self._in_row, 0) + np.where(error > 0, 1, -1)
        np.copyto(self._in_row, np.where(off, one_side, 0), where=fresh)
        self.squares[:] = np.where(np.abs(self._in_row) >= self._patience, OPEN, self._closed)


def headings(model: Any) -> list[int]:
    """For each output that is the heading of a pose, its state; -1 for the others."""
    plain = [plain_name(name) for name in model.states]
    posed = {"X", "Y", "psi"} <= {*plain}
    return [plain.index("psi") if name == "psi" and posed else -1 for name in model.outputs]


class Intake:
    """Channels by name into arrays: NaN for an output that is missing, the last value for an input that is.

    A channel that reads exactly what it read before is held by its instrument, not measured again.
    """

    def __init__(self, outputs: tuple[str, ...], inputs: tuple[str, ...]) -> None:
        self.outputs, self.inputs = outputs, inputs
        self.u = np.zeros(len(inputs))
        self._last = np.full(len(outputs), np.nan)

    def restart(self, measured: Mapping[str, float], used: Iterable[str] = ()) -> None:
        """Begin anew with the inputs ``measured``; outputs that are ``used`` up by the start count as read."""
        self._last[:] = [measured.get(name, np.nan) if name in used else np.nan for name in self.outputs]
        for j, name in enumerate(self.inputs):
            value = measured.get(name, 0.0)
            self.u[j] = value if np.isfinite(value) else 0.0

    def __call__(self, measured: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """Outputs and inputs, arrays of their own."""
        y = np.array([measured.get(name, np.nan) for name in self.outputs], dtype=float)
        y[~np.isfinite(y)] = np.nan
        new = np.where(y == self._last, np.nan, y)
        self._last = np.where(np.isnan(y), self._last, y)
        for j, name in enumerate(self.inputs):
            value = measured.get(name, np.nan)
            if np.isfinite(value):
                self.u[j] = value
        return new, self.u.copy()
