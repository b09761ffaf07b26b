"""How often 95 % intervals hold the truth, and how often true models are said to lack dynamics.

One input, one output, order 2, 1000 samples; noise of a fifth of the output's standard deviation, white or a
first-order autoregression with a pole of 0.9. Nothing here is a speed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.polynomial import BoxJenkins, OutputError
from slipangle.identify.linear.statespace import StateSpace
from slipangle.models.model import FitInfo
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

SETS, JUDGED, N = 150, 200, 1000
A, B = np.array([1.0, -1.5, 0.7]), np.array([0.0, 1.0, 0.5])
POLE = np.roots(A)[0]
TRUTH = {
    "OE": {"b1[u]": 1.0, "b2[u]": 0.5, "f1[u]": -1.5, "f2[u]": 0.7},
    "state space, simulation": {
        "modulus[0]": abs(POLE),
        "angle[0]": abs(np.angle(POLE)),
        "gain[y,u]": B.sum() / A.sum(),
    },
}
FITS: dict[str, Callable[[Dataset], FitInfo | None]] = {
    "OE": lambda data: OutputError(nb=2, nf=2).fit(data).fit_info,
    "state space, simulation": lambda data: StateSpace(order=2, focus="simulation").fit(data).modes(),
}
TRUE = {
    "ARX": (ARX(na=2, nb=2), [1.0], A),
    "OE": (OutputError(nb=2, nf=2), [1.0], [1.0]),
    "BJ": (BoxJenkins(nb=2, nf=2, nc=1, nd=1), [1.0, 0.5], [1.0, -0.8]),
}


def bench(progress: Progress) -> Reproduction:
    """Coverage of every estimate, white and coloured; then false alarms of the residual tests."""
    records = []
    cases, total = [(name, fit, pole) for pole in (0.0, 0.9) for name, fit in FITS.items()], 2 * len(FITS) + len(TRUE)
    for i, (name, fit, pole) in enumerate(cases):
        progress(i / total, f"{name}, noise pole {pole:g}")
        records += coverage(name, fit, pole)
    for i, (name, (estimator, numerator, denominator)) in enumerate(TRUE.items()):
        progress((len(cases) + i) / total, f"true {name} models")
        rng, said = np.random.default_rng(0), 0
        for _ in range(JUDGED):
            train, test = record(rng, numerator, denominator, 2 * N).split(0.7)
            said += "still depends" in validate(estimator.fit(train), test).residuals["y"].sentences[1]
        quantity = "%, said to lack dynamics"
        records.append(Record.judged(f"true {name}", quantity, None, 100 * said / JUDGED, at_most=3.0))
    protocol = f"{SETS} sets of {N} samples for intervals; {JUDGED} of {2 * N}, judged on the last 30 %; seed 0."
    return Reproduction(title="Coverage of 95 % intervals", records=tuple(records), protocol=protocol)


def coverage(name: str, fit: Callable[[Dataset], FitInfo | None], pole: float) -> list[Record]:
    """Share of intervals that hold the truth, of every estimate."""
    rng, truth = np.random.default_rng(0), TRUTH[name]
    inside = {key: 0 for key in truth}
    for _ in range(SETS):
        info = fit(record(rng, [1.0], [1.0, -pole], N))
        if info is None:
            raise TypeError(f"the fit of {name} tells nothing of itself; expected intervals")
        for key, value in truth.items():
            low, high = info.interval()[info.names.index(key)]
            inside[key] += bool(low <= value <= high)
    row = f"{name}, {'white' if pole == 0 else f'AR(1) {pole:g}'}"
    return [Record.judged(row, f"%, {key}", None, 100 * k / SETS, at_least=90.0) for key, k in inside.items()]


def record(rng: np.random.Generator, numerator: list, denominator: np.ndarray | list, n: int) -> Dataset:
    """Output of the true system with coloured noise, a fifth of its size."""
    u, e = rng.standard_normal((2, n + 200))
    y, noise = lfilter(B, A, u), lfilter(numerator, denominator, e)
    y = y + 0.2 * np.std(y) / np.std(noise) * noise
    return Dataset.from_arrays({"u": u[200:]}, {"y": y[200:]}, 1.0)
