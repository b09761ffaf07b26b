"""Tables and page of a tire: forces at given conditions, its curves, and how it follows its measurements."""

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from slipangle.data.tire_data import TireData
from slipangle.errors import ParameterError
from slipangle.models.model import FitInfo
from slipangle.models.tires.magic_formula.axes import AXES
from slipangle.models.tires.simple import Tire, slip_from_practical
from slipangle.report.page import Fact, Figure, Findings, Grid, Page, Section
from slipangle.report.parameters import parameter_table
from slipangle.report.tables import Heading, Row, Table
from slipangle.report.tire_figures import (
    QUANTITIES,
    OperatingRange,
    Quantity,
    combined_slip,
    force_text,
    forces,
    pure_slip,
)
from slipangle.report.tire_fits import fit_figure, predicted, residual_histogram
from slipangle.report.tire_grip import GripOver, grip_figure


def evaluate_table(
    tire: Tire,
    *,
    slip_ratio: Sequence[float] | np.ndarray,
    slip_angle: Sequence[float] | np.ndarray,
    load: Sequence[float] | np.ndarray,
    camber: Sequence[float] | np.ndarray = (0.0,),
    pressure: float | None = None,
    speed: float | None = None,
    axes: str = "slipangle",
    practical: bool = False,
) -> Table:
    """Forces and moments at every combination of the given conditions [-, rad, N, rad], one row each.

    Raises ParameterError if the tire does not know a pressure or speed that is given.

    Parameters
    ----------
    pressure, speed : float, optional
        Inflation pressure [Pa] and forward speed [m/s]; by default those of the tire's file.
    axes : {"slipangle", "ISO-W", "SAE", "adapted SAE"}
        What slip angles are given in and the side force, M_y and M_z are told in.
    practical : bool
        Whether ``slip_ratio`` is kappa, counted on the forward speed, and not on the larger speed.
    """
    asked = {"pressure": pressure, "speed": speed}
    unknown = [name for name, value in asked.items() if value is not None and name not in tire.conditions]
    if unknown:
        raise ParameterError(
            f"a {type(tire).__name__} does not depend on {unknown[0]}; expected a Magic Formula tire: leave it out"
        )
    grid = np.meshgrid(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in (load, camber, slip_angle, slip_ratio)))
    weight, gamma, angle, ratio = (g.transpose(1, 0, 2, 3).ravel() for g in grid)
    turned, side = (a * b for a, b in zip(AXES["slipangle"], AXES[axes], strict=True))
    slip = slip_from_practical(ratio) if practical else ratio
    forces = tire.forces_at(slip, turned * angle, weight, camber=gamma, **asked)
    told = forces._replace(F_y=side * forces.F_y, M_y=side * forces.M_y, M_z=side * forces.M_z)
    columns = [np.broadcast_to(np.asarray(v, dtype=float), ratio.shape) for v in told]
    given = weight, np.degrees(gamma), np.degrees(angle), ratio
    rows = tuple(Row(tuple(map(float, cells))) for cells in zip(*given, *columns, strict=True))
    heads = (("load", "N"), ("camber", "deg"), ("slip angle", "deg"), ("kappa" if practical else "slip ratio", "-"))
    heads += (("F_x", "N"), ("F_y", "N"), ("M_x", "N m"), ("M_y", "N m"), ("M_z", "N m"))
    title = "Forces and moments" + ("" if axes == "slipangle" else f", {axes} axes")
    return Table(title=title, columns=tuple(Heading(t, u) for t, u in heads), rows=rows)


def tire_page(
    tire: Tire,
    *,
    title: str,
    data: TireData | None = None,
    loads: Sequence[float] = (),
    camber: float = 0.0,
    facts: Sequence[Fact] = (),
    command: str = "",
) -> Page:
    """A page of one tire: its curves, and how it follows the measurements where they are given.

    ``data`` is what it was fitted to, ``loads`` [N] and ``camber`` [rad] are what to draw, ``facts`` and ``command``
    say where the page comes from.
    """
    sections = [_curves(tire, loads, camber)]
    if data is not None:
        sections.insert(0, _fit(tire, data))
    return Page(
        title=title,
        subtitle=f"{_kind(tire)}; a positive slip ratio drives, a positive slip angle gives a force to the left",
        sections=tuple(sections),
        facts=tuple(facts),
        command=command,
    )


