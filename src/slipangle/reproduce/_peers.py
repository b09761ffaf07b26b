"""What the benchmarks share: runs in turn, peers that may be missing."""

import importlib
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from slipangle.report.records import Record
from slipangle.reproduce import Progress

Clock = Callable[[], float]


def in_turn(
    runs: dict[str, tuple[Callable[[], Any], int]], progress: Progress, *, rounds: int, clock: Clock = time.perf_counter
) -> tuple[dict[str, list[float]], dict[str, Any]]:
    """Amount per second of every run in every round, and what it gave last; peers sit out after three rounds.

    ``runs`` are what to run and how much that is; names of our own start with "slipangle". All run in turn, so that a
    noisy moment hits all. ``clock`` is `time.perf_counter`, or `time.process_time` where others share the processor.
    """
    rates: dict[str, list[float]] = {name: [] for name in runs}
    results: dict[str, Any] = {}
    for i in range(rounds):
        for j, (name, (run, amount)) in enumerate(runs.items()):
            if i >= 3 and not name.startswith("slipangle"):
                continue
            progress((i + j / len(runs)) / rounds, f"{name}, round {i + 1}")
            began = clock()
            results[name] = run()
            rates[name].append(amount / max(clock() - began, 1e-9))
    return rates, results


def choice_over_fit(choose: Callable[[], Any], fit: Callable[[Any], Any], *, rounds: int) -> list[float]:
    """How many fits of the orders that were chosen a fit costs that chooses them, round by round, one after the other.

    ``fit`` takes the model that ``choose`` gave; seconds are those of this thread.
    """
    model, ratios = choose(), []
    fit(model)
    for _ in range(rounds):
        began = time.thread_time()
        choose()
        between = time.thread_time()
        fit(model)
        ratios.append((between - began) / max(time.thread_time() - between, 1e-9))
    return ratios


def median_record(
    row: str, quantity: str, values: Sequence[float], *, bound: str = "", most: bool = False, note: str = ""
) -> Record:
    """The median of a few runs beside a bound such as ``">= 1e8"``; the worst of them in the note."""
    here = float(np.median(values))
    limit = float(bound.split()[-1]) if bound else 0.0
    worst = max(values) if most else min(values)
    said = f"worst of {len(values)} rounds {worst:.3g}"
    holds = (here <= limit if most else here >= limit) if bound else None
    return Record(row, quantity, None, here, bound, holds, f"{said}; {note}" if note else said)


@contextmanager
def one_core() -> Iterator[None]:
    """Keep all threads on one core where the system allows it, so that processor time is what a step takes."""
    setter, getter = getattr(os, "sched_setaffinity", None), getattr(os, "sched_getaffinity", None)
    before = getter(0) if getter else set()
    if setter and before:
        setter(0, {min(before)})
    try:
        yield
    finally:
        if setter and before:
            setter(0, before)


def installed(name: str) -> Any:
    """The module, or None."""
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def absent(names: tuple[str, ...], what: str) -> list[Record]:
    """A record that says which peers are missing."""
    missing = [name for name in names if installed(name) is None]
    note = f"not installed: {', '.join(missing)}; install them beside slipangle to compare"
    return [Record(f"{what}, peers", "skipped", None, ", ".join(missing), note=note)] if missing else []
