"""Figures of tires show the tire's own numbers; pages hold every curve."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels
from slipangle.data.tire_data import joined
from slipangle.errors import ParameterError
from slipangle.models.tires.magic_formula.validity import ValidRange
from slipangle.models.tires.physical import BrushTire
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_6_2
from slipangle.report.tables import Table
from slipangle.report.tire_figures import OperatingRange, combined_slip, pure_slip
from slipangle.report.tire_fits import curve_figure, fit_figure, residual_histogram
from slipangle.report.tires import evaluate_table, fit_errors, tire_page
from tests.rig import LOADS, TIRE, UNITS, channels

RUNS = joined([from_channels(channels(kind), UNITS) for kind in ("cornering", "drive/brake")], name="rig")
BRUSH = BrushTire(C_alpha=5e4, C_s=6e4, half_length=0.06)


def lines(figure):
    return [t for t in figure.data if t.mode == "lines"]


@pytest.mark.parametrize("tire", [TIRE, BRUSH, SOUSA_TABLE_6_2], ids=["MF 6.1", "brush", "simple"])
@pytest.mark.parametrize("quantity", ["F_x", "F_y"])
def test_lines_are_the_forces(tire, quantity):
    figure = pure_slip(tire, quantity, loads=(500.0, 1000.0))
    assert [t.name for t in figure.data] == ["500 N", "1 kN"]
    line = figure.data[1]
    slip = np.asarray(line.x) if quantity == "F_x" else np.deg2rad(line.x)
    at = (slip, 0.0) if quantity == "F_x" else (0.0, slip)
    assert np.asarray(line.y) == pytest.approx(getattr(tire.forces(*at, 1000.0), quantity), rel=1e-5, abs=1e-2)
    assert quantity[0] in figure.layout.yaxis.title.text
    assert "[N]" in figure.layout.yaxis.title.text


def test_range_is_that_of_the_file():
    limits = ValidRange(load=(300.0, 1200.0), slip_angle=(-0.1, 0.15), slip_ratio=(-0.25, 0.25))
    where = OperatingRange.of(replace(TIRE, limits=limits))
    assert where.slip_angle == 0.1
    assert where.slip_ratio == pytest.approx(0.2)  # 0.25 over 1.25: counted on the larger speed
    assert min(where.loads) >= 300
    assert max(where.loads) <= 1200
    assert len(where.loads) == 4


def test_combined_slip_stays_on_the_friction_ellipse():
    figure = combined_slip(BRUSH, load=3000.0)
    assert len(figure.data) == 8
    for line in figure.data:
        size = np.hypot(np.asarray(line.x, dtype=float), np.asarray(line.y, dtype=float))
        assert size.max() <= 3000.0 * 1.001
    assert figure.layout.yaxis.scaleanchor == "x"


@pytest.mark.parametrize("quantity", ["F_x", "F_y", "M_x", "M_z"])
def test_fit_figure_holds_points_line_and_residuals(quantity):
    figure = fit_figure(TIRE, RUNS, quantity, sweeps=5)
    assert len(figure.data) == 3 * len(LOADS)
    measured, line, residual = figure.data[:3]
    assert measured.mode == residual.mode == "markers"
    assert residual.yaxis == "y2"
    inside = np.interp(np.sort(measured.x), line.x, line.y)
    spread = np.ptp(np.asarray(line.y, dtype=float))
    assert np.std(np.asarray(measured.y)[np.argsort(measured.x)] - inside) < 0.1 * spread + 2
    assert abs(np.mean(residual.y)) < 0.02 * spread + 1


def test_errors_are_the_noise():
    table = fit_errors(TIRE, RUNS)
    found = {row.cells[0]: row.cells[2] for row in table.rows}
    assert found["F_y"] == pytest.approx(0.01 * np.sqrt(np.mean(np.square(RUNS.load))), rel=0.05)
    assert residual_histogram(TIRE, RUNS, "F_y").data[0].y.sum() > 0.99 * RUNS.n_samples


def test_curve_figure_shows_data_curves_and_residuals():
    slip = np.linspace(-0.2, 0.2, 41)
    curve = SOUSA_TABLE_6_2.lateral
    figure = curve_figure(slip, curve(slip) + 0.1, {"a": curve, "b": lambda s: 0 * s}, along=False)
    data, a, rest, b, _ = figure.data
    assert np.asarray(data.x) == pytest.approx(np.rad2deg(slip), rel=1e-6)
    assert np.asarray(a.y) == pytest.approx(curve(np.deg2rad(np.asarray(a.x))), abs=1e-5)
    assert np.asarray(rest.y) == pytest.approx(0.1, abs=1e-6)
    assert (a.name, b.name, rest.yaxis) == ("a", "b", "y2")


def test_table_of_every_combination():
    table = evaluate_table(TIRE, slip_ratio=[0.0, 0.1], slip_angle=[-0.1, 0.0, 0.1], load=[500.0, 900.0], camber=[0.02])
    assert isinstance(table, Table)
    assert len(table.rows) == 12
    load, camber, angle, ratio, f_x, f_y, *_ = table.rows[-1].cells
    assert (load, ratio) == (900.0, 0.1)
    assert (np.deg2rad(angle), np.deg2rad(camber)) == pytest.approx((0.1, 0.02))
    found = TIRE.forces(0.1, 0.1, 900.0, camber=0.02)
    assert (f_x, f_y) == pytest.approx((found.F_x, found.F_y))


def test_page_holds_curves_and_fit():
    page = tire_page(TIRE, title="a <tire>", data=RUNS)
    assert [s.short for s in page.sections] == ["Fit", "Curves"]
    text = page.to_html()
    assert "a &lt;tire&gt;" in text
    assert "sign system of the data" in text
    alone = tire_page(BRUSH, title="brush", loads=(2000.0,))
    assert [s.short for s in alone.sections] == ["Curves"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pure_slip(TIRE, "F_q"), "no quantity 'F_q'; nearest"),
        (lambda: fit_figure(TIRE, replace(RUNS, M_z=None), "M_z"), "holds no M_z"),
        (lambda: fit_figure(TIRE, RUNS.rows(np.abs(RUNS.slip_ratio) < 0.001), "F_x"), "no sweep of slip ratio alone"),
    ],
)
def test_mistakes(make, message):
    with pytest.raises(ParameterError, match=message):
        make()
