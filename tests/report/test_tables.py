"""Tables say the same on the terminal and on the page."""

from __future__ import annotations

import dataclasses
import io
import json

import numpy as np
import pytest
from rich.console import Console

from slipangle.errors import ParameterError
from slipangle.models.model import FitInfo
from slipangle.report import (
    Heading,
    Record,
    Row,
    ScoreRow,
    Table,
    correlation_table,
    parameter_table,
    record_table,
    score_table,
)
from slipangle.report.parameters import doubt
from slipangle.report.tables import number
from tests.report.example import NASTY, fit_info

RECORD = Record(
    row="table 8.2, M1", quantity="fit of r [%]", thesis=72.87, here=79.134, bound=">= 79", holds=True, note="a <note>"
)


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [
        (0.0, 4, "0"),
        (-0.0, 4, "0"),
        (999.96, 4, "1 000"),
        (99.999, 4, "100.0"),
        (0.09999, 3, "0.100"),
        (123456.0, 4, "123 500"),
        (1234567890.0, 4, "1.235e+09"),
        (1e-5, 3, "1.00e-05"),
        (-0.0021, 3, "-0.00210"),
        (float("inf"), 4, "∞"),
        (float("-inf"), 4, "-∞"),
        (float("nan"), 4, "n/a"),
        (12345, 4, "12 345"),
        (np.int64(7), 4, "7"),
        (np.bool_(False), 4, "no"),
        (True, 4, "yes"),
        (None, 4, "–"),
        ("text", 4, "text"),
    ],
)
def test_number(value, digits, expected):
    assert number(value, digits) == expected


@pytest.mark.parametrize("digits", [2, 3, 4, 6])
@pytest.mark.parametrize("exponent", range(-3, 8))
def test_number_is_right_to_its_digits(digits, exponent):
    for value in np.random.default_rng(exponent + 10).uniform(1, 10, 20) * 10.0**exponent:
        shown = float(number(float(value), digits).replace(" ", ""))
        assert abs(shown - value) <= 0.5001 * 10.0 ** (exponent + 1 - digits)


def test_text_is_aligned_and_free_of_markup_and_colour():
    table = Table(
        title="[bold]T[/bold]",
        columns=(Heading("name", words=True), Heading("value", "m/s2")),
        rows=(Row(("[red]a[/red]", 1.5)), Row(("b", 1234.0), note="remark", command="do it")),
        warnings=("careful",),
        command="do all",
    )
    text = table.to_text()
    lines = text.splitlines()
    assert "\x1b" not in text
    assert "[bold]T[/bold]" in text
    head, a, b = (next(line for line in lines if line.strip().startswith(s)) for s in ("name", "[red]", "b"))
    assert head.endswith("value [m/s²]")
    assert a.endswith("1.500")
    assert b.endswith("1 234")
    assert len(head) == len(a) == len(b)
    assert lines[-4:] == ["warning: careful", "b: remark", "$ do all", "$ do it"]


def test_text_fits_the_width():
    table = Table(title="t", columns=(Heading("c", words=True), Heading("v")), rows=(Row(("word " * 60, 1.0)),))
    assert max(len(line) for line in table.to_text(width=60).splitlines()) <= 60


def test_rich_takes_user_text_literally():
    console = Console(file=io.StringIO(), width=120, color_system=None)
    console.print(record_table([dataclasses.replace(RECORD, row="[/] :car:")]).to_rich())
    assert "[/] :car:" in console.file.getvalue()


def test_html_is_escaped_and_marks_tones():
    row = ScoreRow(model=NASTY, channel="r", unit="rad/s", kind="free run", fit=1, vaf=2, r2=3, rmse=4, tone="poor")
    text = score_table([row]).to_html()
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert 'class="mark poor"' in text
    assert "RMSE [rad/s]" in text


def test_scores_of_different_units_carry_them_in_the_cell():
    rows = [
        ScoreRow(model="m", channel=c, unit=u, kind="free run", fit=90.0, vaf=99.0, r2=0.99, rmse=0.5)
        for c, u in (("r", "rad/s"), ("v_y", "m/s"))
    ]
    table = score_table(rows)
    assert table.columns[-1].heading == "RMSE"
    assert [t[-1] for t in table.texts()] == ["0.500 rad/s", "0.500 m/s"]


def test_cells_must_match_columns():
    with pytest.raises(ParameterError, match="row 1 of the table 't' has 1 cells; expected 2"):
        Table(title="t", columns=(Heading("a"), Heading("b")), rows=(Row((1, 2)), Row((1,))))


