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
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

import numpy as np
from benchmarks.foreign_cars.judge import SEEN, free_run_fits
from benchmarks.foreign_cars.methods import METHODS, OURS
from benchmarks.foreign_cars.real import CARS, RealCar

from slipangle.errors import SlipangleError
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

METHODS_SHOWN = ("scipy", OURS)


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
