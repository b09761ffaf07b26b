"""Training of networks in epochs per second, by processor and, where JAX sees one, by GPU; side by side in one run.

Data: the Narendra-Parthasarathy system, seed 0. Every case is trained by `fit` with one stage from the linear start,
its free runs over the held-out part included, once before the clock starts, so that nothing is compiled in time.
Medians by the clock over rounds in turn; single precision. A GPU is seen with ``pip install "jax[cuda13]"``.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.neural_statespace import NeuralStateSpace
from slipangle.identify.networks.problem import Stage
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._peers import in_turn, median_record
from slipangle.reproduce.plants import narendra

ROUNDS = 3


class Case(NamedTuple):
    """What is trained: ``fit`` takes how many epochs."""

    name: str
    estimator: Callable[[int], Any]
    samples: int
    epochs: int


def narx(epochs: int, *, batch: int, hidden: tuple[int, ...]) -> NARX:
    """One-step-ahead NARX with the lags of the system."""
    stage = Stage(horizon=1, epochs=epochs, batch=batch, patience=epochs)
    return NARX(na=3, nb=2, hidden=hidden, stages=(stage,), seeds=(0,))


def states(epochs: int, *, batch: int, hidden: tuple[int, ...]) -> NeuralStateSpace:
    """State space of order 3 over windows of 40 steps."""
    stage = Stage(horizon=40, epochs=epochs, batch=batch, patience=epochs)
    return NeuralStateSpace(order=3, hidden=hidden, stages=(stage,), gain_stages=())


SMALL, WIDE = (50, 50, 50), (512, 512)  # neurons
CASES = (
    Case("NARX 3 x 50, 800 samples, batches of 100", partial(narx, batch=100, hidden=SMALL), 800, 400),
    Case("NARX 3 x 50, 20 000 samples, batches of 100", partial(narx, batch=100, hidden=SMALL), 20_000, 80),
    Case("NARX 2 x 512, 20 000 samples, batches of 8 192", partial(narx, batch=8192, hidden=WIDE), 20_000, 40),
    Case("states 2 x 32, 20 000 samples, batches of 100", partial(states, batch=100, hidden=(32, 32)), 20_000, 80),
    Case(
        "states 2 x 256, 20 000 samples, batches of 2 048", partial(states, batch=2048, hidden=(256, 256)), 20_000, 40
    ),
)


def bench(progress: Progress) -> Reproduction:
    """Epochs per second of each case on each device."""
    records: list[Record] = []
    for i, case in enumerate(CASES):
        records += trainings(case, lambda share, what, i=i: progress((i + share) / len(CASES), what))
    kinds = ", ".join(f"{name} ({device.device_kind})" for name, device in devices().items())
    return Reproduction(
        title="Training of networks, by processor and GPU",
        records=tuple(records),
        protocol=(
            f"Narendra-Parthasarathy system, seed 0; one stage from the linear start, 15 % held out; {kinds}, "
            f"{os.cpu_count()} processor cores; wall clock, medians over {ROUNDS} rounds in turn."
        ),
    )


def devices() -> dict[str, Any]:
    """The processor and, where JAX has one, the first GPU."""
    import jax

    found = {"processor": jax.devices("cpu")[0]}
    if jax.default_backend() != "cpu":
        found["GPU"] = jax.devices()[0]
    return found


def trainings(case: Case, progress: Progress) -> list[Record]:
    """Rates of one case on every device, and how far its free runs are from each other."""
    import jax

    data = narendra.estimation(case.samples)
    settings = case.estimator(case.epochs)

    def fit(device: Any) -> float:
        with jax.default_device(device):
            return settings.fit(data).fit_info.trials[0].score

    found = devices()
    for name, device in found.items():
        progress(0.0, f"{case.name}, {name}, compiling")
        fit(device)
    runs = {f"slipangle, {name}": (partial(fit, device), case.epochs) for name, device in found.items()}
    rates, scores = in_turn(runs, progress, rounds=ROUNDS, clock=time.perf_counter)
    return [
        median_record(
            f"{case.name}, {name.removeprefix('slipangle, ')}",
            "epochs/s, median",
            rate,
            note=f"held-out free run {scores[name]:.4g}",
        )
        for name, rate in rates.items()
    ]
