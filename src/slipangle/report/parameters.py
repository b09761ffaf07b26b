"""Tables of parameters: estimates, their intervals, what to doubt about each, how they depend on each other."""

import math
import re
from collections.abc import Mapping

import numpy as np

from slipangle.identify.physics.advise import ABOUT_ZERO
from slipangle.models.model import FitInfo
from slipangle.report.style import pretty_unit
from slipangle.report.tables import Cell, Heading, Row, Table, Tone, lost, published, to_digit
from slipangle.units import read_in

_ALIKE = 0.95  # correlation from which two parameters can stand in for each other
_WIDE = 0.2  # half of the interval over the value, from which it is said


def parameter_table(
    fit: FitInfo,
    *,
    references: Mapping[str, float] | None = None,
    reference_title: str = "reference",
    level: float = 0.95,
    title: str = "Parameters",
    command: str = "",
) -> Table:
    """Estimates with their confidence intervals in the units that people read: angles in degrees, delays in ms.

    One that the data do not determine is marked poor, one with anything to `doubt` fair.

    Parameters
    ----------
    fit : FitInfo
        Estimates, covariance, warnings.
    references : mapping, optional
        True or published values by parameter name, SI units, under ``reference_title``.
    level : float
        Confidence level.
    title, command : str
        Of the table; what makes it again.
    """
    known = references or {}
    ends = fit.interval(level)
    rows = []
    for k, name in enumerate(fit.names):
        factor, unit = read_in(name, fit.units[k] if fit.units else "-")
        value, low, high = (factor * float(v) for v in (fit.values[k], *ends[k]))
        half = (high - low) / 2
        cells: list[Cell] = [name, pretty_unit(unit)]
        cells += [to_digit(v, half) for v in (value, low, high)]
        cells += [math.nan if lost(value, half) else 100 * half / abs(value)]
        if known:
            cells.append(published(factor * known[name], 6) if name in known else None)
        rows.append(Row(tuple(cells), tone=judged(fit, k, float(np.ptp(ends[k])) / 2)))
    percent = f"{100 * level:g} %"
    columns = [Heading("parameter", words=True), Heading("unit", words=True), Heading("estimate")]
    columns += [Heading(f"{percent} from"), Heading("to"), Heading("half width", "%", 2)]
    columns += [Heading(reference_title)] if known else []
    return Table(
        title=title,
        columns=tuple(columns),
        rows=tuple(rows),
        caption=f"{fit.method[0].upper()}{fit.method[1:].rstrip('.')}." if fit.method else "",
        warnings=fit.warnings,
        command=command,
    )


def may_be_zero(name: str) -> bool:
    """Whether a parameter of that name may well be zero, so that an interval wider than its value is no fault."""
    return any(m in name for m in ABOUT_ZERO)


def undetermined(fit: FitInfo, k: int, half: float) -> bool:
    """Whether the data leave a parameter open: half of its interval, SI, is no less than its value, which is not 0."""
    return not half <= abs(float(fit.values[k])) and not (may_be_zero(fit.names[k]) and math.isfinite(half))


def judged(fit: FitInfo, k: int, half: float) -> Tone:
    """How an estimate is meant that has half of an interval, SI: poor if undetermined, fair with anything to doubt."""
    return "poor" if undetermined(fit, k, half) else "fair" if doubt(fit, k, half) else "good"


def doubt(fit: FitInfo, k: int, half: float) -> str:
    """What to doubt about one parameter, in a few words; empty where nothing speaks against it."""
    name, value = fit.names[k], float(fit.values[k])
    said = []
    if not half <= abs(value):
        said.append("these data do not determine it" if undetermined(fit, k, half) else "may be 0")
    elif half > _WIDE * abs(value):
        said.append(f"wide: ± {100 * half / abs(value):.0f} %")
    for a, b, rho in fit.correlated(_ALIKE):
        if name in (a, b):
            said.append(f"hardly told apart from {b if name == a else a} ({rho:.2f})")
            break
    if any(re.search(rf"(?<![\w]){re.escape(name)}(?![\w])", sentence) for sentence in fit.warnings):
        said.append("a warning names it")
    return "; ".join(said)


def correlation_table(fit: FitInfo, *, title: str = "Correlation of the estimates", command: str = "") -> Table:
    """Correlation matrix of the estimates; a parameter that another one can replace, 0.95 or more, is marked poor."""
    matrix = fit.correlation
    rows = []
    for i, name in enumerate(fit.names):
        others = np.abs(np.delete(matrix[i], i))
        tone: Tone = "poor" if not (others < 0.95).all() else "fair" if (others > 0.8).any() else "good"
        cells: list[Cell] = [name, *(f"{rho:.2f}" if math.isfinite(rho) else "n/a" for rho in matrix[i])]
        rows.append(Row(tuple(cells), tone=tone))
    said = fit.confounding
    return Table(
        title=title,
        columns=(Heading("", words=True), *(Heading(name) for name in fit.names)),
        rows=tuple(rows),
        caption=f"{said[:1].upper()}{said[1:]}." if said else "",
        command=command,
    )
