"""The part of plotly.js that a page carries: much less than the whole, which is taken where it is not as expected."""

from __future__ import annotations

import re

import pytest
from plotly.offline import get_plotlyjs

from slipangle.report import Figure, Page, Section
from slipangle.report.bundle import bundle, smaller
from slipangle.report.style import line, new_figure
from tests.report.browser import BROWSER, Browser
from tests.report.example import example_page

USED = frozenset({"scatter", "bar", "box"})


def test_it_is_a_part_of_plotly_with_what_was_asked_for():
    whole, part = get_plotlyjs(), bundle(USED)
    assert 3e5 < len(part) < 0.35 * len(whole)
    assert part.startswith(whole[:100])
    assert part.endswith(whole[-100:])
    assert 'moduleType:"trace",name:"bar"' in part
    assert 'moduleType:"trace",name:"scatter"' in part
    assert 'moduleType:"trace",name:"mesh3d"' not in part


def test_every_module_that_is_asked_for_is_there():
    part = bundle(USED)
    defined = re.compile(r"var ([\w$]+)=[\w$]+\((?:\([\w$,]*\)|[\w$]+)=>\{").findall
    gone = set(defined(get_plotlyjs())) - set(defined(part))
    assert len(gone) > 300
    asked = set(re.findall(r"([\w$]+)\(\)", part))
    assert gone & asked == set()


@pytest.mark.parametrize("change", ["", "nonsense", "no register"])
def test_a_file_that_is_not_as_expected_is_taken_whole(change):
    source = {"": get_plotlyjs(), "nonsense": "var a=1;", "no register": get_plotlyjs().replace(".register([", ".r([")}
    kinds = USED if change else frozenset({"a kind that nobody draws"})
    assert smaller(source[change], kinds) == ""
    assert bundle(frozenset({"a kind that nobody draws"})) == get_plotlyjs()


@pytest.mark.slow
@BROWSER
@pytest.mark.parametrize("which", ["example", "heatmap"])
def test_a_browser_draws_every_figure_and_says_nothing(tmp_path, which):
    if which == "example":
        page = example_page()
    else:
        figure = new_figure(300)
        figure.add_heatmap(z=[[1, 2], [3, 4]])
        line(figure, [0, 1], [0, 1], _ink())
        page = Page(title="t", sections=(Section(title="s", blocks=(Figure(title="f", figure=figure),)),))
    path = page.write(tmp_path / "page.html")
    with Browser(tmp_path / "profile") as browser:
        browser.open(path)
        count = browser.run("document.querySelectorAll('.plot').length")
        assert count > 0
        for k in range(count):
            browser.run(f"document.querySelectorAll('.plot')[{k}].scrollIntoView()")
            browser.wait(f"document.querySelectorAll('.plot')[{k}].querySelector('svg.main-svg') !== null")
        assert browser.console == []


def _ink():
    from slipangle.report.style import INK

    return INK
