"""The page: self-contained, escaped, complete, light."""

from __future__ import annotations

import base64
import gzip
import html.parser
import json
import re

import numpy as np
import pytest

from slipangle.errors import ParameterError, WriteError
from slipangle.report import Figure, Number, Page, Section, Text, Verdict
from slipangle.report.page import figures
from slipangle.report.style import dark_map, new_figure
from tests.report.example import NASTY, example_page

VOID = {"meta", "br", "hr", "img", "input", "link"}


class Outline(html.parser.HTMLParser):
    """Elements with attributes, text outside of scripts, and whether every tag is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text: list[str] = []
        self.scripts: list[tuple[dict[str, str | None], str]] = []
        self.unbalanced: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append((dict(attrs), ""))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.unbalanced.append(tag)

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            attrs, text = self.scripts[-1]
            self.scripts[-1] = (attrs, text + data)
        elif not self.open or self.open[-1] != "style":
            self.text.append(data)


@pytest.fixture(scope="module")
def page():
    return example_page()


@pytest.fixture(scope="module")
def text(page):
    return page.to_html()


def read(text):
    parser = Outline()
    parser.feed(text)
    parser.close()
    return parser


@pytest.fixture(scope="module")
def outline(text):
    return read(text)


@pytest.fixture(scope="module")
def specs(outline):
    found = {}
    for attrs, body in outline.scripts:
        if attrs.get("type") == "application/json":
            found[attrs["id"]] = json.loads(body)
    return found


def test_every_tag_is_closed(outline):
    assert outline.open == []
    assert outline.unbalanced == []


def test_nothing_is_loaded_from_elsewhere(outline, text):
    for tag, attrs in outline.elements:
        for key in ("src", "href", "data", "action", "poster", "srcset"):
            value = attrs.get(key)
            assert value is None or value.startswith("#"), (tag, key, value)
        assert tag not in {"link", "iframe", "object", "embed", "base", "form", "img"}
    style = "".join(re.findall(r"<style>(.*?)</style>", text, re.S))
    assert "@import" not in style
    assert "url(" not in style


def test_the_browser_is_told_to_refuse_requests(outline):
    [policy] = [a["content"] for t, a in outline.elements if a.get("http-equiv") == "Content-Security-Policy"]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert not re.search(r"https?:|\*|unsafe-eval", policy)
    assert "connect-src" not in rules  # falls back to default-src


def test_plotly_is_there_once_and_the_page_is_light(text, outline):
    [library] = [body for attrs, body in outline.scripts if attrs.get("id") == "plotly"]
    script = gzip.decompress(base64.b64decode(library)).decode()
    assert script.count("plotly.js v") == 1
    assert "</script" not in library
    assert len(text.encode()) < 1.5e6


def test_a_page_without_figures_carries_no_library():
    text = Page(title="t", sections=(Section(title="s", blocks=(Text(text="p"),)),)).to_html()
    assert 'id="plotly"' not in text


def test_the_command_of_the_page_stands_once_to_be_copied():
    block = Figure(title="f", figure=new_figure(200), command="slipangle demo")
    other = Figure(title="g", figure=new_figure(200), command="slipangle list")
    page = Page(title="t", sections=(Section(title="s", blocks=(block, other)),), command="slipangle demo")
    text = page.to_html()
    assert text.count("slipangle demo") == 1
    assert '<code id="again">slipangle demo</code>' in text
    assert text.count("slipangle list") == 1


def test_a_verdict_links_to_its_evidence():
    block = Verdict(title="t", sentence="s", tone="good", evidence=("Data", "Not on this page"))
    text = Page(
        title="t", sections=(Section(title="A", blocks=(block,)), Section(title="Data", blocks=(Text(text="p"),)))
    ).to_html()
    assert '<a href="#data">data</a>' in text
    assert "not on this page" not in text


def test_figures_are_reached_by_keyboard_and_say_what_they_show(outline):
    plots = [a for _, a in outline.elements if a.get("class") == "plot"]
    assert plots
    assert all(a["tabindex"] == "0" and a["aria-label"] for a in plots)
    [skip] = [a for _, a in outline.elements if a.get("class") == "skip"]
    assert skip["href"][1:] in {a.get("id") for _, a in outline.elements}


def test_ids_are_unique_and_links_have_targets(outline):
    ids = [a["id"] for _, a in outline.elements if "id" in a]
    assert len(ids) == len(set(ids))
    links = [a["href"][1:] for t, a in outline.elements if t == "a"]
    assert links
    assert set(links) <= set(ids)


def test_same_titles_get_different_ids():
    twice = Page(
        title="t",
        sections=tuple(
            Section(title="Same", blocks=(Figure(title="Same", figure=new_figure(200)),) * 2) for _ in range(2)
        ),
    )
    ids = [a["id"] for _, a in read(twice.to_html()).elements if "id" in a]  # not those in the text of plotly.js
    assert len(ids) == len(set(ids)) == 2 + 2 + 2 * 4


def test_user_text_is_escaped_everywhere(text, outline):
    assert "<script>alert" not in text
    assert text.count("<script") == len(outline.scripts)
    assert any(NASTY in part for part in outline.text)


def test_labels_in_figures_are_escaped_for_plotly(specs):
    names = [trace.get("name", "") for key, s in specs.items() if key != "figure-settings" for trace in s["data"]]
    nasty = [n for n in names if "alert" in n]
    assert nasty
    assert not any("<" in n for n in nasty)


def test_every_axis_has_a_title_with_its_unit(page):
    all_figures = [f for s in page.sections for f in figures(s.blocks)]
    assert len(all_figures) == 14
    for block in all_figures:
        layout = block.figure.to_dict()["layout"]
        axes = {k: v for k, v in layout.items() if re.fullmatch(r"[xy]axis\d*", k)}
        used = {"xaxis", "yaxis"} | {(t.yaxis or "y").replace("y", "yaxis") for t in block.figure.data}
        assert used <= set(axes), block.title
        for name, axis in axes.items():
            if axis.get("visible") is False:
                continue
            if isinstance(axis.get("ticktext", [None])[0], str) and axis["title"]["text"] == "":
                assert not re.fullmatch(r"[-\d.e]+", axis["ticktext"][0])  # names, not numbers
                continue
            if name == "xaxis" and not axis["title"]["text"]:  # of a map with a colour bar, written below it
                assert "X [m]" in [a.get("text") for a in layout["annotations"]]
                continue
            assert re.search(r"\S.*\[[^\]]+\]", axis["title"]["text"].replace("<br>", " ")), (block.title, name)


def test_figures_share_one_template(specs):
    assert "template" in specs["figure-settings"]
    assert all("template" not in s["layout"] for k, s in specs.items() if k != "figure-settings")


def test_every_colour_of_every_figure_has_a_dark_counterpart(specs):
    known = dark_map()
    for key, spec in specs.items():
        body = json.dumps(spec if key != "figure-settings" else spec["template"])
        for colour in re.findall(r"#[0-9a-fA-F]{6}\b", body):
            assert colour in known, (key, colour)
        for colour in re.findall(r"rgba\([\d,]+,(?=[\d.]+\))", body):
            assert colour in known, (key, colour)


def test_dark_colours_are_no_light_colours():
    known = dark_map()
    assert not set(known) & set(known.values())


def test_verdict_comes_first_and_says_its_tone_in_words(text):
    first = text.index('class="verdict"')
    assert first < text.index('class="plot"')
    assert '<span class="fair">fair</span>' in text
    assert "79.13" in text
    assert "72.87\u00a0% <span>thesis</span>" in text


def test_numbers_keep_to_their_units(text):
    assert "165\u00a0s" in text


def test_write_is_whole_or_not_at_all(tmp_path, page):
    target = page.write(tmp_path / "new" / "page.html")
    assert target.read_text(encoding="utf-8").rstrip().endswith("</html>")
    assert [p.name for p in target.parent.iterdir()] == ["page.html"]
    blocked = tmp_path / "file"
    blocked.write_text("x")
    with pytest.raises(WriteError, match="cannot be written"):
        page.write(blocked / "page.html")


def test_a_page_without_sections_is_refused():
    with pytest.raises(ParameterError, match="no section"):
        Page(title="t", sections=()).to_html()


def test_an_unknown_block_is_refused():
    page = Page(title="t", sections=(Section(title="s", blocks=("just text",)),))  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="holds a str; expected Verdict"):
        page.to_html()


@pytest.mark.parametrize(
    ("value", "unit", "reference", "expected"),
    [
        (0.04123, "rad/s", 0.054, ['0.04123<span class="unit">rad/s</span>', "0.054\u00a0rad/s <span>thesis</span>"]),
        (float("nan"), "%", None, ['n/a<span class="unit">%</span>']),
        ("none", "", "<1>", ["none</dd>", "&lt;1&gt; <span>thesis"]),
        (np.float64(2.0), "-", np.float64(1.0), ["2.000</dd>", ">1 <span>"]),
    ],
)
def test_numbers(value, unit, reference, expected):
    block = Verdict(
        title="t", sentence="s", tone="good", numbers=(Number(label="l", value=value, unit=unit, reference=reference),)
    )
    text = Page(title="t", sections=(Section(title="s", blocks=(block, Text(text="p"))),)).to_html()
    for part in expected:
        assert part in text


def test_a_figure_of_any_origin_cannot_end_its_script():
    figure = new_figure(200)
    figure.add_scatter(x=[1], y=[2], text=["</script><script>alert(1)</script>"])
    text = Page(title="t", sections=(Section(title="s", blocks=(Figure(title="f", figure=figure),)),)).to_html()
    parser = read(text)
    assert "alert(1)" not in "".join(parser.text)
    [spec] = [json.loads(body) for attrs, body in parser.scripts if attrs.get("id") == "figure-f-data"]
    assert spec["data"][0]["text"] == ["</script><script>alert(1)</script>"]


def test_evenly_spaced_times_are_said_by_begin_and_step():
    """A line over 400 s at 50 Hz; one with a gap, and a short one, keep their abscissae."""
    t = 0.02 * np.arange(20_000)
    even, short = new_figure(300), new_figure(300)
    even.add_scatter(x=t.astype(np.float32) + np.float32(105.0), y=np.sin(t))
    even.add_scatter(x=np.where(t < 7, t, t + 3), y=np.sin(t))
    short.add_scatter(x=t[:9], y=t[:9])
    blocks = Figure(title="even", figure=even), Figure(title="short", figure=short)
    text = Page(title="t", sections=(Section(title="s", blocks=blocks),)).to_html()
    first, second, third = (
        trace
        for name in ("even", "short")
        for trace in json.loads(re.search(rf'id="figure-{name}-data">(.*?)</script>', text, re.S)[1])["data"]
    )
    assert "x" not in first
    assert (first["x0"], first["dx"]) == (105.0, pytest.approx(0.02, rel=1e-5))
    assert first["x0"] + first["dx"] * (len(t) - 1) == pytest.approx(105.0 + t[-1], abs=1e-4)
    assert "x0" not in second
    assert "x0" not in third
    assert len(even.data[0].x) == len(t)  # the figure itself is as it was
