"""Real logs of four cars: `identify_car` beside a fit by hand, by the free run over the rest of each log.

Of every recording the first 70 % of the time is for the fit, the last 30 % to judge it; stretches of at least 4 s in
which the car moves count, each a free run from its first sample, its first half second left out. Known are mass,
wheelbase and l_f as their owners give them. Both methods see the yaw rate alone, once more with v_y where the log has
it; steering as logged: the small car's is a command from -1 to 1, of which nobody says how far it turns the wheels.
The competitor (`foreign_cars.scipy_fit`) is the one of the made fleet; fits are 100 (1 - |e| / |y - mean|).
Beside ours stands how far it is from the competitor's, with a standard error: jackknife over blocks of 5 s.
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

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

METHODS_SHOWN = ("scipy", OURS)
BLOCK = 5.0  # s


def _records(name: str, car: RealCar) -> Iterator[Record]:
    train, test = car.logs()
    for seen in car.seen:
        outputs = SEEN[seen]
        fits: dict[str, dict[str, float]] = {}
        runs: dict[str, np.ndarray] = {}
        for method in METHODS_SHOWN:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    found = METHODS[method](train.select(outputs=outputs), car.known, outputs)
                    runs[method] = found.simulate(test.select(outputs=outputs))
                    fits[method] = free_run_fits(test, outputs, runs[method])
                note = "; ".join(found.sentences)
            except SlipangleError as error:
                fits[method], note = dict.fromkeys(outputs, -np.inf), str(error)
            for o in outputs:
                least = fits["scipy"][o] if method == OURS else None
                if len(runs) == len(METHODS_SHOWN):
                    ahead, spread = _ahead(test, outputs, o, runs)
                    note = f"{ahead:+.2f} +- {spread:.2f}; {note}"
                yield Record.judged(
                    f"{name}, {method}, {seen}", f"free run {o} [%]", None, fits[method][o], at_least=least, note=note
                )


def _ahead(test: Dataset, outputs: tuple[str, ...], of: str, runs: dict[str, np.ndarray]) -> tuple[float, float]:
    """Fit of ours less that of the competitor, and its standard error by leaving out one block after the other. [%]"""
    n = round(BLOCK / test.dt)
    blocks = [(k, min(k + n, b)) for a, b in zip(test.starts, test.stops, strict=True) for k in range(a, b, n)]

    def difference(rows: np.ndarray) -> float:
        measured = test[of][rows]
        size = {m: np.linalg.norm(measured - run[rows, outputs.index(of)]) for m, run in runs.items()}
        return float(100 * (size["scipy"] - size[OURS]) / np.linalg.norm(measured - measured.mean()))

    every = np.arange(test.n_samples)
    each = np.array([difference(np.delete(every, np.s_[a:b])) for a, b in blocks])
    return difference(every), float(np.sqrt((len(each) - 1) * np.mean((each - each.mean()) ** 2)))


def bench(progress: Progress) -> Reproduction:
    """Both methods on every log; see the module."""
    records: list[Record] = []
    for k, (name, car) in enumerate(CARS.items()):
        progress(k / len(CARS), name)
        for record in _records(name, car):
            records.append(record)
            progress(k / len(CARS), f"{record.row}, {record.quantity}: {record.here:.2f} {record.bound}; {record.note}")
    return Reproduction.told(__doc__, records)


if __name__ == "__main__":
    from slipangle.report.records import record_table

    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr))
    print(record_table(outcome.records, title=outcome.title).to_text())
