"""Figures and tables of linear analysis show the numbers of the model, in the units that people read."""

from dataclasses import replace

import numpy as np
import pytest

from slipangle.errors import ParameterError
from slipangle.models.analysis.handling import handling
from slipangle.models.analysis.linearize import linearize
from tests.models.analysis.test_linearize import BICYCLE, fitted


def lines(figure, axis="y"):
    return [t for t in figure.data if t.mode == "lines" and (t.yaxis or "y") == axis and t.fill is None]


def test_bode_has_magnitude_phase_and_bands():
    model, _ = fitted()
    curve = linearize(model, v_x=20.0, name="fit").bode("r", "delta")
    figure = curve.plot(linearize(BICYCLE, v_x=20.0, name="start").bode("r", "delta"))
    assert lines(figure)[0].y == pytest.approx(curve.magnitude, rel=1e-6)
    assert lines(figure, "y2")[0].y == pytest.approx(np.degrees(curve.phase), rel=1e-5, abs=1e-4)
    assert [t.name for t in lines(figure)] == ["fit", "start"]
    bands = [t for t in figure.data if t.fill == "toself"]
    assert len(bands) == 2  # of the fit alone
    n = len(curve.frequency)
    assert bands[0].y[:n] == pytest.approx(curve.magnitude_band()[:, 0], rel=1e-6)
    assert figure.layout.xaxis.type == "log"
    assert "1/s" in figure.layout.yaxis.title.text or "(rad/s)/rad" in figure.layout.yaxis.title.text


def test_nyquist_and_step_draw_what_they_hold():
    linear = linearize(BICYCLE, v_x=20.0)
    curve, step = linear.bode("r", "delta"), linear.step("r", "delta")
    figure = curve.plot(kind="nyquist")
    assert figure.data[0].x == pytest.approx(curve.value.real)
    for mistyped in ("nyqist", "Bode", "magnitude"):
        with pytest.raises(ParameterError, match=f"kind is '{mistyped}'; expected 'bode' or 'nyquist'"):
            curve.plot(kind=mistyped)
    drawn = lines(step.plot())
    assert drawn[0].y == pytest.approx(step.y, rel=1e-6)
    assert drawn[1].y == pytest.approx([step.final] * 2, rel=1e-6)


def test_handling_is_read_in_degrees_and_kilometres_an_hour():
    model, _ = fitted()
    found = handling(model, v_x=[10.0, 20.0, 30.0], name="car")
    figure = found.plot("understeer_gradient")
    assert lines(figure)[0].x == pytest.approx([36.0, 72.0, 108.0])
    assert lines(figure)[0].y == pytest.approx(np.degrees(found["understeer_gradient"]), rel=1e-6)
    table = found.table(29.0)
    assert table.title == "Handling of car at 108 km/h"
    rows = {r.cells[0]: r.cells for r in table.rows}
    gradient = rows["understeer gradient"]
    exact, half = (np.degrees(v["understeer_gradient"][2]) for v in (found, found.stds))
    assert float(gradient[1]) == pytest.approx(exact, abs=0.1 * half)
    assert gradient[3:] == ("deg/(m/s²)", "ISO 4138")
    assert float(rows["characteristic speed"][1]) == pytest.approx(3.6 * found.characteristic_speed.value, rel=0.01)
    assert "understeer<br>gradient" in figure.layout.yaxis.title.text
    assert "critical speed" not in rows
    assert "<table>" in found._repr_html_()
    assert "km/h: characteristic speed" in repr(found)


def test_a_model_that_was_not_fitted_has_numbers_in_its_table():
    model, _ = fitted()
    bare = handling(replace(model, fit_info=None), v_x=[30.0])
    table = bare.table(30.0)
    shown = {r.cells[0]: (r.cells[1], r.cells[2]) for r in table.rows}
    assert float(shown["understeer gradient"][0]) == pytest.approx(np.degrees(bare["understeer_gradient"][0]), rel=1e-3)
    assert {half for _, half in shown.values()} == {"–"}
    assert [name for name, (value, _) in shown.items() if value == "0"] == []
    heads = table.to_text(width=60)
    assert "quantity" in heads
    assert "value" in heads


def test_poles_are_a_table():
    linear = linearize(fitted()[0], v_x=30.0)
    text = linear._repr_html_()
    assert "± 4.664 j" in text
    assert text.count("<tr>") == 2  # the pair once, below the headings
    assert "standard deviations of C_f, C_r" in text
    assert repr(linear).startswith("<linear Bicycle at 30 m/s")
    assert repr(linear.step("r", "delta")) == "<step response of 'Bicycle': delta to r, to 5.378 (rad/s)/rad>"
    assert "0.0" in repr(linear.bode("r", "delta"))
    assert str(linear.gain("r", "delta")).startswith("5.378 ± ")


def test_a_car_that_may_be_neutral_has_no_special_speed():
    """Where the interval of the gradient holds zero, neither a characteristic nor a critical speed is said."""
    wide, _ = fitted(share=(0.3, 0.3), rho=0.0)
    found = handling(wide, v_x=[20.0])
    assert 0 > found.band("understeer_gradient")[0, 0]
    assert not [r for r in found.table().rows if "speed" in r.cells[0]]


def test_what_is_not_defined_is_a_dash():
    rows = {r.cells[0]: r.cells[1] for r in handling(BICYCLE, v_x=[5.0]).table().rows}
    assert rows["yaw-rate peak response time, step"] == "–"


def test_what_is_hardly_known_has_a_band_that_ends():
    curve = linearize(BICYCLE, v_x=20.0).bode("r", "delta")
    lost = replace(curve, magnitude_std=np.full(300, 1e9), phase_std=np.full(300, 1e9))
    bands = [t for t in lost.plot().data if t.fill == "toself"]
    assert len(bands) == 2
    assert bands[0].y[300:][::-1] == pytest.approx(np.exp(1.959964) * curve.magnitude, rel=1e-5)
