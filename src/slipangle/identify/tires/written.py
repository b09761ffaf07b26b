"""A fitted tire as a file: what the data say of each coefficient, and blanks where they say nothing."""

from dataclasses import fields

import numpy as np

from slipangle.data.readers.tir import TirFile
from slipangle.identify.tires.magic_formula_coefficients import COMBINED, LATERAL, LONGITUDINAL, MOMENTS
from slipangle.models.model import FitInfo
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire

OPEN = "not determined by the data"


def confidence(info: FitInfo, *, level: float = 0.95) -> dict[str, str]:
    """Interval of each coefficient as a comment for `MagicFormulaTire.write_tir`.

    >>> info = FitInfo(names=("PDY1",), values=np.array([1.2]), covariance=np.array([[1e-4]]),
    ...     noise_std=np.array([1.0]), n_samples=10)
    >>> confidence(info)
    {'PDY1': '95 % interval 1.1804 to 1.2196'}
    """
    ends = info.interval(level)
    return {
        name: f"{100 * level:g} % interval {low:.5g} to {high:.5g}"
        for name, (low, high) in zip(info.names, ends, strict=True)
    }


def fitted_file(tire: MagicFormulaTire) -> TirFile:
    """The file of a fitted tire: intervals as comments, no number for a coefficient that was left open.

    Such a coefficient is blank, which stands for its default, so that the forces are those of the tire; one whose
    value the fit needs all the same, or that the start tire had, is written with that remark.
    """
    info, comments = tire.fit_info, {}
    if info is None or tire.mirrored is None:
        return tire.to_tir()
    defaults = {f.name: f.default for f in fields(tire.coefficients)}
    tables = (LONGITUDINAL, LATERAL, COMBINED, *(table for many in MOMENTS.values() for table in many))
    names = {f.name for table in tables for f in table}
    unknown = names - set(info.names)
    wide = 1.96 * info.std > np.maximum(np.abs(info.values), 1e-3)
    comments = confidence(info) | {n: f"{OPEN}, but needed" for n, w in zip(info.names, wide, strict=True) if w}
    comments |= {n: f"{OPEN}, from the start tire" for n in unknown if getattr(tire.coefficients, n) != defaults[n]}
    blank = sorted(n for n in unknown if getattr(tire.coefficients, n) == defaults[n])
    return tire.to_tir(comments=comments).with_values(dict.fromkeys(blank), comments=dict.fromkeys(blank, OPEN))
