"""Real logs of four cars: `identify_car` beside a fit by hand, by the free run over the rest of each log.

Of every recording the first 70 % of the time is for the fit, the last 30 % to judge it; stretches of at least 4 s in
which the car moves count, each a free run from its first sample, its first half second left out. Known are mass,
wheelbase and l_f as their owners give them. Both methods see the yaw rate alone, once more with v_y where the log has
it; steering as logged: the small car's is a command from -1 to 1, of which nobody says how far it turns the wheels.
The competitor (`foreign_cars.scipy_fit`) is the one of the made fleet; fits are 100 (1 - |e| / |y - mean|).
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

import numpy as np
from benchmarks.foreign_cars.judge import SEEN, free_run_fits
from benchmarks.foreign_cars.methods import METHODS, OURS
from benchmarks.foreign_cars.scipy_fit import Known

from slipangle.data.dataset import Dataset, join
from slipangle.data.public.sets import public
from slipangle.errors import SlipangleError
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

TRAIN = 0.7  # of each recording
SHORTEST = 4.0  # s
METHODS_SHOWN = ("scipy", OURS)


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


def _records(name: str, car: RealCar) -> Iterator[Record]:
    train, test = car.logs()
    for seen in car.seen:
        outputs = SEEN[seen]
        fits: dict[str, dict[str, float]] = {}
        for method in METHODS_SHOWN:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    found = METHODS[method](train.select(outputs=outputs), car.known, outputs)
                    fits[method] = free_run_fits(test, outputs, found.simulate(test.select(outputs=outputs)))
                note = "; ".join(found.sentences)
            except SlipangleError as error:
                fits[method], note = dict.fromkeys(outputs, -np.inf), str(error)
            for o in outputs:
                asked = {"at_least": fits["scipy"][o]} if method == OURS else {}
                yield Record.judged(
                    f"{name}, {method}, {seen}", f"free run {o} [%]", None, fits[method][o], note=note, **asked
                )


def bench(progress: Progress) -> Reproduction:
    """Both methods on every log; see the module."""
    records: list[Record] = []
    for k, (name, car) in enumerate(CARS.items()):
        progress(k / len(CARS), name)
        records += _records(name, car)
    return Reproduction.told(__doc__, records)


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
