"""Adapting to another session: what it does to the free run over what follows, beside leaving the model as it is.

Windows of two real cars and of made ones, none of which the models were fitted to: a linear bicycle with the steering's
gain and offset free, and ARX. Each window is taken as it is, and twice with planted sensors: offset, gain and lag of
the steering and bias of the yaw rate, each there or not. A session counts as worse if the fit of what follows, 18 to
40 s, falls by more than 0.1 points. Made cars drive other manoeuvres than they were fitted to: gains of sensors that
did not change stand for what the model lacks there.
"""

from __future__ import annotations

import sys
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

sys.path.append(str(Path(__file__).parents[1]))  # a benchmark is found by its file, its test bed by its name

import numpy as np
from benchmarks.foreign_cars import fleet
from benchmarks.foreign_cars.judge import known_of
from benchmarks.foreign_cars.real import CARS
from benchmarks.foreign_cars.scipy_fit import Known

from slipangle.data.dataset import Dataset, join
from slipangle.identify.adapt import Adapt
from slipangle.identify.judge.validate import score
from slipangle.identify.linear.arx import ARX
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.model import Model
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

REAL = ("Ferrari 250 LM, race", "Dallara AV-21, Putnam Park")
SECONDS = (30.0, 60.0)
REST, LEAST, WINDOWS = 40.0, 18.0, 4  # s of what follows, at most and at least; windows of each session
WORSE = 0.1  # points of fit
FREE = ("C_f", "C_r", "inertia_z", "steering_gain", "steering_offset")


class Case(NamedTuple):
    """A model, a session that it was not fitted to, and where that comes from."""

    real: bool
    planted: bool
    model: Model
    train: Dataset
    session: Dataset


def models(train: Dataset, known: Known) -> tuple[Model, ...]:
    """Both, of the steering and v_x to the yaw rate."""
    l_r = known.wheelbase - known.l_f
    begin = {"mass": known.mass, "wheelbase": known.wheelbase, "l_f": known.l_f}
    begin |= {"inertia_z": known.mass * known.l_f * l_r, "C_f": 60 * known.mass, "C_r": 70 * known.mass}
    start = Bicycle(params=FERRARI_250LM.with_values(**begin), dt=train.dt)
    return GreyBox(start=start, free=FREE).fit(train), ARX(offset=True).fit(train)


def sessions() -> Iterator[tuple[str, Dataset, Dataset, Known]]:
    """Where from, data to fit, data to adapt to and to judge by, what is known of the car."""
    for name in REAL:
        data = join(*(log.select(outputs=("r",)) for log in CARS[name].logs()))
        n = data.n_samples
        for a, b in ((0, n // 2), (n // 2, n)):
            train = data.rows(b, n) if a == 0 else data.rows(0, a)
            yield name, train, data.rows(a, b), CARS[name].known
    for name in fleet.cars():
        car = fleet.make(name)
        train, test = (log.select(outputs=("r",)) for log in (car.train(1), car.test(2)))
        yield name, train, test, known_of(car)


def planted(data: Dataset, rng: np.random.Generator) -> Dataset:
    """What other sensors read on the same drive."""
    offset, gain, lag, bias = rng.permutation([1.0, *(rng.random(3) < 0.5)]) * rng.standard_normal(4)
    x = np.arange(data.n_samples)
    early = [np.interp(x[a:b] + abs(lag) * 0.03 / data.dt, x[a:b], data["delta"][a:b]) for a, b in _spans(data)]
    delta = np.concatenate(early) / np.exp(0.06 * gain) + 0.15 * offset * np.std(data["delta"])
    return data.with_channel("delta", delta, "rad").with_channel("r", data["r"] + 0.02 * bias * np.std(data["r"]))


def _spans(data: Dataset) -> Iterator[tuple[int, int]]:
    return zip(data.starts, data.stops, strict=True)


def cases(seconds: float) -> Iterator[Case]:
    """Every window of every session, as it is and with planted sensors."""
    for name, train, session, known in sessions():
        step, most, least = (round(t / session.dt) for t in (seconds / 2 + 15, seconds + REST, seconds + LEAST))
        first = [a for a in range(0, session.n_samples, step) if session.n_samples - a >= least][:WINDOWS]
        for model in models(train, known) if first else ():
            for a in first:
                part = session.rows(a, min(a + most, session.n_samples))
                rng = np.random.default_rng([zlib.crc32(name.encode()), a])
                for k in range(3):
                    yield Case(name in CARS, k > 0, model, train, planted(part, rng) if k else part)


def bench(progress: Progress) -> Reproduction:
    """Sessions made worse, adoptions, and the mean change of fit, for each length of what is adapted to."""
    records: list[Record] = []
    for i, seconds in enumerate(SECONDS):
        progress(i / len(SECONDS), f"sessions of {seconds:g} s")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            outcome = [(case, *changed(case, seconds)) for case in cases(seconds)]
        for name, real in (("real cars", (True,)), ("made cars", (False,)), ("all", (True, False))):
            gain, adopted = (np.array([o[k] for o in outcome if o[0].real in real]) for k in (1, 2))
            if not len(gain):
                continue
            row, worse = f"{name}, adapted to {seconds:g} s", int(np.sum(gain < -WORSE))
            note = f"{worse} of {len(gain)} sessions, {int(adopted.sum())} of them adopted"
            share = 100 * worse / len(gain)
            records.append(Record.judged(row, "sessions made worse [%]", None, share, at_most=10.0, note=note))
            records.append(Record.judged(row, "mean change of fit", None, float(gain.mean()), at_least=0.0))
    return Reproduction.told(__doc__, records)


def changed(case: Case, seconds: float) -> tuple[float, bool]:
    """Change of fit over what follows, and whether anything was adopted."""
    n = round(seconds / case.session.dt)
    rest = case.session.rows(n, case.session.n_samples)
    adapted = Adapt(seconds=seconds).fit(case.model, case.session, case.train)
    before, after = (score(model.simulate(rest), "r").fit for model in (case.model, adapted))
    return after - before, not (adapted.fit_info and adapted.fit_info.warnings)
