"""N4SID on a million samples with 20 block rows: ours beside peers.

One input, one output, a random stable system of order 4 with coloured disturbance; one thread; processor time, as
others may share the machine. Peers that need memory or time in proportion to the square of the record take fewer
samples. SLICOT's fast QR (through ctrlsys), sippy_unipi and nfoursid are used where they are installed.
"""

from __future__ import annotations

import time
import tracemalloc
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.linear.subspace import Subspace
from slipangle.numerics.blas import one_blas_thread
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._peers import absent, choice_over_fit, in_turn, installed, median_record

SAMPLES, FEWER, FEWEST, ROWS, ORDER, ROUNDS = 1_000_000, 20_000, 5_000, 20, 4, 7
SECONDS, MEGABYTES = 0.5, 200.0
CHOICES, FITS = (1_000, 10_000, 50_000), 5.0  # samples of which orders are chosen, and what that may cost
PEERS = ("ctrlsys", "sippy_unipi", "nfoursid")
POLES = np.array([0.95 * np.exp(0.2j), 0.95 * np.exp(-0.2j), 0.8, 0.5])


def bench(progress: Progress) -> Reproduction:
    """Seconds of a fit and how far its poles are from the true ones."""
    data = record(SAMPLES)
    fewer, fewest = data.head(FEWER), data.head(FEWEST)
    runs: dict[str, tuple[Callable[[], Any], int]] = {
        "slipangle": (lambda: ours(data), SAMPLES),
        f"slipangle, {FEWER} samples": (lambda: ours(fewer), FEWER),
    }
    if installed("ctrlsys"):
        runs["SLICOT IB01AD, IB01BD, without B, D, K"] = (lambda: slicot(data), SAMPLES)
    if installed("sippy_unipi"):
        runs["sippy_unipi"] = (lambda: sippy(fewest), FEWEST)
    if installed("nfoursid"):
        runs["nfoursid"] = (lambda: nfoursid(fewest), FEWEST)
    with one_blas_thread():
        ours(data)
        rates, poles = in_turn(runs, progress, rounds=ROUNDS, clock=time.process_time)
    records: list[Record] = []
    for name, rate in rates.items():
        amount = runs[name][1]
        quantity = f"s, {amount} samples"
        bound = f"<= {SECONDS:g}" if name == "slipangle" else ""
        note = f"poles off by {distance(poles[name]):.1g}"
        records.append(median_record(name, quantity, [amount / r for r in rate], bound=bound, most=True, note=note))
    records.append(memory(data))
    records += [order_choice(data.head(n)) for n in CHOICES]
    return Reproduction(
        title="N4SID, a million samples, 20 block rows",
        records=(*records, *absent(PEERS, "N4SID")),
        protocol=(
            f"{SAMPLES} samples, {ROWS} block rows, order {ORDER}; peers that grow with the record's square {FEWEST}; "
            f"one thread, processor time, medians over {ROUNDS} rounds in turn (peers 3)."
        ),
    )


def record(n: int) -> Dataset:
    """Output of the true system."""
    rng = np.random.default_rng(0)
    u, e = rng.standard_normal(n), 0.3 * rng.standard_normal(n)
    denominator = np.real(np.poly(POLES))
    y = lfilter([0.0, 1.0, 0.5, -0.3, 0.1], denominator, u) + lfilter([1.0, -1.2, 0.5, 0.0, 0.0], denominator, e)
    return Dataset.from_arrays({"u": u}, {"y": y}, 1.0)


def distance(poles: np.ndarray) -> float:
    """Largest distance of a true pole from the nearest found."""
    return float(np.abs(POLES[:, None] - np.asarray(poles)[None]).min(axis=1).max())


def ours(data: Dataset) -> np.ndarray:
    """Poles by N4SID, with B, D, K and the initial state found along."""
    return Subspace(order=ORDER, algorithm="n4sid", block_rows=ROWS).fit(data).poles


def order_choice(data: Dataset) -> Record:
    """Fits of the chosen order that a fit of `StateSpace` costs which chooses it."""
    ratios = choice_over_fit(
        lambda: StateSpace().fit(data), lambda m: StateSpace(order=m.order).fit(data), rounds=ROUNDS
    )
    name = f"order choice over one fit, {data.n_samples} samples"
    return median_record(name, "fits", ratios, bound=f"<= {FITS:g}", most=True)


def memory(data: Dataset) -> Record:
    """What a fit allocates beyond the data; the same for a record of a tenth of the length."""
    peaks = []
    for part in (data, data.head(SAMPLES // 10)):
        tracemalloc.start()
        ours(part)
        peaks.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    note = f"{peaks[1]:.3g} for a tenth of the record"
    bound = f"<= {MEGABYTES:g}"
    return median_record("slipangle", "MB beyond the data", [peaks[0]], bound=bound, most=True, note=note)


def slicot(data: Dataset) -> np.ndarray:
    """Fast QR on the block Hankel matrix, then A, B, C, D."""
    import ctrlsys  # type: ignore[import-not-found]

    u, y = np.asfortranarray(data.u), np.asfortranarray(data.y)
    _, r, *_ = ctrlsys.ib01ad("N", "F", "N", "O", "N", "N", ROWS, 1, 1, u, y, 0.0, -1.0)
    A, *_ = ctrlsys.ib01bd("N", "A", "N", ROWS, ORDER, 1, 1, len(u), r, 0.0)
    return np.linalg.eigvals(A)


def sippy(data: Dataset) -> np.ndarray:
    """N4SID of SIPPY."""
    from sippy_unipi import system_identification  # type: ignore[import-not-found]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = system_identification(data["y"], data["u"], "N4SID", SS_fixed_order=ORDER, SS_f=ROWS, SS_p=ROWS)
    return np.linalg.eigvals(found.A)


def nfoursid(data: Dataset) -> np.ndarray:
    """N4SID of nfoursid."""
    import pandas  # type: ignore[import-not-found,import-untyped]
    from nfoursid.nfoursid import NFourSID  # type: ignore[import-not-found]

    frame = pandas.DataFrame({"u": data["u"], "y": data["y"]})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = NFourSID(frame, output_columns=["y"], input_columns=["u"], num_block_rows=ROWS)
        found.subspace_identification()
        model, _ = found.system_identification(rank=ORDER)
    return np.linalg.eigvals(model.a)
