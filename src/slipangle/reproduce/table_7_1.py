"""Table 7.1: ARX models from steering to lateral position at 10, 15 and 20 m/s, and the search of orders and shares.

Plant: dual-track car of table 7.2, Magic Formula tires, scheduled-PI speed driver. Steering: sine of pi/2 rad/s with
amplitudes 0.15, 0.08, 0.05 rad, ten periods, logged at 100 Hz, resampled to the controller's 0.05 s. The first share of
the log trains, the rest validates in one free run from its first samples. Orders 2 to 4 and 1 to 3 and shares of 10 to
50 % are tried, each with plain least squares and with two poles at 1, which a lateral position has. The model with the
fewest coefficients is chosen among those with a validation R2 of at least 0.9999; the best RMSE decides between equals.
One sine says little about other steering: the chosen model also runs freely over a second log with 0.7 times the
amplitude, which no fit and no choice has seen. The thesis' coefficients belong to its own plant.
"""

import warnings
from typing import NamedTuple

from slipangle import ARX, ARXModel, Dataset
from slipangle.errors import ModelWarning, SlipangleError
from slipangle.identify.judge.validate import Score, score
from slipangle.identify.linear.integrated import IntegratedARX
from slipangle.report.plots import trajectories
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_7 import AMPLITUDES, DRIVER, LOG, PLANT, SPEEDS, STEP, sine_log
from slipangle.simulate.manoeuvres import record, sine_steer

PRINTED = {10.0: (0.9998, 0.638), 15.0: (0.999, 0.959), 20.0: (0.994, 1.231)}  # validation R2 and RMSE [m]
SHARES = (0.10, 0.15, 0.20, 0.30, 0.40, 0.50)


class LagTrial(NamedTuple):
    """One fit of the search."""

    model: ARXModel
    share: float
    kind: str
    train: Score
    validation: Score


def search(data: Dataset) -> list[LagTrial]:
    """Every fit whose free run stays finite, the best validation RMSE first."""
    trials = []
    for share in SHARES:
        train, validation = data.split(share)
        for na in (2, 3, 4):
            for nb in (1, 2, 3):
                for kind, estimator in (("plain", ARX(na=na, nb=nb)), ("two poles at 1", IntegratedARX(na=na, nb=nb))):
                    try:
                        with warnings.catch_warnings():
                            warnings.simplefilter("ignore", ModelWarning)  # those that drift away rank last
                            model = estimator.fit(train)
                            scores = [score(model.simulate(part), "Y") for part in (train, validation)]
                    except SlipangleError:  # too little data for the order, or an unstable free run
                        continue
                    trials.append(LagTrial(model, share, kind, *scores))
    return sorted(trials, key=lambda f: f.validation.rmse)


def choose(found: list[LagTrial]) -> LagTrial:
    """The simplest good fit."""
    good = [f for f in found if f.validation.r2 >= 0.9999] or found[:1]
    return min(good, key=lambda f: (f.model.na + f.model.nb, f.validation.rmse))


def second_log(v_x: float) -> Dataset:
    """A log of smaller steering that no fit and no choice has seen."""
    manoeuvre = sine_steer(v_x, 0.7 * AMPLITUDES[v_x], 0.25, periods=6.0, dt=LOG)
    return record(PLANT, manoeuvre, DRIVER, channels=("Y",)).resample(STEP).select(inputs=("delta",), outputs=("Y",))


def reproduce(progress: Progress) -> Reproduction:
    """Search at each speed."""
    records, figures = [], []
    for k, v in enumerate(SPEEDS):
        progress(k / len(SPEEDS), f"{v:g} m/s")
        data = sine_log(v)
        trials = search(data)
        best, plain = choose(trials), next(f for f in trials if f.kind == "plain")
        r2, rmse = PRINTED[v]
        row, train = f"{v:g} m/s", f"na = {best.model.na}, nb = {best.model.nb}, {best.share:.0%} training"
        note = f"{train}, {best.kind}; {len(trials)} fits"
        unseen = score(best.model.simulate(second_log(v)), "Y")
        A, B = (", ".join(f"{c:.4f}" for c in matrix.ravel()) for matrix in (best.model.A, best.model.B))
        here, plain_here = best.validation, plain.validation
        plainly = f"na = {plain.model.na}, nb = {plain.model.nb}, {plain.share:.0%} training"
        name = "validation RMSE [m]"
        records += [
            Record.judged(row, "validation R2 [-]", r2, here.r2, at_least=0.998, note=note),
            Record.judged(row, name, rmse, here.rmse, at_most=rmse, note=f"A: {A}; B: {B}"),
            Record(row, "R2 on the second log [-]", None, unseen.r2),
            Record.judged(f"{row}, plain least squares", name, rmse, plain_here.rmse, at_most=rmse, note=plainly),
        ]
        _, validation = data.split(best.share)
        channel = next(c for c in data.channels if c.name == "Y")
        figures.append(trajectories({f"ARX at {v:g} m/s": best.model.simulate(validation)}, channel))
    return Reproduction.told(__doc__, records, figures, [f"Validation at {v:g} m/s" for v in PRINTED])
