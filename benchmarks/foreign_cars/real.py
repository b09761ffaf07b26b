"""Real cars: their public logs, what is known of each, and how a log is cut into one to fit and one to judge by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from benchmarks.foreign_cars.judge import SEEN
from benchmarks.foreign_cars.scipy_fit import Known

from slipangle.data.dataset import Dataset, join
from slipangle.data.public.sets import public

TRAIN = 0.7  # of each recording
SHORTEST = 4.0  # s


@dataclass(frozen=True, kw_only=True)
class RealCar:
    """A public log, the channel that steers, and what is known of the car."""

    log: str
    steering: str
    known: Known
    seen: tuple[str, ...]

    def logs(self) -> tuple[Dataset, Dataset]:
        """The log to fit and the one to judge by, with delta, v_x, r and v_y where measured."""
        data = public(self.log)
        data = data.with_channel("delta", data[self.steering], "rad")
        outputs = tuple(n for n in ("v_y", "r") if n in data)
        data = data.select(inputs=("delta", "v_x"), outputs=outputs)
        train, test = [], []
        for part in data.experiments:
            split = round(TRAIN * part.n_samples)
            train += self._moving(part.rows(0, split))
            test += self._moving(part.rows(split, part.n_samples))
        return join(*train), join(*test)

    def _moving(self, part: Dataset) -> list[Dataset]:
        fast = np.concatenate([[False], part["v_x"] > 2.0 * self.known.wheelbase, [False]])
        edges = np.flatnonzero(np.diff(fast.astype(int))).reshape(-1, 2)
        return [part.rows(int(a), int(b)) for a, b in edges if (b - a) * part.dt >= SHORTEST]


FERRARI = Known(mass=982.0, wheelbase=2.4, l_f=1.39)
CARS = {
    "Ferrari 250 LM, race": RealCar(log="ferrari-250lm", steering="delta", known=FERRARI, seen=tuple(SEEN)),
    "Ferrari 250 LM, session": RealCar(log="ferrari-250lm-session", steering="delta", known=FERRARI, seen=("r only",)),
    "Dallara AV-21, Putnam Park": RealCar(
        log="iac-putnam",
        steering="delta",
        known=Known(mass=790.0, wheelbase=2.9808, l_f=1.248),
        seen=tuple(SEEN),
    ),
    "DART, 1:10": RealCar(
        log="dart", steering="steering", known=Known(mass=1.67, wheelbase=0.175, l_f=0.0945), seen=tuple(SEEN)
    ),
}
