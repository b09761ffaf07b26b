"""Judging a method: its free run over the test log, its intervals beside the truth, and what it says of mistakes."""

from __future__ import annotations

import re
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from benchmarks.foreign_cars import fleet
from benchmarks.foreign_cars.methods import METHODS, SHOWN, Method
from benchmarks.foreign_cars.mistakes import MISTAKES
from benchmarks.foreign_cars.scipy_fit import Known

from slipangle.data.dataset import Dataset
from slipangle.errors import SlipangleError
from slipangle.reproduce import Progress

SEEN = {"v_y and r": ("v_y", "r"), "r only": ("r",)}


@dataclass(frozen=True, kw_only=True)
class Case:
    """One method on one car, one noise and one choice of outputs."""

    car: str
    seed: int
    seen: str
    method: str
    fits: dict[str, float]  # of the free run on the test log [%]
    inside: dict[str, bool]  # by parameter, whether the truth is in its interval, or the method says it cannot tell
    half: dict[str, float]  # half width of its interval over the truth; infinite where it cannot tell [-]
    error: dict[str, float]  # of the middle of its interval, over the truth [-]
    seconds: float
    failed: str = ""


def free_run_fits(log: Dataset, outputs: Sequence[str], y: np.ndarray, skip: float = 0.5) -> dict[str, float]:
    """Fit of each output over all experiments together, the first half second of each left out. [%]"""
    used = np.ones(log.n_samples, dtype=bool)
    for a in log.starts:
        used[a : a + round(skip / log.dt)] = False
    measured = log.columns(tuple(outputs))[used]
    error = np.linalg.norm(measured - y[used], axis=0) / np.linalg.norm(measured - measured.mean(axis=0), axis=0)
    return dict(zip(outputs, (100 * (1 - error)).tolist(), strict=True))


def seen_of(log: Dataset, outputs: tuple[str, ...]) -> Dataset:
    """The log of a car whose user has sensors of the outputs; with v_y comes a_y, as one more channel."""
    names = ("delta", "v_x", *outputs, *(("a_y",) if "v_y" in outputs else ()))
    channels = tuple(log.channels[log.index(n)] for n in names)
    return replace(log, values=log.columns(names), channels=channels, outputs=outputs)


def known_of(car: fleet.ForeignCar) -> Known:
    """What its user measured."""
    return Known(mass=car.plant.mass, wheelbase=car.plant.wheelbase, l_f=car.plant.l_f)


def case(name: str, seed: int, seen: str, method: str) -> Case:
    """A method fitted and judged; one that raises has no fit and no interval."""
    car, outputs = fleet.make(name), SEEN[seen]
    at: dict[str, Any] = {"car": name, "seed": seed, "seen": seen, "method": method}
    train, test = (seen_of(log, outputs) for log in (car.train(seed), car.test(seed)))
    truth = {n: car.truth.values[n] for n in SHOWN}
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = METHODS[method](train, known_of(car), outputs)
            seconds = time.perf_counter() - began
            fits = free_run_fits(test, outputs, found.simulate(test))
    except SlipangleError as error:
        nothing = dict.fromkeys(SHOWN, np.inf)
        lost, out = dict.fromkeys(outputs, -np.inf), dict.fromkeys(SHOWN, False)
        return Case(**at, fits=lost, inside=out, half=nothing, error=nothing, seconds=0.0, failed=str(error))
    inside, half, off = {}, {}, {}
    for n, value in truth.items():
        low, high = found.intervals.get(n, (np.nan, np.nan))
        said = n in found.inseparable
        inside[n] = said or bool(low <= value <= high)
        half[n] = np.inf if said else 0.5 * (high - low) / value
        off[n] = 0.5 * (high + low) / value - 1
    return Case(**at, fits=fits, inside=inside, half=half, error=off, seconds=seconds)


def cases(progress: Progress, cars: Sequence[str], seeds: Sequence[int]) -> Iterator[Case]:
    """Every method on every log."""
    all_of = [(c, s, seen, m) for c in cars for s in seeds for seen in SEEN for m in METHODS]
    for k, (name, seed, seen, method) in enumerate(all_of):
        progress(k / len(all_of), f"{method} on {name}, {seen}, noise {seed}")
        yield case(name, seed, seen, method)


def mistakes_named(method: Method, cars: Sequence[str], seed: int = 0) -> tuple[dict[str, float], float]:
    """Share of cars on which each planted mistake is named, and share of clean logs on which any of them is."""
    named: dict[str, list[bool]] = {m.name: [] for m in MISTAKES}
    alarms = []
    for name in cars:
        car = fleet.make(name)
        clean, known = car.train(seed), known_of(car)
        said = _sentences(method, clean, known)
        alarms.append(any(mistake.named(said) for mistake in MISTAKES))
        for mistake in MISTAKES:
            more = _sentences(method, mistake.data(clean), mistake.known(known))
            before = {_wordy(sentence) for sentence in said}
            named[mistake.name].append(mistake.named(s for s in more if _wordy(s) not in before))
    return {n: float(np.mean(seen)) for n, seen in named.items()}, float(np.mean(alarms))


def _wordy(sentence: str) -> str:
    """A sentence without its numbers."""
    return re.sub(r"[\d.+-]+", "", sentence)


def _sentences(method: Method, data: Dataset, known: Known) -> tuple[str, ...]:
    """What a method says; an error is a sentence too."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return method(seen_of(data, SEEN["v_y and r"]), known, SEEN["v_y and r"]).sentences
    except SlipangleError as error:
        return (str(error),)
