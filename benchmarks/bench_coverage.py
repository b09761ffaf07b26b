"""How often 95 % intervals hold the truth, and how often true models are said to lack dynamics.

One input, one output, order 2, 1000 samples; noise of a fifth of the output's standard deviation, white or a
first-order autoregression with a pole of 0.9. Grey boxes are a bicycle on one record and a drive line on four
experiments, with noise of a twentieth. Nothing here is a speed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import lfilter

from slipangle.data.dataset import Dataset, join
from slipangle.identify.judge.validate import validate
from slipangle.identify.linear.arx import ARX
from slipangle.identify.linear.polynomial import BoxJenkins, OutputError
from slipangle.identify.linear.statespace import StateSpace
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.model import FitInfo
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.models.vehicles.longitudinal import Longitudinal, LongitudinalParams
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

SETS, JUDGED, N = 150, 200, 1000
TONES = (0.13, 0.31, 0.72, 1.3)  # Hz
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
CAR = Bicycle(params=SOUSA_TABLE_7_2, dt=0.05)
DRIVE_LINE = Longitudinal(params=LongitudinalParams(mass=800.0, k_e=6000.0, k_d=60.0, k_r=0.02), dt=0.05)
GREY: dict[str, tuple[Bicycle | Longitudinal, tuple[str, ...], int]] = {
    "grey box, bicycle": (CAR, ("C_f", "C_r", "inertia_z"), 1),
    "grey box, drive line": (DRIVE_LINE, ("k_e", "k_d", "k_r"), 4),
}
TRUE = {
    "ARX": (ARX(na=2, nb=2), [1.0], A),
    "OE": (OutputError(nb=2, nf=2), [1.0], [1.0]),
    "BJ": (BoxJenkins(nb=2, nf=2, nc=1, nd=1), [1.0, 0.5], [1.0, -0.8]),
}


def bench(progress: Progress) -> Reproduction:
    """Coverage of every estimate, white and coloured; then false alarms of the residual tests."""
    records = []
    cases = [(name, pole) for pole in (0.0, 0.9) for name in (*FITS, *GREY)]
    total = len(cases) + len(TRUE)
    for i, (name, pole) in enumerate(cases):
        progress(i / total, f"{name}, noise pole {pole:g}")
        records += coverage(name, pole)
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


def coverage(name: str, pole: float) -> list[Record]:
    """Share of intervals that hold the truth, of every estimate."""
    rng = np.random.default_rng(0)
    truth = TRUTH[name] if name in FITS else {n: GREY[name][0].value(n) for n in GREY[name][1]}
    inside = {key: 0 for key in truth}
    for _ in range(SETS):
        if name in FITS:
            info = FITS[name](record(rng, [1.0], [1.0, -pole], N))
        else:
            model, free, parts = GREY[name]
            info = GreyBox(start=model, free=free).fit(join(*(driven(rng, model, pole) for _ in range(parts)))).fit_info
        if info is None:
            raise TypeError(f"the fit of {name} tells nothing of itself; expected intervals")
        for key, value in truth.items():
            low, high = info.interval()[info.names.index(key)]
            inside[key] += bool(low <= value <= high)
    row = f"{name}, {'white' if pole == 0 else f'AR(1) {pole:g}'}"
    return [Record.judged(row, f"%, {key}", None, 100 * k / SETS, at_least=90.0) for key, k in inside.items()]


def driven(rng: np.random.Generator, model: Bicycle | Longitudinal, pole: float) -> Dataset:
    """Free run under four tones, with such noise; of several experiments each has its share of the samples."""
    car = isinstance(model, Bicycle)
    n = N if car else N // 4
    phases = rng.uniform(0, 2 * np.pi, 4)
    at = 2 * np.pi * model.dt * np.arange(n)[:, None]
    tones = np.sin(at * np.array(TONES) + phases).sum(axis=1) / 2
    inputs = {"delta": 0.03 * tones, "v_x": np.full(n, 20.0)} if car else {"pedal": 0.2 + 0.5 * tones}
    start = 0.0 if car else 20.0  # of r, or of v_x
    data = Dataset.from_arrays(inputs, {o: np.full(n, start) for o in model.outputs}, model.dt)
    y = model.simulate(data).y[:, 0]
    noise: Any = lfilter([1.0], [1.0, -pole], rng.standard_normal(n + 200))
    size = 0.05 * np.std(y) * np.sqrt(1 - pole**2)
    return data.with_channel(model.outputs[0], y + size * noise[200:] * (np.arange(n) > 0))


def record(rng: np.random.Generator, numerator: list, denominator: np.ndarray | list, n: int) -> Dataset:
    """Output of the true system with coloured noise, a fifth of its size."""
    u, e = rng.standard_normal((2, n + 200))
    y, noise = lfilter(B, A, u), lfilter(numerator, denominator, e)
    y = y + 0.2 * np.std(y) / np.std(noise) * noise
    return Dataset.from_arrays({"u": u[200:]}, {"y": y[200:]}, 1.0)
