"""Dropouts: places where a channel falls to exactly zero and comes back to where it was."""

from dataclasses import dataclass

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.quality.events import Event, level_step, quantity, runs

_MOVING = ("speed", "angular rate", "angle", "acceleration")  # what a pedal does between two gears is none
_LONGEST = 1.0  # s
_STEP = 5.0  # of the largest usual step, that it is to fall by
_USUAL = 99.0  # percentile of the steps elsewhere that is the largest usual one
_BACK = 0.5  # of what it was, within which it comes back
_FEWEST = 2


@dataclass(frozen=True, kw_only=True)
class Dropout(Event):
    """A channel that falls to zero and comes back; the first of ``count`` such places.

    ``samples`` is the length of the longest one.
    """

    samples: int
    count: int

    @property
    def sentence(self) -> str:
        """The finding in words."""
        longest = f"up to {self.samples} samples" if self.samples > 1 else "a single sample"
        return (
            f"{self.channel} drops to 0 and comes back in {self.count} places of {longest}, the first by {self.read} "
            f'at t = {self.t:.2f} s: leave them out, as by filter = "{self.channel} != 0"'
        )


def find_dropouts(data: Dataset, channel: str) -> Dropout | None:
    """Places where a channel that tells of motion is exactly zero for a second or less, and far from it just around.

    None where there are fewer than two. Raises MissingColumnError if there is no such channel.
    """
    unit = data.unit(channel)
    if quantity(unit) not in _MOVING:
        return None
    steps = np.concatenate([_steps_elsewhere(part[channel]) for part in data.experiments])
    if not len(steps):
        return None
    usual = max(float(np.percentile(np.abs(steps), _USUAL)), level_step(data[channel]))
    x, found = data[channel], list[tuple[int, int, float]]()
    for a, b in runs(data, x == 0):
        if a in data.starts or b in data.stops or (b - a) * data.dt > _LONGEST:
            continue
        before, after = float(x[a - 1]), float(x[b])
        falls = min(abs(before), abs(after)) > _STEP * usual
        if falls and abs(after - before) < _BACK * abs(before):
            found.append((a, b - a, before))
    if len(found) < _FEWEST:
        return None
    row, _, size = found[0]
    longest = max(samples for _, samples, _ in found)
    at = {"row": row, "t": float(data.t[row]), "size": -size, "unit": unit}
    return Dropout(channel=channel, samples=longest, count=len(found), **at)


def _steps_elsewhere(x: np.ndarray) -> np.ndarray:
    """Steps between neighbours that are not zero."""
    return np.diff(x)[(x[1:] != 0) & (x[:-1] != 0)]
