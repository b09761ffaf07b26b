"""Table 8.5: parameters of the longitudinal and of the bicycle model, with what the data say about each.

Bicycle: the Ferrari run, first 70 %, 20 Hz, as in table 8.2, inputs as means over each sample interval; fitted three
times, with the steering as logged and late by one and by two samples (50, 100 ms): Iz and the stiffnesses rest on a
delay that the thesis does not mention. Longitudinal: three parameters of the thesis' model on the log with pedals,
first 70 % of its fast part, see table 8.3. The thesis prints no unit and no interval; its C_f of 3438 is no stiffness
of a racing tire; ours is per axle. Here every estimate has its 95 % interval, which allows for coloured residuals.
"""

import numpy as np

from slipangle import Bicycle, Dataset, FitInfo, GreyBox, Longitudinal, LongitudinalParams, join
from slipangle.identify.judge.initial import restarted
from slipangle.identify.judge.validate import score
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction
from slipangle.reproduce._chapter_8 import bicycle, ferrari, quietly
from slipangle.reproduce.table_8_3 import RESTART, fast_part

BICYCLE = ("inertia_z", "C_f", "C_r")
PRINTED = {"inertia_z": 2558.0, "C_f": 3438.0, "C_r": 82424.0, "k_e": 61.647, "k_d": 115.872, "k_r": -0.231}
PLAUSIBLE = (2e4, 3e5)  # N/rad per axle of a one-ton car on racing tires


def late(data: Dataset, samples: int) -> Dataset:
    """The data with the steering ``samples`` later."""
    if samples == 0:
        return data
    parts = []
    for part in data.experiments:
        delta = part["delta"]
        moved = np.concatenate([np.full(samples, delta[0]), delta[:-samples]])
        parts.append(part.with_channel("delta", moved, "rad"))
    return join(*parts, name=data.name)


def reproduce(progress: Progress) -> Reproduction:
    """Estimates, intervals and what the steering's delay does to them."""
    train, test = (part.hold_mean() for part in ferrari())
    records: list[Record] = []
    inertia, fits = [], []
    for samples in (0, 1, 2):
        progress(0.1 + 0.2 * samples, f"bicycle, steering late by {50 * samples} ms")
        model = bicycle(late(train, samples), BICYCLE)
        fits.append(score(model.simulate(late(test, samples)), "r").fit)
        inertia.append(model.params.inertia_z)
        if samples == 0:
            records += _parameters("bicycle", model)
    ratio, masses = max(inertia) / min(inertia), ", ".join(f"{i:.0f}" for i in inertia)
    note = f"Iz {masses} kg m2 at fits of {', '.join(f'{f:.1f}' for f in fits)} %: not identifiable without the delay"
    what = "Iz over delays of 0, 50, 100 ms, largest over smallest [-]"
    records.append(Record("bicycle", what, None, ratio, "> 1.5", ratio > 1.5, note))
    progress(0.7, "longitudinal")
    fast = fast_part(("pedal",)).split(0.7)[0]
    start = Longitudinal(params=LongitudinalParams(mass=790.0, k_e=6000.0, k_d=60.0, k_r=0.02), dt=fast.dt)
    settings = GreyBox(start=start, free=("k_e", "k_d", "k_r"))
    records += _parameters("longitudinal, another car", quietly(settings, restarted(fast, RESTART, start.memory)))
    return Reproduction.told(__doc__, records)


def _parameters(row: str, model: Bicycle | Longitudinal) -> list[Record]:
    """Each estimate with its interval; stiffnesses must be those of a car."""
    info = model.fit_info
    if not isinstance(info, FitInfo):
        raise AssertionError
    made = []
    for name, value, unit, (low, high) in zip(info.names, info.values, info.units, info.interval(), strict=True):
        bound, holds = "", None
        if name in ("C_f", "C_r"):
            bound, holds = f"{PLAUSIBLE[0]:g} to {PLAUSIBLE[1]:g}", bool(PLAUSIBLE[0] <= value <= PLAUSIBLE[1])
        said = f"95 % {low:.4g} to {high:.4g}"
        made.append(Record(row, f"{name} [{unit}]", PRINTED[name], float(value), bound, holds, said))
    return made
