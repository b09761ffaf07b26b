"""Table 4.2: NARX of the simulated system of Narendra and Parthasarathy (example 2, appendix A.2).

Data: training on 800 samples of random signs held for 4 samples, each window times a number drawn from [0, 1]; test
on the 800 samples of sines of eq. A-3. No noise. The true lags, na = 3 and nb = 2; three hidden layers of 50 ELU
neurons, Adam at 1e-3. The thesis gives neither seed nor number of epochs: here five seeds, each drawing its own
training input and its own start weights, every one listed; 4000 epochs at most, of which the free run over the last
15 % of the training data chooses one. The loss looks one step ahead: without noise a longer horizon has nothing to add.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from slipangle import NARX, Channel, Validation, validate
from slipangle.identify.judge.validate import Score
from slipangle.identify.networks.presets import SOUSA_TABLE_4_2
from slipangle.report.plots import rainclouds, trajectories
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce.plants import narendra

SEEDS = (0, 1, 2, 3, 4)
PRINTED = {  # RMSE and R2: estimation, validation
    "OSA": ((0.0489, 0.9765), (0.0541, 0.9648)),
    "FR": ((0.0513, 0.9720), (0.0481, 0.9791)),
}
MEDIAN_BOUND, BEST_BOUND = 0.030, 0.024


def settings(seed: int) -> NARX:
    """Estimator of the table, one training run."""
    return replace(SOUSA_TABLE_4_2, seeds=(seed,))


def reproduce(progress: Progress) -> Reproduction:
    """Train and judge one network per seed."""
    test = narendra.validation()
    judged: list[tuple[Validation, Validation]] = []
    seconds: list[float] = []
    for i, seed in enumerate(SEEDS):
        train = narendra.estimation(seed=seed)
        model = settings(seed).fit(train, progress=_part(progress, i / len(SEEDS), 1 / len(SEEDS), seed))
        info = model.fit_info
        seconds.append(info.seconds if info else float("nan"))
        judged.append((validate(model, train, on_training_data=True), validate(model, test, name=f"NARX, seed {seed}")))
    free = [_score(validation, "FR").rmse for _, validation in judged]
    records = [record for kind in PRINTED for which in (0, 1) for record in _records(kind, which, judged)]
    note, time = "seeds " + ", ".join(f"{s}: {e:.4f}" for s, e in zip(SEEDS, free, strict=True)), np.median(seconds)
    row, first = "table 4.2, FR, validation, best seed", f"the first one took {seconds[0]:.1f} s with compiling"
    records += [
        Record.judged(row, "RMSE [-]", PRINTED["FR"][1][0], min(free), at_most=BEST_BOUND, note=note),
        Record("table 4.2, training", "time per network [s], median", None, float(time), note=first),
    ]
    middle = judged[int(np.argsort(free)[len(free) // 2])][1]
    runs = {"free run": middle.free_run, "one-step-ahead": middle.one_step}
    channel = Channel("y", "-")
    errors = {n: r.error[r.predicted, 0] for n, r in runs.items()}
    return Reproduction.told(__doc__, records, [trajectories(runs, channel), rainclouds(errors, channel=channel)])


def _records(kind: str, which: int, judged: list[tuple[Validation, Validation]]) -> tuple[Record, Record]:
    """RMSE and R2 of one row and phase, medians over the seeds."""
    scores = [_score(pair[which], kind) for pair in judged]
    row = f"table 4.2, {kind}, {('estimation', 'validation')[which]}"
    rmse, r2 = float(np.median([s.rmse for s in scores])), float(np.median([s.r2 for s in scores]))
    printed = PRINTED[kind][which]
    limit = MEDIAN_BOUND if (kind, which) == ("FR", 1) else printed[0]
    return (
        Record.judged(row, "RMSE [-], median of 5 seeds", printed[0], rmse, at_most=limit),
        Record.judged(row, "R2 [-], median of 5 seeds", printed[1], r2, at_least=printed[1]),
    )


def _score(validation: Validation, kind: str) -> Score:
    return (validation.free_run_scores if kind == "FR" else validation.one_step_scores)["y"]


def _part(progress: Progress, start: float, share: float, seed: int) -> Callable[[float, str], None]:
    return lambda done, what: progress(start + share * done, f"network with seed {seed}")
