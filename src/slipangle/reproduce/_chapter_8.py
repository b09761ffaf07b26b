"""What the tables of chapter 8 share: the Ferrari run with its channels, settings of every model, records.

Protocol: Ferrari 250 LM, Targa Sixty-Six 2014 (Revs Program at Stanford), 550 s at 100 Hz; steering despiked,
zero-phase low-pass at 8 Hz, 20 Hz. First 70 % to fit, one free run over the last 165 s; the measured output (and, for
the bicycles, v_y) is used at the first samples only, as many as the model needs.

Width, epochs and inputs of the discrepancies, width and priors of the bicycle with a network inside, and how long a
linear model's modes may last were chosen on the training part: fitted to its first 70 %, judged by free runs over its
rest, two or three seeds. What owes something to the test part or the other session is named in `table_8_2`.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import plotly.graph_objects as go

from slipangle.data.dataset import Channel, Dataset, join
from slipangle.data.public.sets import ferrari_250lm, public
from slipangle.errors import IdentifiabilityWarning, ModelWarning
from slipangle.identify.judge.compare import Estimator
from slipangle.identify.judge.initial import restarted
from slipangle.identify.judge.validate import Score, score
from slipangle.identify.networks.joint import Joint
from slipangle.identify.networks.narx import NARX
from slipangle.identify.networks.narx_free_run import FreeRunNARX
from slipangle.identify.networks.presets import SOUSA_TABLE_8_2, SOUSA_TABLE_8_2_FREE_RUN
from slipangle.identify.networks.problem import Stage
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.model import Model, Trajectory
from slipangle.models.vehicles.bicycle import Bicycle
from slipangle.models.vehicles.catalogue import FERRARI_250LM
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams, with_speed_derivative
from slipangle.models.wrappers.hybrid import Corrected
from slipangle.report.maps import track_map
from slipangle.report.plots import correlation
from slipangle.report.race import share_map
from slipangle.report.records import Record

SEEDS = (0, 1, 2, 3, 4)
LAGGED = ("delta", "v_x", "v_x_dot")
PRODUCT = ("delta", "v_x", "delta_v_x")
STAGES = SOUSA_TABLE_8_2.stages
FREE = (
    *("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_lag", "steering_offset", "bias_r"),
    *("l_f", "transfer_x", "friction_load", "stiffness_load"),
)
START = NonlinearBicycleParams(mass=982.0, inertia_z=900.0, wheelbase=2.4, l_f=1.35, C_f=6e4, C_r=9e4)
WINDOW = 28.0  # s; what the thesis' RMSE column suggests for the length of its test part
RESTART = 10.0  # s


def channels(data: Dataset) -> Dataset:
    """The data with the channels that the models of chapter 8 take; pieces below one second are left out."""
    data = with_speed_derivative(data)
    data = data.with_channel("delta_v_x", data["delta"] * data["v_x"], "rad m/s").select(inputs=LAGGED, outputs=("r",))
    long = [part for part in data.experiments if part.duration > 1.0]
    return data if len(long) == len(data.experiments) else join(*long, name=data.name)


def ferrari() -> tuple[Dataset, Dataset]:
    """Training and test part."""
    return channels(ferrari_250lm()).split(0.7)


def session() -> Dataset:
    """Another session of the same car, 20 Hz."""
    return channels(public("ferrari-250lm-session"))


def narx(seed: int, stages: Sequence[Stage] = STAGES) -> NARX:
    """Settings of the discrepancies."""
    return replace(SOUSA_TABLE_8_2, stages=tuple(stages), seeds=(seed,))


def free_run_narx(seed: int) -> FreeRunNARX:
    """Settings of M4: a small network, Adam on windows, then Gauss-Newton on the free run."""
    preset = SOUSA_TABLE_8_2_FREE_RUN
    return replace(preset, start=replace(preset.start, seeds=(seed,)))


def joint(base: NonlinearBicycle, seeds: Sequence[int]) -> Joint:
    """Settings of the bicycle with a network on its state derivative, v_y fitted along."""
    return Joint(start=base, hidden=(24,), also=("v_y",), seeds=tuple(seeds))


def bicycle(train: Dataset, free: tuple[str, ...]) -> Bicycle:
    """M1 as in the thesis."""
    return quietly(GreyBox(start=Bicycle(params=FERRARI_250LM, dt=train.dt), free=free), train)


def at_the_limit(params: NonlinearBicycleParams, dt: float) -> NonlinearBicycle:
    """The bicycle with Magic Formula axles, steps short enough for its steering lag."""
    return NonlinearBicycle(params=params, dt=dt, substeps=3)


def nonlinear_bicycle(train: Dataset) -> NonlinearBicycle:
    """M1 with Magic Formula axles and load transfer, twelve free parameters, from many starts."""
    return quietly(GreyBox(start=at_the_limit(START, train.dt), free=FREE), train)


def quietly(estimator: Estimator, data: Dataset) -> Any:
    """``estimator.fit(data)`` without the warnings that every seed's row shows anyway."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        return estimator.fit(data)


def correlations(runs: Mapping[str, Trajectory], channel: Channel) -> dict[str, go.Figure]:
    """Simulated over measured output of every model, on the same axes (figures 8.5 and 8.8)."""
    both = np.concatenate([np.concatenate([run.measured, run.y])[:, 0] for run in runs.values()])
    limits = float(both.min()), float(both.max())
    return {
        f"Simulated over measured, {name}": correlation(
            run.measured[run.predicted, 0], run.y[run.predicted, 0], channel=channel, limits=limits, index=i
        )
        for i, (name, run) in enumerate(runs.items())
    }