def _kind(tire: Tire) -> str:
    """Class of the tire in words.

    >>> from slipangle.models.tires.physical import BrushTire
    >>> _kind(BrushTire(C_alpha=5e4, C_s=6e4))
    'Brush tire'
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(tire).__name__).lower()
    return words[0].upper() + words[1:]


def _curves(tire: Tire, loads: Sequence[float], camber: float) -> Section:
    where = OperatingRange.of(tire, loads=loads)
    blocks = []
    for quantity in ("F_x", "F_y", "M_z"):
        slip = 0.5 * (where.slip_ratio if quantity == "F_x" else where.slip_angle)
        probe = forces(tire, *((slip, 0.0) if quantity == "F_x" else (0.0, slip)), where.loads[-1], camber)
        if np.any(np.asarray(getattr(probe, quantity)) != 0):
            figure = pure_slip(tire, quantity, loads=loads, camber=camber)  # type: ignore[arg-type]
            over = "slip ratio" if quantity == "F_x" else "slip angle"
            blocks.append(Figure(title=f"{quantity} over {over}", figure=figure, caption="One line per vertical load."))
    middle = where.loads[len(where.loads) // 2]
    caption = f"At {force_text(middle)}: each line holds the slip angle while the slip ratio runs."
    figure = combined_slip(tire, load=middle, camber=camber)
    blocks.append(Figure(title="Combined slip", figure=figure, caption=caption))
    return Section(title="Forces over slip", short="Curves", blocks=tuple(blocks))


def fit_errors(tire: Tire, data: TireData) -> Table:
    """RMSE of each measured output, the spread of the data and R2; F_x where the wheel is driven or braked."""
    rows = []
    fitted = predicted(tire, data)
    for quantity in _measured(data):
        measured = getattr(data, quantity)
        error = measured - np.broadcast_to(getattr(fitted, quantity), measured.shape)
        if quantity == "F_x":  # rolling resistance is no part of slip forces
            driven = np.abs(data.slip_ratio) > 0.005
            if not driven.any():
                continue
            measured, error = measured[driven], error[driven]
        spread, rms = float(np.std(measured)), float(np.sqrt(np.mean(error**2)))
        share = 1 - rms**2 / spread**2 if spread > 0 else math.nan
        rows.append(Row((quantity, QUANTITIES[quantity][1], rms, spread, share)))
    columns = *(Heading(n, words=True) for n in ("output", "unit")), Heading("RMSE"), Heading("spread of the data")
    return Table(title="How far off", columns=(*columns, Heading("R²", "-")), rows=tuple(rows))


def _measured(data: TireData) -> list[Quantity]:
    quantities: tuple[Quantity, ...] = ("F_x", "F_y", "M_z", "M_x")
    return [q for q in quantities if getattr(data, q) is not None]


def _fit(tire: Tire, data: TireData) -> Section:
    blocks: list[Any] = [fit_errors(tire, data)]
    if data.notes:
        blocks.append(Findings.of("What was seen in the data", data.notes))
    for quantity in _measured(data):
        try:
            figure = fit_figure(tire, data, quantity)
        except ParameterError:
            continue
        caption = "Points are measured, lines fitted, at the camber nearest to zero; residuals below."
        blocks.append(Figure(title=f"{quantity}: measured and fitted", figure=figure, caption=caption))
    bars = [
        Figure(title=f"Residuals of {q}, all samples", figure=residual_histogram(tire, data, q))
        for q in ("F_x", "F_y")
        if np.any(getattr(data, q) != 0)
    ]
    blocks.append(Grid(figures=tuple(bars)))
    blocks += _grip(tire, data)
    for name, info in informations(tire):
        blocks.append(parameter_table(info, title=f"Coefficients{name}"))
    return Section(title="Fit to measurements", short="Fit", blocks=tuple(blocks))


def _grip(tire: Tire, data: TireData) -> list[Figure]:
    """Grip over temperature and distance rolled, where the data have them."""
    figures = []
    over: tuple[tuple[GripOver, str], ...] = (("temperature", "tread temperature"), ("distance", "distance rolled"))
    for name, words in over:
        try:
            figure = grip_figure(tire, data, name)
        except ParameterError:
            continue
        caption = "Measured force over the fitted one near the limit of friction; medians and quartiles."
        figures.append(Figure(title=f"Grip over {words}", figure=figure, caption=caption))
    return figures


def informations(tire: Any) -> list[tuple[str, FitInfo]]:
    """Estimates with intervals: of the tire, or of each of its curves."""
    own = getattr(tire, "fit_info", None)
    if own is not None and own.names:
        return [("", own)]
    curves = ((f", {n}", getattr(getattr(tire, n, None), "fit_info", None)) for n in ("longitudinal", "lateral"))
    return [(name, info) for name, info in curves if info is not None and info.names]
