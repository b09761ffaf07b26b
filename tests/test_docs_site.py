"""The site: its pages, navigation, links and reference are whole, without building it."""

import inspect
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from docs.site.api import write_pages
from docs.site.described import lacks
from docs.site.gallery import stored, write_gallery
from docs.site.lane_change import PACE, PICTURE, draw
from docs.site.links import broken
from docs.site.notebooks import PAGES as NOTEBOOKS
from docs.site.notebooks import notebook, write_notebooks
from docs.site.pages import MADE, anchors, loose, navigation, written
from docs.site.public import PAGES, members, page_of, public

import slipangle
from slipangle.errors import ParameterError
from slipangle.report.drawing import seen_from_above
from slipangle.report.playback import Playback
from slipangle.report.records import Record
from slipangle.reproduce import find, names

ROOT = Path(__file__).parents[1]


def test_every_page_is_in_the_navigation_once():
    pages = navigation()
    assert len(pages) == len(set(pages))
    assert set(pages) == {*written(), *MADE} - {"index"}


def test_the_navigation_follows_the_work():
    order = ["logs", "choosing-a-model", "driving", "plants", "plots", "export"]
    places = [navigation().index(page) for page in order]
    assert places == sorted(places)


@pytest.mark.parametrize("name", written())
def test_links_of_a_page_lead_to_pages_and_headings(name):
    assert loose(name, written()[name]) == []


def test_a_link_to_a_heading_that_is_not_there_is_found(tmp_path):
    page = tmp_path / "a.md"
    page.write_text("# A title, `x` and [b](a.md)\n[good](#a-title-x-and-b) [bad](#a-title) [none](b.md)\n")
    assert anchors(page.read_text()) == {"a-title-x-and-b"}
    assert loose("a", page) == ["a: no heading #a-title", "a: no file b.md"]


def test_a_built_page_with_a_bad_link_is_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<p id="here"></p><a href="#here"></a><a href="b.html#there"></a><a href="c.html"></a>'
        '<script src="https://cdn.example/x.js"></script><a href="https://example.org"></a>'
    )
    (tmp_path / "b.html").write_text('<a href="a.html#here"></a>')
    assert broken(tmp_path) == [
        "a.html: fetches 'https://cdn.example/x.js' from elsewhere",
        "a.html: no anchor 'b.html#there'",
        "a.html: no file 'c.html'",
    ]


def test_the_reference_has_every_public_name_once(tmp_path):
    write_pages(tmp_path)
    text = "\n".join(path.read_text() for path in tmp_path.glob("*.md"))
    assert [n for n in slipangle.__all__ if len(re.findall(rf"^### sa\.{n}$", text, re.M)) != 1] == []
    shown = re.findall(r"^\.\. auto(?:class|function):: (\S+)$", text, re.M)
    assert sorted(shown) == list(public())
    for full, thing in public().items():
        if inspect.isclass(thing) and members(thing):
            own = ", ".join(members(thing))
            assert f".. autoclass:: {full}\n   :members: {own}\n" in text


def test_each_page_of_the_reference_has_something():
    assert {page_of(thing) for thing in public().values()} == set(PAGES)


REFERENCE = public()


@pytest.mark.parametrize("full", REFERENCE, ids=lambda full: full.removeprefix("slipangle."))
def test_the_reference_says_arguments_units_shapes_and_errors(full):
    """Each argument of a public class, method or function has a meaning, each number a unit, each error a sentence."""
    assert lacks(full, REFERENCE[full]) == []


def test_what_the_reference_lacks_is_found():
    class Poor:
        """A thing."""

        def __init__(self, size: float, other_thing: int) -> None:
            """Of ``size``."""

        def area(self, height_over_ground: float) -> float:
            """How large it is."""
            raise ParameterError("too high")

    Poor.area.__module__ = "slipangle.poor"
    assert lacks("Poor", Poor) == [
        "Poor: argument size is not described",
        "Poor: argument other_thing is not described",
        "Poor.area: argument height_over_ground is not described",
        "Poor.area: no unit of what is returned",
        "Poor.area: ParameterError is not said",
    ]


# ---- the gallery ---------------------------------------------------------------------------------------------------

STORED = sorted(path.stem for path in (ROOT / "docs" / "gallery").glob("*.json"))


