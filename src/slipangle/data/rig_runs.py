"""Runs of a tire rig as they are: what to cut, which units they are in, and where several contradict each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipangle.data.tire_data import TireData, levels

_SPEED = 0.07  # share of the speed that a level of it is wide, either way
_PART = 0.1  # of the samples that a level of speed holds at least
_WARM, _REST = 0.2, 0.1  # quantile of the second half's temperature, and the share of the rise to it that may lack
_LONGEST = 1 / 3  # of the run that may be warm-up
_BETWEEN = 30e3  # pressures of tire tests are above 30 kPa, and below 30 psi told as kPa


def unnamed_units(columns: Mapping[str, np.ndarray], given: Mapping[str, str], system: str | None) -> tuple[bool, str]:
    """Whether channels without units are in pounds, mph and psi, and why."""
    if system is not None:
        return system == "US", "as asked for"
    if "P" in columns and "P" not in given:
        pressure = float(np.nanmedian(np.asarray(columns["P"], dtype=float)))
        if 0 < pressure:
            return pressure < _BETWEEN / 1e3, f"by the pressure of {pressure:.3g}"
    if given.get("P") == "psi" or given.get("V") in ("mph", "ft/s"):
        return True, "by the units of the other channels"
    return False, 'which nothing in the file confirms: name them with units="US" (--units US) if they are not'


def tread_temperature(si: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """Mean of the rig's tread temperatures; None where there is none. [degC]"""
    found = [si[name] for name in ("TSTC", "TSTI", "TSTO") if name in si]
    return np.mean(found, axis=0) if found else None


def rig_conditions(si: Mapping[str, np.ndarray], keep: np.ndarray, *, warm_up: bool) -> tuple[np.ndarray, list[str]]:
    """Samples at speeds that the run was held at and on a warm tread, and what was cut; of those to ``keep``."""
    mask, said = np.ones(len(keep), dtype=bool), []
    if "V" in si and keep.any():
        speed = np.abs(si["V"])
        typical = float(np.median(speed[keep]))
        if typical > 0 and np.ptp(speed[keep]) > 2 * _SPEED * typical and np.max(speed[keep]) < 1e3 * typical:
            _, index = levels(speed[keep], _SPEED * typical)
            many = [k for k in range(index.max() + 1) if (index == k).sum() >= _PART * keep.sum()]
            at_level = np.zeros(len(keep), dtype=bool)
            at_level[np.flatnonzero(keep)[np.isin(index, many)]] = True
            at_level &= speed > 0.1 * typical
            off = keep & ~at_level
            if many and off.any():
                mask &= at_level
                lowest, highest = float(speed[off].min()), float(speed[off].max())
                said.append(
                    f"{int(off.sum())} samples left out at speeds that the run was not held at, {3.6 * lowest:.3g} to "
                    f"{3.6 * highest:.3g} km/h"
                )
    heat = tread_temperature(si)
    if not warm_up or heat is None or not (keep & mask).any():
        return mask, said
    rows = np.flatnonzero(keep & mask)
    settled = float(np.quantile(heat[rows[len(rows) // 2 :]], _WARM))
    warm = settled - _REST * (settled - float(heat[rows[0]]))
    first = int(np.argmax(heat[rows] >= warm))
    if first > _LONGEST * len(rows):
        said.append(
            f"the tread warms up all along, from {heat[rows[0]]:.0f} to {heat[rows].max():.0f} degC: nothing was cut"
        )
    elif first > 0:
        mask[rows[:first]] = False
        said.append(f"{first} samples of the warm-up left out, {heat[rows[0]]:.0f} degC up to {warm:.0f} degC")
    return mask, said


class Offset(NamedTuple):
    """How much more of an output, over load, a run measures than the first one at equal slip, load and camber."""

    run: int
    output: str
    share: float  # of the load [-], or [m] of a moment
    spread: float  # standard deviation of that output over load in all runs
    bins: int  # conditions that both runs hold


def offsets(data: TireData) -> tuple[Offset, ...]:
    """Offsets between the first run that shares conditions with each other one and that one."""
    runs = data.runs
    columns = [data.slip_angle / np.radians(1.0), data.slip_ratio / 0.02, data.load / (0.15 * np.median(data.load))]
    columns.append(data.gamma / np.radians(1.0))
    if data.pressure is not None:
        columns.append(data.pressure / 8e3)
    keys = np.round(np.column_stack(columns)).astype(np.int64)
    found: list[Offset] = []
    for output in ("F_x", "F_y", "M_x", "M_z"):
        values = getattr(data, output)
        if values is None or len(runs) < 2:
            continue
        scaled = values / data.load
        spread = float(np.std(scaled))
        means = [_means(keys[rows], scaled[rows]) for rows in runs]
        for k in range(1, len(runs)):
            common = [b for b in means[k] if b in means[0]]
            if len(common) >= 3 and spread > 0:
                difference = float(np.median([means[k][b] - means[0][b] for b in common]))
                found.append(Offset(k, output, difference, spread, len(common)))
    return tuple(found)


def _means(keys: np.ndarray, values: np.ndarray) -> dict[tuple[int, ...], float]:
    """Mean of the values of each condition that holds at least five."""
    unique, inverse, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    sums = np.bincount(inverse.ravel(), weights=values, minlength=len(unique))
    return {tuple(map(int, u)): float(s / n) for u, s, n in zip(unique, sums, counts, strict=True) if n >= 5}


def disagreements(data: TireData, names: Sequence[str] = ()) -> tuple[str, ...]:
    """A sentence for every output of which a run has at least a fifth of its spread more or less than the first."""
    said = []
    for o in offsets(data):
        if abs(o.share) > 0.2 * o.spread:
            which = [f"'{names[k]}'" if k < len(names) else f"run {k + 1}" for k in (o.run, 0)]
            unit = " m" if o.output.startswith("M") else ""
            said.append(
                f"{o.output} of {which[0]} is {o.share:+.3g}{unit} of the load off that of {which[1]} at equal slip "
                f"and load, {100 * abs(o.share) / o.spread:.0f} % of its spread: the runs disagree, remove offsets "
                "(--offsets) or fit them apart"
            )
    return tuple(said)


def without_offsets(data: TireData) -> TireData:
    """The data with each run's outputs moved to the first one's level at equal conditions, in proportion to load.

    What is so small that it is no tenth of the spread stays.
    """
    changed: dict[str, np.ndarray] = {}
    said, runs = list(data.notes), data.runs
    for o in offsets(data):
        if abs(o.share) <= 0.1 * o.spread:
            continue
        values = changed.setdefault(o.output, np.array(getattr(data, o.output)))
        values[runs[o.run]] -= o.share * data.load[runs[o.run]]
        unit = " m" if o.output.startswith("M") else ""
        said.append(f"{o.output} of run {o.run + 1} moved by {-o.share:+.3g}{unit} of the load to the level of run 1")
    return replace(data, **changed, notes=tuple(said)) if changed else data
