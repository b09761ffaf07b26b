"""The structure of a car, one correction after the other, each kept if it helps on held-out stretches."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.identify.car.corrections import Correction
from slipangle.identify.car.effects import outdone, told, turned_away
from slipangle.identify.car.structures import (
    AIDS_LATE,
    STIFF,
    Fitted,
    Stage,
    as_good,
    change,
    corrected,
    errors,
    fit,
    helps,
)

_ROUNDS = 4  # over the corrections that did not help


def linear_bicycle(start: Any, own: tuple[str, ...], elsewhere: dict[str, float], train: Dataset) -> Fitted:
    """The linear bicycle, no sensor quite straight; a gain of each recording's own starts ``elsewhere``, if it may."""
    late = (f"delay_{name}" for name in AIDS_LATE if name in train.inputs)  # 5 ms of rear wheels make a moment of 1.4
    scaled = ("gain_M_z",) if "M_z" in train.inputs else ()
    straight = ("steering_offset", *(("turn_v_y",) if "v_y" in train.outputs else ()))
    shared = tuple(n for n in (*STIFF, *straight, *late, *scaled) if n not in own)
    return fit(start.with_values(**elsewhere) if "steering_gain" in own else start, shared, train, own=own)


def climb(
    first: Fitted, tried: tuple[Correction, ...], train: Dataset, held: Dataset
) -> tuple[Fitted, list[Stage], list[Correction]]:
    """The structure that predicts held-out stretches best; the stages on the way; the corrections that did not help."""
    best, at = first, errors(first, held)
    stages = [_stage("the linear bicycle with its steering's offset", True, first, at, 0.0)]
    dropped, replaced, failed_on = list(tried), list[Correction](), dict[str, Fitted]()
    stood_in = set[str]()  # what may have stood in for a correction that is kept
    for _ in range(_ROUNDS):  # what did not help a poor model may help a better one
        waiting, dropped = dropped, []
        for correction in waiting:
            if correction.adds_nothing_to(best.free, best.own):
                continue
            if failed_on.get(correction.said) is best:
                dropped.append(correction)
                continue
            other = corrected(best, correction, train)
            then = errors(other, held)
            kept = helps(best, other, at, then, correction) and told(other, correction.free) >= 1.0
            kept = kept and not turned_away(first, best, other) and not outdone(best, other, correction, train)
            kept = kept and not ({*correction.free} <= stood_in and as_good(best, other))
            stages.append(_stage(correction.said, kept, other, then, change(at, then)[0]))
            if kept:
                gone = {*best.free} - {*other.free} - {*other.own}
                replaced += [c for c in tried if {*c.free} & gone]
                stood_in |= {*correction.instead}
                best, at = other, then
            else:
                failed_on[correction.said] = best
                dropped.append(correction)
    return best, stages, [*dropped, *replaced]


def _stage(said: str, kept: bool, fitted: Fitted, squares: np.ndarray, moved: float) -> Stage:
    rms = np.sqrt(squares.mean(axis=0))
    return Stage(correction=said, kept=kept, error=rms, change=moved, values=fitted.values)
