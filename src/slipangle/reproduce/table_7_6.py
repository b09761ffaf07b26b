"""Table 7.6: solver times of LMPC, NMPC and MARX-MPC on the three segments.

The table is missing in our copy of the thesis; its text states reductions of up to 63 % (in another place 75 %) against
LMPC and 88 % against NMPC. Drives as in table 7.5. Two comparisons: the thesis' own way, Ipopt for all three (multiple
shooting; CVODES inside for LMPC and NMPC, the models side by side for MARX), on moments of the drives in every segment,
warm started, process time; and our real-time solvers, time inside the compiled code over the whole drive, the
shortest of three repetitions of each plan, since the plant has emptied the caches before the first.
"""

import time
from typing import Any

import numpy as np

from slipangle import MPC, Ipopt, Reference, Run, Weights
from slipangle.control.presets import SOUSA_TABLE_7_3
from slipangle.models.wrappers.multi_arx import ParallelARX, SpeedBlend
from slipangle.report.drives import solver_histogram
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce import _chapter_7 as chapter
from slipangle.reproduce._cvodes import ByCvodes
from slipangle.reproduce.table_7_5 import BEST, DRAWN, Driven, drives, thesis_model

MOMENTS, STEPS = 2, 4  # in each segment; of each, after a first one that is not warm


def reproduce(progress: Progress) -> Reproduction:
    """The thesis' way, then ours."""
    done = drives(lambda share, what: progress(0.6 * share, what))
    progress(0.6, "Ipopt for all three")
    old = {name: thesis_way(name, done) for name in ("LMPC", "NMPC", "MARX")}
    records = []
    for name, times in old.items():
        printed, note = (10.0, "about 0.01 s on the thesis' laptop") if name == "MARX" else (None, "")
        for s, seconds in times.items():
            what = f"time of a plan, {s} [ms], median"
            records.append(Record(f"{name}, Ipopt", what, printed, 1e3 * seconds, note=note))
    for other, least in (("LMPC", 63.0), ("NMPC", 88.0)):
        saved = {s: 100 * (1 - old["MARX"][s] / old[other][s]) for s in chapter.SEGMENTS}
        note = ", ".join(f"{s}: {share:.1f} %" for s, share in saved.items())
        row, what = f"MARX against {other}, Ipopt", "reduction of the time, largest of the segments [%]"
        records.append(Record.judged(row, what, f"up to {least:g}", max(saved.values()), at_least=least, note=note))
    median = {}
    for name, d in done.items():
        for s in chapter.SEGMENTS:
            times = chapter.segment_seconds(d.run, s, d.inside)
            median[name, s] = float(np.median(times))
            note = f"p99 {1e6 * float(np.percentile(times, 99)):.1f} us"
            what = f"time of a plan, {s} [us], median"
            records.append(Record(f"{name}, compiled", what, None, 1e6 * median[name, s], note=note))
    note = "while its error is smaller, see table 7.5"
    for other in ("LMPC", "NMPC"):
        ratio = min(median[other, s] / median[BEST, s] for s in chapter.SEGMENTS)
        row = f"{BEST} against {other}, compiled"
        what = "times faster, least of the segments [-]"
        records.append(Record.judged(row, what, None, ratio, at_least=1.5, note=note))
    figures = [solver_histogram(done[name].inside, deadline=chapter.STEP) for name in DRAWN]
    return Reproduction.told(__doc__, records, figures, [f"{name}: solver time" for name in DRAWN])


def thesis_way(name: str, done: dict[str, Driven]) -> dict[str, float]:
    """Median process time of a plan by Ipopt in each segment. [s]"""
    run = done["LMPC" if name == "LMPC" else "NMPC" if name == "NMPC" else "MARX as in the thesis"].run
    solver, side = Ipopt(tolerance=1e-6), thesis_model()
    if name == "MARX":
        model = ParallelARX(models=side.models, speeds=chapter.SPEEDS)
        settings: dict[str, Any] = SOUSA_TABLE_7_3 | {"Q": Weights(Y=SOUSA_TABLE_7_3["Q"]["e_y"])}
        controller = MPC(model, solver=solver, controls=("delta",), **settings)
    else:
        controller = chapter.general(
            ByCvodes(chapter.linear_model() if name == "LMPC" else chapter.magic_model()), solver
        )
    times = {}
    for s, (low, high) in chapter.SEGMENTS.items():
        X = np.interp(run.t_plan, run.t, run["X"])
        inside = np.flatnonzero((X >= low) & (X < min(high, 860.0)))
        spent = []
        for k in np.linspace(inside[20], inside[-1] - STEPS - 2, MOMENTS).astype(int):
            plan = None
            for i in range(k, k + STEPS + 1):
                x, reference = _moment(run, i, controller)
                before = run.commands[i - 1]
                began = time.process_time()
                plan = controller.plan(x, reference, plan, applied=before)
                if i > k:
                    spent.append(time.process_time() - began)
        times[s] = float(np.median(spent))
    return times


def _moment(run: Run, k: int, controller: MPC) -> tuple[np.ndarray, Reference]:
    """State and reference of a plan of the drive."""
    i = round(run.t_plan[k] / (run.t[1] - run.t[0]))
    look = chapter.the_path().ahead(float(run.s[i]), chapter.HORIZON, chapter.STEP, v_x=float(run.v_x[i]))
    if isinstance(controller.model, SpeedBlend):
        each = round(chapter.STEP / (run.t[1] - run.t[0]))
        lags = [float(run["Y"][i - each * j]) for j in range(controller.model.na)]
        past = [float(run.commands[k - j, 0]) for j in range(1, controller.model.reach)]
        x = np.array(lags * len(chapter.SPEEDS) + past)
        return x, Reference(tracked=look.Y[:, None], exogenous=look.v_x[:-1, None])
    state: Any = [run[n][i] for n in chapter.Lateral.states]
    return np.array(state), controller.reference(look)
