"""Pieces of a log: moving, of about one length, some for the fit and some to check it by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from slipangle.data.dataset import Dataset, join
from slipangle.data.quality.events import runs
from slipangle.data.quality.spins import spinning
from slipangle.data.recordings import RECORDING
from slipangle.errors import MissingColumnError, TooShortError
from slipangle.identify.car.structures import ADDED, SLOWEST

_SHORTEST = 4.0  # s, of a stretch that is worth a free run
_WANTED, _ENOUGH = 20, 8  # stretches that recordings are cut into; so many recordings stay whole
_HELD = 4  # every so many is held out


@dataclass(frozen=True, kw_only=True)
class Stretches:
    """Stretches of a log in which the car moves; every fourth by speed is held out of the fits that choose."""

    train: Dataset
    held_out: Dataset
    unused: float = 0.0  # share of the driving that is in pieces too short [-]
    spins: tuple[tuple[float, float], ...] = ()  # when the car begins to spin and is caught again, left out [s]

    @property
    def all(self) -> Dataset:
        """Both, one after the other."""
        return join(self.train, self.held_out)


def stretches(data: Dataset, wheelbase: float) -> Stretches:
    """Cut a log where the car hardly moves, and where it spins, and long recordings into shorter ones.

    A channel `RECORDING` says of which recording each is: of those that the log numbers so, or of its experiments.

    Raises
    ------
    TooShortError
        If fewer than two stretches remain.
    """
    if RECORDING not in data:
        each = np.diff([*data.starts, data.n_samples])
        data = data.with_channel(RECORDING, np.repeat(np.arange(len(each), dtype=float), each))
    least = max(round(_SHORTEST / data.dt), 8)
    moving, slowest, spun = driven(data, wheelbase, least), SLOWEST * wheelbase, spinning(data, wheelbase)
    total = sum(run.n_samples for run in moving)
    length = max(least, total // _WANTED) if len(moving) < _ENOUGH else total
    pieces = [piece for run in moving for piece in _cut(run, max(1, round(run.n_samples / length)))]
    if len(pieces) < 2:
        backwards = np.mean(data["v_x"] < -slowest) > np.mean(data["v_x"] > slowest)
        fix = "v_x is negative most of the time, turn its sign" if backwards else "record a longer drive"
        raise TooShortError(
            f"'{data.name}' has {len(pieces)} stretch{'es' * (len(pieces) != 1)} of at least {_SHORTEST:g} s above "
            f"{slowest:.2g} m/s; expected two or more, one to fit and one to check: {fix}"
        )
    fast = int(np.sum((data["v_x"] > slowest) & ~spun))
    order = np.argsort([float(piece["v_x"].mean()) for piece in pieces], kind="stable")
    every = min(_HELD, len(pieces))
    held = {int(i) for i in order[every // 2 :: every]}
    return Stretches(
        train=join(*(p for i, p in enumerate(pieces) if i not in held)),
        held_out=join(*(pieces[i] for i in sorted(held))),
        unused=1 - total / fast,
        spins=tuple((float(data.t[a]), float(data.t[b - 1])) for a, b in runs(data, spun)),
    )


def together(data: Dataset | Sequence[Dataset]) -> Dataset:
    """Several logs as one whose samples know of which they are."""
    if isinstance(data, Dataset):
        return data
    for name, kind in (*dict.fromkeys(ADDED, "input").items(), ("v_y", "output"), ("a_y", "output")):
        has = [name in (part if kind == "input" else part.outputs) for part in data]
        if any(has) and not all(has):
            raise MissingColumnError(
                f"'{data[has.index(True)].name}' has an {kind} {name} and '{data[has.index(False)].name}' has none; "
                f"expected all logs to have it, or none: add it{', 0 where there was none' if kind == 'input' else ''}"
            )
    numbered = [part.with_channel(RECORDING, np.full(part.n_samples, float(k))) for k, part in enumerate(data)]
    return join(*numbered, name=", ".join(dict.fromkeys(part.name for part in data)))


def driven(data: Dataset, wheelbase: float, least: int) -> list[Dataset]:
    """Stretches of at least so many samples in which the car moves, and does not spin."""
    moves = (data["v_x"] > SLOWEST * wheelbase) & ~spinning(data, wheelbase)
    return [data.rows(a, b) for a, b in runs(data, moves) if b - a >= least]


def _cut(run: Dataset, count: int) -> list[Dataset]:
    edges = np.linspace(0, run.n_samples, count + 1).astype(int)
    return [run.rows(int(a), int(b)) for a, b in pairwise(edges)]
