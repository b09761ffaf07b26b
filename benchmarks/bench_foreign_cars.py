"""Parameters of cars that nobody tuned on, beside a fit by hand.

A made fleet from 1.5 kg to 40 t (`foreign_cars.fleet`): 12 gentle drives of 20 s to train, 4 others up to 0.55 of the
grip to test, noise on every channel, and between the logged steering and the wheels a delay, a lag, a gain and an
offset that nobody is told. Known are mass, wheelbase and l_f. Every method sees the training log alone, once with v_y
and r, once with r only, and runs freely over the test log at its own rate; fits are 100 (1 - |e| / |y - mean|). Truth
are C_f, C_r by the plant's own linearisation and the plant's inertia_z. The competitor (`foreign_cars.scipy_fit`) has
gain, offset, delay, lag and tires that saturate.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

from benchmarks.foreign_cars import fleet
from benchmarks.foreign_cars.judge import SEEN, Case, cases, mistakes_named
from benchmarks.foreign_cars.methods import METHODS, OURS, SHOWN
from benchmarks.foreign_cars.mistakes import MISTAKES

from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

CARS = ("1:10 car", "Formula Student", "medium saloon", "truck, 40 t", "multi-body BMW 320i")  # of a short run
SEEDS = (0,)  # of the noise; every car and the seeds of `fleet.NOISE_SEEDS` with --full


def _share(method: str, row: str, quantity: str, hits: Sequence[bool], least: float, note: str = "") -> Record:
    asked = {"at_least": least} if method == OURS else {}
    return Record.judged(row, quantity, None, 100 * float(np.mean(hits)), note=note, **asked)


def records_of(done: Sequence[Case]) -> list[Record]:
    """Shares over all cars, parameters and seeds for each method, then the cars one by one."""
    scipy = {(c.car, c.seed, c.seen): c for c in done if c.method == "scipy"}
    made: list[Record] = []
    for method in METHODS:
        for seen, outputs in SEEN.items():
            mine = [c for c in done if c.method == method and c.seen == seen]
            row = f"{method}, {seen}"
            inside = [hit for c in mine for hit in c.inside.values()]
            half = [100 * c.half[n] for c in mine for n in SHOWN]
            middle, most = np.nanpercentile(half, [50, 90], method="inverted_cdf")  # some are infinite
            note = f"median half width {middle:.3g} %, 90 % below {most:.3g} %"
            made.append(_share(method, row, "truth in the 95 % interval, or said to be open [%]", inside, 88.0, note))
            if seen == "v_y and r":
                narrow = [h <= 10 for h in half]
                made.append(_share(method, row, "half width at most 10 % [%]", narrow, 88.0))
            rival = [scipy[c.car, c.seed, c.seen].fits for c in mine]
            good = [c.fits[o] >= r[o] - 0.5 for c, r in zip(mine, rival, strict=True) for o in outputs]
            if method != "scipy":
                made.append(_share(method, row, "free run at least scipy's - 0.5 [%]", good, 95.0))
    return made + [r for c in dict.fromkeys(c.car for c in done) for r in _of_car(c, done)]


def _of_car(name: str, done: Sequence[Case]) -> Iterator[Record]:
    """Means over the seeds."""
    for seen, outputs in SEEN.items():
        for method in METHODS:
            mine = [c for c in done if (c.car, c.seen, c.method) == (name, seen, method)]
            off = ", ".join(f"{n} {np.mean([c.inside[n] for c in mine]):.0%}" for n in SHOWN)
            note = next((c.failed for c in mine if c.failed), f"in the interval: {off}")
            for o in outputs:
                value = float(np.mean([c.fits[o] for c in mine]))
                yield Record(f"{name}, {method}, {seen}", f"free run {o} [%]", None, value, note=note)


def bench(
    progress: Progress, cars: Sequence[str] = CARS, seeds: Sequence[int] = SEEDS, mistakes: bool = True
) -> Reproduction:
    """All methods on some cars and noises; see the module."""
    here = [name for name in cars if name in fleet.cars()]
    records = records_of(list(cases(lambda share, what: progress(0.9 * share, what), here, seeds)))
    if mistakes:
        progress(0.9, "planted mistakes")
        named, alarms = mistakes_named(METHODS[OURS], here)
        visible = {m.name: m.visible for m in MISTAKES}
        for name, share in named.items():
            asked = {"at_least": 100.0} if visible[name] else {}
            note = "" if visible[name] else "cannot be seen in this log"
            records.append(Record.judged(f"mistake: {name}", "named [%]", None, 100 * share, note=note, **asked))
        records.append(Record.judged("clean logs", "false alarms [%]", None, 100 * alarms, at_most=2.0))
    for name in set(cars) & set(fleet.missing()):
        records.append(Record(name, "free run [%]", None, "not run", note="commonroad-vehicle-models is not installed"))
    more = f"Cars: {', '.join(here)}; noise seeds {', '.join(map(str, seeds))}."
    return Reproduction.told(__doc__, records, more=more)


if __name__ == "__main__":  # python benchmarks/bench_foreign_cars.py --full: every car, every noise
    from slipangle.report.records import record_table

    full = "--full" in sys.argv
    settings = {"cars": (*fleet.cars(), *fleet.missing()), "seeds": fleet.NOISE_SEEDS} if full else {}
    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr), **settings)
    print(record_table(outcome.records, title=outcome.title).to_text())