def test_record_to_dict_is_valid_json():
    record = dataclasses.replace(RECORD, thesis=np.float64(np.nan), here=np.float32(2.0), holds=np.bool_(False))
    text = json.dumps(record.to_dict(), allow_nan=False)
    assert json.loads(text) == {
        "row": "table 8.2, M1",
        "quantity": "fit of r [%]",
        "thesis": None,
        "here": 2.0,
        "bound": ">= 79",
        "holds": False,
        "note": "a <note>",
    }


def test_record_table_shows_what_does_not_hold():
    table = record_table([RECORD, dataclasses.replace(RECORD, holds=False, thesis=None)], command="again")
    assert [r.tone for r in table.rows] == ["good", "poor"]
    assert table.texts()[0] == ["table 8.2, M1", "fit of r [%]", "72.87", "79.13", ">= 79", "yes"]
    assert table.texts()[1][2] == "–"
    assert "$ again" in table.to_text()


def test_parameter_table_judges_by_interval():
    table = parameter_table(fit_info(), references={"C_f": 80000.0})
    assert [r.tone for r in table.rows] == ["good", "good", "fair", "good", "fair", "poor"]
    assert table.warnings == fit_info().warnings
    # 2 % standard deviation: half width 3 184, so the estimate is given to hundreds
    assert table.texts()[0] == ["C_f", "N/rad", "81 200", "78 100", "84 400", "3.9", "80 000"]
    assert table.texts()[1][-1] == "–"


def test_angles_are_read_in_degrees_and_references_with_them():
    table = parameter_table(fit_info(), references={"steering_offset": -0.002})
    row = table.texts()[4]
    assert row[:2] == ["steering_offset", "deg"]
    assert [float(v) for v in row[2:5]] == pytest.approx(
        np.degrees([-0.0021, -0.0021 * 1.392, -0.0021 * 0.608]), rel=0.01
    )
    assert float(row[-1]) == pytest.approx(np.degrees(-0.002), rel=1e-4)


def test_what_may_be_zero_is_not_called_undetermined():
    info = dataclasses.replace(fit_info(weak=False), covariance=np.diag((2 * fit_info().values) ** 2))
    assert [r.tone for r in parameter_table(info).rows] == ["poor", "poor", "poor", "poor", "fair", "poor"]
    assert doubt(info, 4, 0.1) == "may be 0"
    assert doubt(info, 4, np.nan) == "these data do not determine it"


def test_correlation_table_says_which_parameters_replace_each_other():
    names = ("a", "b", "c")
    correlation = np.array([[1.0, 0.98, 0.1], [0.98, 1.0, 0.12], [0.1, 0.12, 1.0]])
    std = np.array([2.0, 300.0, 0.01])
    info = FitInfo(
        names=names,
        values=np.ones(3),
        covariance=correlation * np.outer(std, std),
        noise_std=np.ones(1),
        n_samples=9,
    )
    table = correlation_table(info)
    assert [r.tone for r in table.rows] == ["poor", "poor", "good"]
    assert table.texts()[0] == ["a", "1.00", "0.98", "0.10"]
    assert "of a and b" in table.caption
    lengths = np.sqrt(np.diag(np.linalg.inv(correlation)))
    values = np.linalg.eigvalsh(np.linalg.inv(correlation) / np.outer(lengths, lengths))
    assert info.condition == pytest.approx(np.sqrt(values[-1] / values[0]), rel=1e-9)
    assert f"number {info.condition:.3g}" in table.caption
    assert [p[:2] for p in info.correlated(0.95)] == [("a", "b")]
    lost = dataclasses.replace(info, covariance=np.full((3, 3), np.nan))
    assert np.isinf(lost.condition)
    assert {r.tone for r in correlation_table(lost).rows} == {"poor"}


def test_parameter_table_without_covariance_or_units():
    info = dataclasses.replace(fit_info(weak=False), covariance=np.full((6, 6), np.nan), units=())
    table = parameter_table(info)
    assert {r.tone for r in table.rows} == {"poor"}
    assert all(t[1] == "-" and t[3] == "n/a" for t in table.texts())


def test_warnings_and_notes_are_in_every_form_of_a_table():
    """A file for a report or a paper must not be silent about what the terminal and the page say."""
    rows = Row(("C_f", 1.0)), Row(("C_r", 2.0), note="fixed\nby hand")
    made = Table(title="T", columns=(Heading("name"), Heading("x")), rows=rows, warnings=("C_f is open,\n5 % & more",))
    for text in (made.to_text(), made.to_markdown(), made.to_latex()):
        assert "warning: C_f is open, 5 % & more" in text
        assert "C_r: fixed by hand" in text
    assert made.to_markdown().endswith("\n\nwarning: C_f is open, 5 % & more\n\nC_r: fixed by hand\n")
    printed = [line for line in made.to_latex().splitlines() if not line.startswith("%")]
    assert printed[0] == r"\begin{table}"
    assert "open" not in "".join(printed)
