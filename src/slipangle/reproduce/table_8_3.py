"""Table 8.3: speed from pedals, M2 and its hybrid M2-H, free runs.

The copy of the Ferrari's data lacks throttle and brake, so the log is another: Dallara AV-21 at Putnam Park, 25 Hz,
with both pedals. Its fast part starts at 202 s. Five rolling splits: fit to the first 50, 55, ..., 70 % of the fast
part, one free run over the 30 % that follow; the last of them is the last 30 %. M2 is fitted to runs restarted every
10 s, so that slow drift (the road's slope is not measured) does not dominate. M3 (state space) and M4 (NARX, seeds 0
to 4) see the pedals alone: with the steering angle they learn where on the track it is turned. Whether a discrepancy
stays on is decided inside each split's training part. Nothing is comparable with the thesis' car and speeds but the
kind of task, and three minutes of one drive are little for a black box: M4 says little of the next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slipangle import Dataset, GreyBox, Hybrid, Model, NARXModel, StateSpace, public
from slipangle.identify.judge.initial import restarted
from slipangle.identify.judge.validate import Score, score
from slipangle.identify.networks.presets import SOUSA_TABLE_8_3, SOUSA_TABLE_8_3_DISCREPANCY
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.models.vehicles.longitudinal import DrivelineParams, PedalCar
from slipangle.models.wrappers.hybrid import Corrected, HybridModel
from slipangle.report.plots import rainclouds, trajectories
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_8 import SEEDS, correlations, on_the_track, quietly, switched_off

FAST = 202.0  # s
SHARES = (0.5, 0.55, 0.6, 0.65, 0.7)
FREE = ("power", "k_b", "k_r", "drag", "scrub")
START = DrivelineParams(mass=790.0, k_e=30000.0, k_b=1.7e-3, power=2e5, drag=0.4, k_r=0.15)
RESTART = 10.0  # s
PEDALS = ("throttle", "brake")
PRINTED = {
    "M2": (65.49, 90.01),
    "M2-H": (76.91, 95.13),
    "M3": (67.97, 91.81),
    "M3-H": (75.30, 93.91),
    "M4": (75.66, 95.72),
    "M4-H": (87.52, 98.89),
}


def fast_part(inputs: tuple[str, ...] = ("throttle", "brake", "delta"), outputs: tuple[str, ...] = ("v_x",)) -> Dataset:
    """The laps from 202 s on."""
    data = public("iac-putnam").select(inputs=inputs, outputs=outputs)
    return data.rows(int(np.searchsorted(data.t, FAST)), data.n_samples)


def longitudinal(train: Dataset) -> PedalCar:
    """M2 with engine power, brakes, drag, rolling resistance and the drag of cornering."""
    start = PedalCar(params=START, dt=train.dt, substeps=2)
    return quietly(GreyBox(start=start, free=FREE, max_iterations=25), restarted(train, RESTART, start.memory))


def state_space(train: Dataset) -> StateSpaceModel:
    """M3, second order."""
    settings = StateSpace(order=2, focus="prediction", offsets="both", max_radius=0.9999)
    return quietly(settings, train.select(inputs=PEDALS))


def black_box(train: Dataset, seed: int) -> NARXModel:
    """M4."""
    return quietly(replace(SOUSA_TABLE_8_3, seeds=(seed,)), train.select(inputs=PEDALS))


def hybrid(base: Model, train: Dataset) -> HybridModel:
    """A hybrid that is strict about whether its discrepancy helps."""
    return quietly(Hybrid(base=base, discrepancy=SOUSA_TABLE_8_3_DISCREPANCY, folds=3, worth=0.1), train)


def reproduce(progress: Progress) -> Reproduction:
    """M2 and M2-H on every rolling split, M3 and M4 and their hybrids on the last."""
    data = fast_part()
    judged: list[tuple[Model, HybridModel, Score, Score]] = []
    train = test = data
    for i, share in enumerate(SHARES):
        progress(0.6 * i / len(SHARES), f"M2 and M2-H, fitted to the first {100 * share:g} %")
        a, b = round(share * data.n_samples), round((share + 0.3) * data.n_samples)
        train, test = data.rows(0, a), data.rows(a, b)
        base = longitudinal(train)
        mixed = hybrid(base, train)
        judged.append((base, mixed, score(base.simulate(test), "v_x"), score(mixed.simulate(test), "v_x")))
    models: dict[str, list[Model]] = {"M2": [judged[-1][0]], "M2-H": [judged[-1][1]]}
    progress(0.6, "M3 and M3-H")
    models["M3"] = [state_space(train)]
    models["M3-H"] = [hybrid(models["M3"][0], train)]
    models["M4"], models["M4-H"] = [], []
    for seed in SEEDS:
        progress(0.65 + 0.35 * seed / len(SEEDS), f"M4 and M4-H, seed {seed}")
        models["M4"].append(black_box(train, seed))
        models["M4-H"].append(hybrid(models["M4"][-1], train))
    figures = along_the_track({name: fitted[0] for name, fitted in models.items()}, test)
    records = [*rolling(judged), *(r for name, fitted in models.items() for r in last_part(name, fitted, test))]
    return Reproduction.told(__doc__, records, list(figures.values()), list(figures))


def rolling(judged: Sequence[tuple[Model, HybridModel, Score, Score]]) -> list[Record]:
    """M2 and M2-H over all splits."""
    fits, hybrids = [plain.fit for _, _, plain, _ in judged], [mixed.fit for _, _, _, mixed in judged]
    gains = ", ".join("off" if mixed.gain == 0 else "on" for _, mixed, _, _ in judged)
    change = min(h - f for h, f in zip(hybrids, fits, strict=True))
    note = ", ".join(f"{100 * s:g} %: {f:.1f}" for s, f in zip(SHARES, fits, strict=True))
    what, middle = "smallest change of fit against M2 [%]", float(np.median(fits))
    return [
        Record.judged("M2, five rolling splits", "fit of v_x [%], median", None, middle, at_least=75, note=note),
        Record("M2-H, five rolling splits", what, None, change, ">= 0", change >= -1e-6, f"discrepancy {gains}"),
    ]


def last_part(name: str, models: Sequence[Model], test: Dataset) -> list[Record]:
    """Fit and VAF over the last 30 %; medians over seeds."""
    scores = [score(model.simulate(test), "v_x") for model in models]
    fit, vaf = (float(np.median([getattr(s, what) for s in scores])) for what in ("fit", "vaf"))
    least = 80.0 if name == "M2" else None
    every = ", ".join(f"{seed}: {s.fit:.1f}" for seed, s in zip(SEEDS, scores, strict=False))
    car = "another car, see the protocol" if name == "M2" else ""
    notes = (car, f"seeds {every}" if scores[1:] else "", switched_off(models))
    row, note = f"{name}, last 30 %", "; ".join(filter(None, notes))
    return [
        Record.judged(row, "fit of v_x [%]", PRINTED[name][0], fit, at_least=least, note=note),
        Record(row, "VAF of v_x [%]", PRINTED[name][1], vaf),
    ]


def along_the_track(models: Mapping[str, Model], test: Dataset) -> dict[str, Any]:
    """Free runs, errors, correlation; errors and shares of the discrepancies on the map (figures 8.7 to 8.9)."""
    channel = test.channels[test.index("v_x")]
    shown = [name for name, model in models.items() if not (isinstance(model, Corrected) and model.gain == 0)]
    runs = {name: model.simulate(test) for name, model in models.items()}
    errors = {name: np.where(run.predicted, run.error[:, 0], np.nan) for name, run in runs.items()}
    figures: dict[str, Any] = {
        "Free run over the last 30 %": trajectories({name: runs[name] for name in ("M2", "M3", "M4")}, channel),
        "Errors": rainclouds({name: errors[name][np.isfinite(errors[name])] for name in shown}, channel=channel),
    }
    figures |= correlations({name: runs[name] for name in shown}, channel)
    for name in shown:
        figures |= on_the_track(name, models[name], errors[name], test)
    return figures
