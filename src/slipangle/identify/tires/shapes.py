"""Shapes of a Magic Formula curve that fit alike: where a sweep ends soon after its peak, C and E come in twins.

Either has an interval of its own, and beyond the sweep they part: with C = 2.2 the force turns its sign.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slipangle.identify.tires.magic_formula_coefficients import LATERAL, LONGITUDINAL, Free
from slipangle.identify.tires.stages import FittedStage, coefficients, deviance, robust_covariance, unscaled
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire

SHAPE = {"F_x": ("PCX1", "PEX1"), "F_y": ("PCY1", "PEY1")}  # shape and curvature factor of each force
_APART = 0.05  # shape factors closer than this are one


def alike(stage: FittedStage, start: MagicFormulaTire) -> list[dict[str, float]]:
    """Coefficients of the minima of a pure-slip stage that no test can tell from the best, one for each shape factor.

    First is the one whose shape factor is nearest to that of ``start``, the tire that the fit starts from.
    """
    count = np.count_nonzero(stage.problem.weight)
    best = max(stage.solution.cost, 1e-12)
    as_good = stage.solution.ends[count * np.log(np.maximum(stage.solution.costs, best) / best) < np.log(count)]
    found = [coefficients(stage, end) for end in as_good]
    factor = SHAPE[stage.outputs[0]][0]
    distinct: list[dict[str, float]] = []
    for one in found:
        if all(abs(one[factor] - other[factor]) > _APART for other in distinct):
            distinct.append(one)
    ordinary = float(getattr(start.coefficients, factor))
    return sorted(distinct, key=lambda one: abs(one[factor] - ordinary))


def shaped(stage: FittedStage, output: str) -> tuple[Free, ...]:
    """Coefficients of a stage with those of the shape of an output, which may have been put back."""
    wanted = {*(f.name for f in stage.free), *SHAPE[output]}
    others = [f for f in (*LONGITUDINAL, *LATERAL) if f.name in wanted and f not in stage.free]
    return (*stage.free, *others)


def reach(names: Sequence[str], stage: FittedStage) -> dict[str, tuple[float, float]]:
    """95 % interval of those of the named coefficients that are free in a stage."""
    deviations = np.sqrt(np.maximum(np.diag(robust_covariance(stage)[0]), 0.0))
    ends = {}
    for f, z, std in zip(stage.free, stage.solution.theta, deviations, strict=True):
        if f.name in names:
            middle, half = float(unscaled(f, z)), 1.96 * float(std) * (f.upper - f.lower) / 2
            ends[f.name] = max(f.lower, middle - half), min(f.upper, middle + half)
    return ends


def left_open(
    output: str, tire: MagicFormulaTire, stage: FittedStage, trials: Sequence[FittedStage]
) -> tuple[str, dict[str, float]]:
    """A sentence of shapes that fit as well as the tire's, and how far from it they reach; empty where there are none.

    ``trials`` are fits of the same data with both coefficients of the shape free.
    """
    names = SHAPE[output]
    most = deviance(stage) + np.log(np.count_nonzero(stage.problem.weight))
    here = {name: float(getattr(tire.coefficients, name)) for name in names}
    own = {name: (value, value) for name, value in here.items()} | reach(names, stage)
    held = [own, *(reach(names, trial) for trial in trials if deviance(trial) < most)]
    ends = {n: (min(ends[n][0] for ends in held), max(ends[n][1] for ends in held)) for n in names}
    factor, curvature = names
    if ends[factor][0] > own[factor][0] - _APART and ends[factor][1] < own[factor][1] + _APART:
        return "", {}
    said = (
        f"the data leave the shape of {output} open: {factor} = {here[factor]:.3g} with {curvature} = "
        f"{here[curvature]:.3g}, but any from {ends[factor][0]:.3g} to {ends[factor][1]:.3g} with a {curvature} of its "
        "own may fit alike, and beyond the data they part: sweep to three times the slip of the peak, or start from a "
        "tire of that kind"
    )
    return said, {name: max(here[name] - low, high - here[name]) for name, (low, high) in ends.items()}
