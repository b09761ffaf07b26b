"""Figures as files: sizes of a journal's columns, sentences where no browser is, vector graphics where one is."""

import re
import shutil
import stat

import numpy as np
import pytest

import slipangle as sa
from slipangle.errors import ConfigError, ParameterError
from slipangle.report.figure_file import sized
from slipangle.report.paper import size_of
from slipangle.report.style import BLUE, axes, line, new_figure

BROWSER = pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium on this machine")


def drawn():
    figure = new_figure(300)
    line(figure, np.arange(5.0), np.arange(5.0) ** 2, BLUE, name="a < b")
    return axes(figure, "time t [s]", "yaw rate r [deg/s]")


def test_the_size_is_that_of_the_column_and_the_figure_stays():
    figure = drawn()
    before = figure.to_dict()
    small = sized(figure, 333, 222, 8.0)
    assert (small.layout.width, small.layout.height) == (333, 222)
    assert small.layout.font.size == pytest.approx(8 / 72 * 96)
    assert figure.to_dict() == before


@pytest.mark.parametrize(
    ("name", "given", "said"),
    [
        ("f.png", {}, r"expected a name that ends in .svg, .pdf or .html"),
        ("f.svg", {"columns": 3}, "columns is 3; expected 1 or 2"),
        ("f.svg", {"height": 2.0}, "height is 2 mm"),
        ("f.svg", {"font": 90.0}, "font 90 pt"),
        ("f.svg", {"drawn_by": "hand"}, "drawn_by is 'hand'; expected 'matplotlib' or 'browser'"),
    ],
)
def test_bad_input_gets_a_sentence(tmp_path, name, given, said):
    with pytest.raises(ParameterError, match=said):
        sa.save_figure(drawn(), tmp_path / name, **given)
    assert list(tmp_path.iterdir()) == []


def test_more_panels_than_a_page_holds_get_a_sentence(tmp_path):
    """Nobody gave a height, so none is found fault with: channels are too many."""
    names = [f"c{k}" for k in range(60)]
    data = sa.Dataset.from_arrays({}, dict.fromkeys(names, np.arange(5.0)), 0.1)
    with pytest.raises(ParameterError, match=r"the figure has 60 panels, 1800 mm .* plot fewer channels"):
        sa.save_figure(data.plot(), tmp_path / "f.svg")
    assert size_of(data.plot(), 1, 900.0, 8.0) == (88.0, 900.0)
    assert size_of(data.plot(*names[:9]), 1, None, 8.0) == (88.0, 270.0)


def test_without_a_browser_one_sentence_names_it(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("SLIPANGLE_BROWSER", raising=False)
    with pytest.raises(ConfigError, match="need Chromium or Chrome, which is not installed"):
        sa.save_figure(drawn(), tmp_path / "f.pdf", drawn_by="browser")
    monkeypatch.setenv("SLIPANGLE_BROWSER", "netscape")
    with pytest.raises(ConfigError, match="need the browser netscape"):
        sa.save_figure(drawn(), tmp_path / "f.svg", drawn_by="browser")


@pytest.mark.parametrize(("script", "said"), [("exit 1", "failed"), ("echo nothing", "drew no figure")])
def test_a_browser_that_fails_gets_a_sentence(tmp_path, monkeypatch, script, said):
    broken = tmp_path / "broken"
    broken.write_text(f"#!/bin/sh\n{script}\n")
    broken.chmod(broken.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("SLIPANGLE_BROWSER", str(broken))
    with pytest.raises(ConfigError, match=said):
        sa.save_figure(drawn(), tmp_path / "f.svg", drawn_by="browser")
    assert not (tmp_path / "f.svg").exists()


def test_html_needs_no_browser(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    text = sa.save_figure(drawn(), tmp_path / "f.html", columns=2).read_text()
    assert "684" in text  # px, of 181 mm


@pytest.mark.slow
@BROWSER
def test_svg_and_pdf_have_text_as_text_and_the_size_that_was_asked_for(tmp_path):
    svg = sa.save_figure(drawn(), tmp_path / "f.svg", drawn_by="browser").read_text()
    assert re.search(r'width="333" height="222"', svg)
    assert "yaw rate r [deg/s]" in svg
    assert "<script" not in svg
    pdf = sa.save_figure(drawn(), tmp_path / "new" / "f.pdf", columns=2, height=60.0, drawn_by="browser").read_bytes()
    assert pdf.startswith(b"%PDF")
    box = re.search(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert [float(v) / 72 * 25.4 for v in box.groups()] == pytest.approx([181.0, 60.0], abs=0.5)
    assert pdf.count(b"/Type /Page\n") == 1
