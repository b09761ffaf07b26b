"""Figures for papers: matplotlib draws what Plotly shows, inside the figure, with nothing over anything else."""

import re
import sys
from functools import cache

import numpy as np
import plotly.graph_objects as go
import pytest

import slipangle as sa
from slipangle.errors import ConfigError, ParameterError
from slipangle.report import Figure
from slipangle.report.paper_traces import colour, plain
from tests.report.example import example_page

pytest.importorskip("matplotlib")
PARAMS = sa.BicycleParams(mass=1500, inertia_z=2500, wheelbase=2.7, l_f=1.2, C_f=9e4, C_r=1.1e5)
CAR = sa.Bicycle(params=PARAMS, dt=0.02)
GRIP = sa.SaturatingBicycle(params=sa.SaturatingBicycleParams(**vars(PARAMS), mu_f=1.0, mu_r=1.0), dt=0.02)


@cache
def figures():
    """Every kind of the toolbox: those of a page, of linear analysis and of the limit."""
    page = {f"page {k}": f for k, f in enumerate(_inside(example_page()))}
    linear = sa.linearize(CAR, v_x=20.0, outputs=("r", "a_y"))
    return page | {
        "bode": linear.bode("r", "delta").plot(),
        "nyquist": linear.bode("r", "delta").plot(kind="nyquist"),
        "step": linear.step("a_y", "delta").plot(),
        "poles": linear.plot(),
        "handling": sa.handling(CAR, v_x=np.arange(10.0, 45.0, 10.0)).plot("yaw_gain", "damping", "rise_time"),
        "diagram": sa.handling_diagram(GRIP, v_x=25.0).plot(),
        "phase plane": sa.phase_plane(GRIP, v_x=25.0, delta=0.02, points=7, duration=1.0).plot(),
    }


def _inside(page):
    return [b.figure for section in page.sections for b in section.blocks if isinstance(b, Figure)]


NAMES = [f"page {k}" for k in range(7)]
NAMES += ["bode", "nyquist", "step", "poles", "handling", "diagram", "phase plane"]
EACH = pytest.mark.parametrize("name", NAMES)


def test_every_figure_is_looked_at():
    assert list(figures()) == NAMES


@pytest.fixture(scope="module", params=[1, 2], ids=["one column", "two columns"])
def drawn(request):
    return {name: sa.matplotlib_figure(f, columns=request.param) for name, f in figures().items()}


@EACH
def test_everything_that_is_written_is_inside(drawn, name):
    figure = drawn[name]
    figure.draw_without_rendering()
    box = figure.get_tightbbox()
    wide, tall = figure.get_size_inches()
    assert box.x0 > -0.02
    assert box.y0 > -0.02
    assert box.x1 < wide + 0.02
    assert box.y1 < tall + 0.02
    assert (box.x1 - box.x0) * (box.y1 - box.y0) > 0.5 * wide * tall  # and fills it


@EACH
def test_titles_of_panels_stand_apart(drawn, name):
    figure = drawn[name]
    figure.draw_without_rendering()
    boxes = [a.yaxis.label.get_window_extent() for a in figure.axes if a.yaxis.label.get_text()]
    for k, one in enumerate(boxes):
        assert not any(one.overlaps(other) for other in boxes[k + 1 :])
    ticks = [t for a in figure.axes for t in a.get_xticklabels() if t.get_text() and t.get_visible()]
    numbers = [t.get_window_extent() for t in ticks]
    panels = [a.patch.get_window_extent() for a in figure.axes]
    assert not any(p.y0 + 1 < n.y0 and n.y1 < p.y1 - 1 and p.x0 < n.x0 and n.x1 < p.x1 for n in numbers for p in panels)


@EACH
def test_lines_are_those_of_the_figure(drawn, name):
    wanted = [
        t for t in figures()[name].data if t.type == "scatter" and t.mode == "lines" and not t.fill and t.line.width
    ]
    got = [line.get_xydata() for axes in drawn[name].axes for line in axes.lines]
    for trace in wanted:
        points = np.array([np.asarray(trace.x, dtype=float), np.asarray(trace.y, dtype=float)]).T
        assert any(len(g) == len(points) and np.allclose(g, points, equal_nan=True) for g in got)


def test_a_colour_ramp_has_its_scale_beside_the_map(drawn):
    assert any(axes.child_axes for figure in drawn.values() for axes in figure.axes)


def test_markup_becomes_text():
    assert plain("F<sub>x</sub><br><b>5 &lt; 6</b>") == "F$_{\\mathrm{x}}$\n5 < 6"
    assert plain("5 $") == r"5 \$"
    assert colour("rgba(0,114,178,0.2)") == ("#0072b2", 0.2)


def test_what_no_figure_of_the_toolbox_has_is_refused():
    with pytest.raises(ParameterError, match="a trace of kind 'pie'; expected scatter, bar, box or heatmap"):
        sa.matplotlib_figure(go.Figure(go.Pie(values=[1.0, 2.0])))


def test_without_matplotlib_one_sentence_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ConfigError, match=r"a figure by matplotlib needs matplotlib.*pip install 'slipangle\[plot\]'"):
        sa.save_figure(figures()["step"], tmp_path / "f.pdf", drawn_by="matplotlib")
    assert list(tmp_path.iterdir()) == []


def test_files_have_text_as_text_and_the_size_that_was_asked_for(tmp_path):
    svg = sa.save_figure(figures()["step"], tmp_path / "f.svg").read_text()
    assert "time t [s]" in svg
    assert re.search(r'width="249.4\d*pt"', svg)  # 88 mm
    pdf = sa.save_figure(figures()["step"], tmp_path / "f.pdf", columns=2, height=60.0).read_bytes()
    box = re.search(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", pdf)
    assert [float(v) / 72 * 25.4 for v in box.groups()] == pytest.approx([181.0, 60.0], abs=0.1)
    assert b"/Type3" not in pdf  # letters are letters of a font, which journals ask for
    again = sa.save_figure(figures()["step"], tmp_path / "g.svg").read_text()
    assert again == svg  # nothing of the day or the run


def test_the_figure_given_stays_as_it_is():
    before = figures()["bode"].to_json()
    sa.matplotlib_figure(figures()["bode"])
    assert figures()["bode"].to_json() == before
