"""Table 8.4: second-order state space of pedal and steering to speed and yaw rate, means removed, normalised.

The thesis prints A, B and C for the Ferrari; its log here has no pedals, so ours is the Dallara AV-21 at Putnam Park,
fast part from 202 s, resampled to 20 Hz, first 70 % to fit, one free run over the rest. Matrices of a state space
depend on the basis of its state and are not compared; poles do not. The thesis' own poles follow from its printed A.
Subspace, then refinement of the free run with poles held within 0.999: unconstrained, it drifts to an integrator.
"""

import numpy as np

from slipangle import Dataset, StateSpace
from slipangle.identify.judge.validate import score
from slipangle.models.black_box.statespace import StateSpaceModel
from slipangle.report.plots import trajectories
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_8 import quietly
from slipangle.reproduce.table_8_3 import fast_part

PRINTED_A = np.array([[0.282, 0.132], [-0.003, 0.995]])
LARGEST = 0.999


def normalised() -> tuple[Dataset, Dataset]:
    """Training and test part; means and deviations are the training part's."""
    data = fast_part(("pedal", "delta"), ("v_x", "r")).resample(0.05, cutoff=8.0)
    train, test = data.split(0.7)
    size = {name: (float(train[name].mean()), float(train[name].std())) for name in (*data.inputs, *data.outputs)}
    for name, (mean, deviation) in size.items():
        train = train.with_channel(name, (train[name] - mean) / deviation)
        test = test.with_channel(name, (test[name] - mean) / deviation)
    return train, test


def reproduce(progress: Progress) -> Reproduction:
    """Poles and free run of the second-order model."""
    progress(0.0, "reading the log")
    train, test = normalised()
    progress(0.3, "subspace, then prediction error")
    model: StateSpaceModel = quietly(StateSpace(order=2, focus="simulation", max_radius=LARGEST), train)
    run = model.simulate(test)
    ours, printed = np.sort(np.abs(model.poles)), np.sort(np.abs(np.linalg.eigvals(PRINTED_A)))
    records = []
    for which, theirs, here in zip(("fast", "slow"), printed, ours, strict=True):
        bound, holds = f"<= {LARGEST:g}", bool(here <= LARGEST + 1e-9)
        note = "thesis: from its printed A"
        records.append(Record(f"{which} pole", "modulus [-]", float(theirs), float(here), bound, holds, note))
    for name in ("v_x", "r"):
        records.append(Record("free run", f"fit of {name} [%]", None, score(run, name).fit, note="another car"))
    matrices = "; ".join(f"{n} = {np.round(getattr(model, n), 4).tolist()}" for n in ("A", "B", "C"))
    figures = [trajectories({"M3": run}, test.channels[test.index(name)]) for name in ("v_x", "r")]
    return Reproduction.told(__doc__, records, figures, more=f"{matrices}.")