def test_the_gallery_has_a_page_for_each_table_and_example(tmp_path):
    write_gallery(tmp_path)
    pages = {path.stem for path in tmp_path.glob("*.md")}
    assert pages == {
        "index",
        *names(),
        *(p.stem for p in (ROOT / "examples").glob("*") if p.suffix in (".py", ".toml")),
    }
    index = (tmp_path / "index.md").read_text()
    assert all(f"({name}.md)" in index for name in pages - {"index"})
    rows = [line for line in index.splitlines() if line.startswith("|")]
    assert {len(re.split(r"(?<!\\)\|", line)) - 2 for line in rows} == {
        2,
        3,
    }  # no bar of a title is taken for a cell's end
    for name in STORED:
        page = (tmp_path / f"{name}.md").read_text()
        assert page.count("\n| ") == 1 + len(stored(name))


@pytest.mark.parametrize("name", STORED)
def test_stored_numbers_are_those_of_the_command(name):
    """What is stored keeps its bounds, and has the published values that the table is compared with."""
    assert name in names()
    records = [Record(**{k: v for k, v in r.items() if k != "name"}) for r in stored(name)]
    assert records
    assert {r["name"] for r in stored(name)} == {name}
    assert [r for r in records if r.holds is False] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["table-8.4", "table-8.5"])
@pytest.mark.filterwarnings("ignore::slipangle.errors.IdentifiabilityWarning")
def test_stored_numbers_are_computed_again(name, real_data):
    """Those of two quick tables; the others are judged by their bounds wherever the command runs."""
    found = find(name).reproduce(lambda share, what: None).records
    before = stored(name)
    assert [(r.row, r.quantity, r.thesis) for r in found] == [(b["row"], b["quantity"], b["thesis"]) for b in before]
    assert [r.here for r in found] == pytest.approx([b["here"] for b in before], rel=1e-3)


# ---- notebooks -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_says_what_its_page_says(name):
    page = written()[name].read_text()
    made = notebook(name)
    cells = {
        kind: ["".join(c["source"]) for c in made["cells"] if c["cell_type"] == kind] for kind in ("code", "markdown")
    }
    assert cells["code"] == [block.strip() for block in re.findall(r"```python\n(.*?)```", page, re.S)]
    assert "".join("".join(cells["markdown"]).split()) == "".join(
        re.sub(r"```python\n.*?```", "", page, flags=re.S).split()
    )
    assert (made["nbformat"], made["nbformat_minor"]) == (4, 5)
    assert len({c["id"] for c in made["cells"]}) == len(made["cells"])


def test_notebooks_are_written_once_each(tmp_path):
    paths = write_notebooks(tmp_path)
    assert len({p.name for p in paths}) == len(NOTEBOOKS)
    assert all(json.loads(p.read_text())["cells"] for p in paths)


def moved(svg, kind):
    """Values of the first animation of a kind, shape (frames, numbers)."""
    parts = svg.iter("{http://www.w3.org/2000/svg}animateTransform")
    values = next(part for part in parts if part.attrib["type"] == kind).attrib["values"]
    return np.array([[float(v) for v in frame.split()] for frame in values.split(";")])


def test_the_picture_moves_as_the_drive_did():
    t = np.linspace(0.0, 2.0, 101)
    X, Y, psi = 10.0 * t, 2.0 * t, np.full(101, 0.2)
    drive = Playback(
        title="drive",
        svg=seen_from_above(X, Y, psi, moving=True, label="A drive: it goes"),
        t=t,
        X=X,
        Y=Y,
        psi=psi,
        said=["" for _ in t],
        horizon=[[x, y, x + 5.0, y + 1.0] for x, y in zip(X, Y, strict=True)],
    )
    svg = ElementTree.fromstring(draw(drive.to_html()))
    ways = moved(svg, "translate")
    assert len(ways) == round(2.0 / PACE)
    np.testing.assert_allclose(np.diff(ways, axis=0), [[10.0 * PACE, -2.0 * PACE]] * (len(ways) - 1), atol=0.02)
    np.testing.assert_allclose(moved(svg, "rotate"), -np.degrees(0.2), atol=0.01)
    with pytest.raises(ValueError, match="no drive plays on the page"):
        draw("<html></html>")


def test_the_first_screen_of_the_readme_moves():
    """Three lanes are entered and left, the middle one 3 m and more beside the others; small enough to load at once."""
    head = "\n".join((ROOT / "README.md").read_text().splitlines()[:12])
    assert f"(docs/{PICTURE.name})" in head
    text = PICTURE.read_text()
    ways = moved(ElementTree.fromstring(text), "translate")
    assert np.ptp(ways[:, 0]) > 150.0
    assert 3.0 < np.ptp(ways[:, 1]) < 5.0
    assert len(text) < 60_000
