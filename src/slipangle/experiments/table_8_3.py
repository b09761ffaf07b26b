"""Table 8.3: speed from pedals, M2 and its hybrid M2-H, free runs.

The copy of the Ferrari's data lacks throttle and brake, so the log is another: Dallara AV-21 at Putnam Park, 25 Hz,
with both pedals. Its fast part starts at 202 s. Five rolling splits: fit to the first 50, 55, ..., 70 % of the fast
part, one free run over the 30 % that follow; the last of them is the last 30 %. M2 is fitted to runs restarted every
10 s, so that slow drift (the road's slope is not measured) does not dominate. Whether the discrepancy stays on is
decided inside each split's training part. Nothing is comparable with the thesis' car and speeds but the kind of task.
"""

from __future__ import annotations

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.data.public import load
from slipangle.experiments import Progress, Reproduction
from slipangle.experiments._chapter_8 import quietly
from slipangle.identify.greybox import GreyBox
from slipangle.identify.hybrid import Hybrid
from slipangle.identify.narx import NARX
from slipangle.identify.training import Stage
from slipangle.identify.validate import Score, restarted, score
from slipangle.models.hybrid import HybridModel
from slipangle.models.longitudinal import DrivelineParams, PedalCar
from slipangle.models.model import Model
from slipangle.report.plots import trajectories
from slipangle.report.tables import Record

FAST = 202.0  # s
SHARES = (0.5, 0.55, 0.6, 0.65, 0.7)
FREE = ("power", "k_b", "k_r", "drag", "scrub")
START = DrivelineParams(mass=790.0, k_e=30000.0, k_b=1.7e-3, power=2e5, drag=0.4, k_r=0.15)
RESTART = 10.0  # s
DISCREPANCY = NARX(
    na=3,
    nb=5,
    hidden=(12,),
    activation="tanh",
    stages=(Stage(horizon=1, epochs=100, learning_rate=3e-3), Stage(horizon=60, epochs=150, learning_rate=3e-3)),
)


def fast_part() -> Dataset:
    """The laps from 202 s on; inputs throttle, brake, delta, output v_x."""
    data = load("iac-putnam").select(inputs=("throttle", "brake", "delta"), outputs=("v_x",))
    return data.rows(int(np.searchsorted(data.t, FAST)), data.n_samples)


def longitudinal(train: Dataset) -> PedalCar:
    """M2 with engine power, brakes, drag, rolling resistance and the drag of cornering."""
    start = PedalCar(params=START, dt=train.dt, substeps=2)
    return quietly(GreyBox(start=start, free=FREE, max_iterations=25), restarted(train, RESTART, start.memory))


def hybrid(base: PedalCar, train: Dataset) -> HybridModel:
    """M2-H; strict about whether the discrepancy helps."""
    return quietly(Hybrid(base=base, discrepancy=DISCREPANCY, folds=3, worth=0.1), train)


def reproduce(progress: Progress) -> Reproduction:
    """M2 and M2-H on every rolling split."""
    data = fast_part()
    judged: list[tuple[Model, HybridModel, Score, Score, Dataset]] = []
    for i, share in enumerate(SHARES):
        progress(i / len(SHARES), f"fitted to the first {100 * share:g} %")
        a, b = round(share * data.n_samples), round((share + 0.3) * data.n_samples)
        train, test = data.rows(0, a), data.rows(a, b)
        base = longitudinal(train)
        mixed = hybrid(base, train)
        scores = [score(model.simulate(test), "v_x") for model in (base, mixed)]
        judged.append((base, mixed, scores[0], scores[1], test))
    progress(1.0, "done")
    fits = [plain.fit for _, _, plain, _, _ in judged]
    hybrids = [mixed.fit for _, _, _, mixed, _ in judged]
    gains = ", ".join("off" if mixed.gain == 0 else "on" for _, mixed, _, _, _ in judged)
    change = min(h - f for h, f in zip(hybrids, fits, strict=True))
    base, mixed, last, last_mixed, test = judged[-1]
    every = ", ".join(f"{100 * s:g} %: {f:.1f}" for s, f in zip(SHARES, fits, strict=True))
    return Reproduction(
        title="Table 8.3: longitudinal models, speed from pedals",
        records=(
            Record(
                row="M2, last 30 %",
                quantity="fit of v_x [%]",
                thesis=65.49,
                here=last.fit,
                bound=">= 80",
                holds=last.fit >= 80,
                note="another car, see the protocol",
            ),
            Record(row="M2, last 30 %", quantity="VAF of v_x [%]", thesis=90.01, here=last.vaf),
            Record(
                row="M2, five rolling splits",
                quantity="fit of v_x [%], median",
                thesis=None,
                here=float(np.median(fits)),
                bound=">= 75",
                holds=float(np.median(fits)) >= 75,
                note=every,
            ),
            Record(row="M2-H, last 30 %", quantity="fit of v_x [%]", thesis=76.91, here=last_mixed.fit),
            Record(row="M2-H, last 30 %", quantity="VAF of v_x [%]", thesis=95.13, here=last_mixed.vaf),
            Record(
                row="M2-H, five rolling splits",
                quantity="smallest change of fit against M2 [%]",
                thesis=None,
                here=change,
                bound=">= 0",
                holds=change >= -1e-6,
                note=f"discrepancy {gains}",
            ),
        ),
        protocol="Dallara AV-21 at Putnam Park, 25 Hz, from 202 s: fit to the first 50 to 70 %, one free run over the "
        "30 % that follow, initial speed measured. The Ferrari's copy has no pedals.",
        figures=(
            trajectories({"M2": base.simulate(test), "M2-H": mixed.simulate(test)}, test.channels[test.index("v_x")]),
        ),
    )