def on_the_track(name: str, model: Model, error: np.ndarray, test: Dataset) -> dict[str, go.Figure]:
    """Error of the output along the track, and the share of the discrepancy where the model has one."""
    X, Y, channel = test["X"], test["Y"], test.channels[test.index(test.outputs[0])]
    figures = {f"Error along the track, {name}": track_map(X, Y, error, channel=channel, starts=test.starts)}
    if isinstance(model, Corrected):
        share = share_map(X, Y, model.share(test)[:, 0], starts=test.starts)
        figures[f"Share of the discrepancy, {name}"] = share
    return figures


def switched_off(models: Sequence[Model]) -> str:
    """A note on how many hybrids' discrepancies did not help and switched themselves off; empty where none did."""
    off = sum(isinstance(model, Corrected) and model.gain == 0 for model in models)
    if not off:
        return ""
    return "discrepancy off" if off == len(models) else f"discrepancy off for {off} of {len(models)} seeds"


# ---- judging -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Judged:
    """One model on the test part.

    The score of one free run over all of it; the fit of free runs that start anew every 10 s, and of the one free run
    over each window of 28 s, shape (n_windows,) [%]; time of the fit, of the process and by the clock [s].
    """

    free: Score
    restarted: float
    windows: np.ndarray
    seconds: float
    wall: float


class Timer:
    """Process and wall time since it was made. [s]"""

    def __init__(self) -> None:
        self._began = time.process_time(), time.perf_counter()

    def read(self, runs: int = 1) -> tuple[float, float]:
        """Process and wall time of each of ``runs``."""
        process, wall = self._began
        return (time.process_time() - process) / runs, (time.perf_counter() - wall) / runs


def judge(model: Model, test: Dataset, spent: tuple[float, float] = (float("nan"), float("nan"))) -> Judged:
    """Free run over the whole test part, restarts beside it, scatter of windows; ``spent`` as of `Timer`."""
    run = model.simulate(test)
    output = model.outputs[0]
    n = round(WINDOW / test.dt)
    windows = []
    for a in range(model.memory, test.n_samples - n + 1, n):
        inside = np.zeros(test.n_samples, dtype=bool)
        inside[a : a + n] = True
        windows.append(score(replace(run, predicted=run.predicted & inside), output).fit)
    anew = score(model.simulate(restarted(test, RESTART, model.memory)), output).fit
    seconds, wall = spent
    return Judged(free=score(run, output), restarted=anew, windows=np.array(windows), seconds=seconds, wall=wall)


def median_error(values: np.ndarray) -> float:
    """Standard error of the median of few normal values (1.25 times that of the mean); 0 for a single one.

    Source: M. G. Kendall, A. Stuart, The Advanced Theory of Statistics, vol. 1, 1977, sec. 10.
    """
    n = len(values)
    return float(np.sqrt(np.pi / 2 / n) * np.std(values, ddof=1)) if n > 1 else 0.0


def records(
    row: str,
    verdicts: Sequence[Judged],
    *,
    printed: tuple[float, float] | None,
    fit: float | None,
    vaf: float | None = None,
    unit: str = "r",
    slowest: float | None = None,
    apart_at_most: float | None = None,
    seeds: Sequence[int] = (),
    note: str = "",
) -> list[Record]:
    """Fit, VAF, distance of the restarts and time of one row; medians where there are seeds.

    A median of seeds may fall below its bound by two of its standard errors: other seeds, or last bits that lead them
    elsewhere, give other medians.
    """
    each = ", ".join(f"{s}: {v.free.fit:.2f}" for s, v in zip(seeds, verdicts, strict=True)) if seeds else ""
    every = f"seeds {each}" if seeds else ""
    scatter = np.concatenate([v.windows for v in verdicts])
    windows = f"{WINDOW:g} s windows {scatter.min():.1f} to {scatter.max():.1f}"
    made = []
    for i, (name, least) in enumerate((("fit", fit), ("vaf", vaf))):
        values = np.array([getattr(v.free, name) for v in verdicts])
        here, error = float(np.median(values)), median_error(values)
        width = f" - {2 * error:.2g}" if error > 0 else ""
        bound, holds = ("", None) if least is None else (f">= {least:g}{width}", here >= least - 2 * error)
        said = "" if i else "; ".join(filter(None, (every, windows, note)))
        quantity = f"{'VAF' if i else 'fit'} of {unit} [%]"
        made.append(Record(row, quantity, printed[i] if printed else None, here, bound, holds, said))
    apart = max((v.restarted - v.free.fit for v in verdicts), key=abs)
    most = apart_at_most
    bound, holds = ("", None) if most is None else (f"within {most:g}", abs(apart) <= most)
    said = "the largest of all seeds" if seeds else ""
    made.append(Record(row, f"restarts every {RESTART:g} s, change of fit [%]", None, apart, bound, holds, said))
    seconds, wall = (float(np.median([getattr(v, name) for v in verdicts])) for name in ("seconds", "wall"))
    if np.isfinite(seconds):
        said = f"{wall:.3g} s by the clock of a shared machine"
        made.append(Record.judged(row, "process time of one fit [s]", None, seconds, at_most=slowest, note=said))
    return made
