"""Pages in a real browser, by its DevTools protocol: drives play, the reader drives, the console stays clean."""

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Channel
from slipangle.report import Figure, Page, Section, Signal, Text, path_map, signals
from slipangle.report.drawing import seen_from_above
from slipangle.report.page import figures
from slipangle.report.playback import Beside, LiveDrive, Playback, Slider
from slipangle.report.robust import CHANGES, shares_by_change
from slipangle.simulate.loop import closed_loop
from slipangle.simulate.trials import Trials
from tests.export.test_live import CASES, loop
from tests.export.tools import needs
from tests.report.browser import BROWSER, Browser
from tests.report.example import example_page

pytestmark = [pytest.mark.slow, BROWSER]

COMMANDS = """(async () => {
  const bytes = Uint8Array.from(atob(document.querySelector(".program").textContent), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const program = (await WebAssembly.instantiate(await new Response(stream).arrayBuffer(), {})).instance;
  const e = program.exports;
  e._initialize();
  return CASES.map((settings) => {
    new Float64Array(e.memory.buffer, e.live_settings(), settings.length).set(settings);
    e.live_begin();
    let end = 0;
    while (!end) { e.live_plan(); end = e.live_go(); }
    return Array.from(new Float64Array(e.memory.buffer, e.live_commands(), e.live_plans()));
  });
})()"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("browser")) as opened:
        yield opened


def drive(live=None):
    t = 0.05 * np.arange(21)
    X = np.linspace(0.0, 20.0, 21)
    psi = np.full(21, np.arctan(0.5))
    svg = seen_from_above(X, 0.5 * X, psi, moving=True)
    return Playback(
        title="A drive",
        svg=svg,
        t=t,
        X=X,
        Y=0.5 * X,
        psi=psi,
        said=[f"frame {k}" for k in range(21)],
        horizon=[[x, 0.5 * x, x + 2.0, 0.5 * x + 1.0] for x in X],
        steering=10 * np.sin(t),
        limit=20.0,
        axles=[[0.1, 0.5, -0.1, 0.4]] * 21,
        beside=Beside(label="another", t=t, X=X, Y=0.4 * X, psi=psi),
        live=live,
    )


def write(folder, *blocks):
    return Page(title="t", sections=(Section(title="s", blocks=blocks),)).write(folder / "page.html")


@pytest.fixture(scope="module")
def live_page(tmp_path_factory):
    needs("zig")
    live = loop()
    sliders = [Slider(label=s.name, value=s.value, low=s.low, high=s.high) for s in live.settings]
    states = live.mpc.model.states
    place = len(states), live.mpc.horizon + 1, states.index("X"), states.index("Y")
    block = drive(LiveDrive(program=live.wasm(), sliders=sliders, row=live.row, dt=0.05, state=place))
    return live, write(tmp_path_factory.mktemp("live"), block)


def places(browser):
    return [
        float(v)
        for v in re.findall(r"-?[\d.]+", browser.run("document.querySelector('.now').getAttribute('transform')"))
    ]


def test_slider_keys_and_button_move_the_car(browser, tmp_path):
    browser.console.clear()
    browser.open(write(tmp_path, drive()))
    first = places(browser)
    browser.run("document.querySelector('.controls input').focus()")
    for _ in range(7):
        browser.press("ArrowRight", 39)
    assert browser.run("document.querySelector('.controls output').textContent") == "0.35 s: frame 7"
    moved = places(browser)
    assert np.subtract(moved, first) == pytest.approx([7.0, -3.5, 0.0], abs=0.02)
    other = browser.run("document.querySelector('.other').getAttribute('transform')")
    assert float(re.findall(r"-?[\d.]+", other)[1]) == pytest.approx(moved[1] + 0.7, abs=0.02)
    dot = browser.run("document.querySelector('.dot').getAttribute('transform')")
    assert dot == "translate(-0.5 -0.1)"  # to the left, forward
    browser.run("document.querySelector('.play').click()")
    browser.wait("document.querySelector('.controls output').textContent.includes('frame 20')")
    assert browser.run("document.querySelector('.play').textContent") == "Play"
    assert browser.console == []


SEEN = """(() => {
  const drawing = document.querySelector(".playback svg.drawing"), car = drawing.querySelector(".now");
  const [frame, at] = [drawing, car].map((e) => e.getBoundingClientRect());
  return [drawing.getAttribute("viewBox").split(" ").map(Number), at.left - frame.left, frame.right - at.right,
    at.width, frame.height];
})()"""


def test_a_narrow_screen_follows_the_car(browser, tmp_path):
    """True scale on a phone: the car is of a size to be seen, and in the picture from its start to its end."""
    X = np.linspace(0.0, 200.0, 21)
    flat = np.zeros(21)
    svg = seen_from_above(X, flat, flat, moving=True)
    long = replace(drive(), svg=svg, X=X, Y=flat, psi=flat, beside=None, horizon=[[x, 0.0, x + 9.0, 0.0] for x in X])
    page = write(tmp_path, long)
    browser.open(page, width=390)
    begins = []
    for k in (0, 7, 13, 20):
        browser.run(
            f"(() => {{ const i = document.querySelector('.controls input'); i.value = {k};"
            " i.dispatchEvent(new Event('input')); })()"
        )
        (begin, _, seen, _), left, right, length, height = browser.run(SEEN)
        assert left > -1
        assert right > -1
        assert length > 15
        assert height == pytest.approx(60, abs=1)
        assert seen < 60
        begins.append(begin)
    assert begins == sorted(begins)
    assert begins[0] == 0
    assert begins[-1] > 100
    browser.run("window.dispatchEvent(new Event('beforeprint'))")
    assert browser.run(SEEN)[0][2] > 200
    browser.run("window.dispatchEvent(new Event('afterprint'))")
    assert browser.run(SEEN)[0][2] < 60
    wide = write(tmp_path, drive())
    browser.open(wide, width=390)
    assert browser.run(SEEN)[0][0] == 0  # high enough as it is
    assert browser.run(SEEN)[4] > 60


def test_no_script_runs_but_the_page_s_own(browser, tmp_path):
    page = write(tmp_path, drive())
    page.write_text(page.read_text().replace("</body>", "<script>document.title = 'changed'</script></body>"))
    browser.console.clear()
    browser.open(page)
    assert browser.run("document.title") == "t"
    assert any("Content Security Policy" in line for line in browser.console)
    browser.console.clear()


def test_the_reader_drives(browser, live_page):
    live, page = live_page
    browser.console.clear()
    browser.open(page)
    browser.run("document.querySelector('summary').click()")  # before or after the program is there
    browser.wait("!document.querySelector('.live').hidden")
    browser.wait("document.querySelector('.outcome').textContent !== ''")
    said = browser.run("document.querySelector('.outcome').textContent")
    assert re.search(r"Solver on your machine: [\d.]+ ms a plan", said)
    before = browser.run("document.querySelector('.way').getAttribute('d')")
    title = "document.querySelector('.playback h3').textContent"
    jobs = browser.run(title)
    browser.run(
        "(() => { const i = document.querySelector('[data-at=\"0\"]'); i.value = 150;"
        " i.dispatchEvent(new Event('input')); })()"
    )
    browser.wait("document.querySelector('.playback').classList.contains('driven')")
    pace = 0.6 + 0.75 * (1.6 - 0.6)
    run = closed_loop(**live.loop(pace=pace))
    said = browser.run("document.querySelector('.outcome').textContent")
    assert said.startswith(f"{100 * run.rmse('y'):.1f} cm (RMS)")
    assert browser.run("document.querySelector('.way').getAttribute('d')") != before
    assert browser.run(title) == "Your drive, seen from above"
    browser.run("document.querySelector('.reset').click()")
    rmse = 100 * closed_loop(**live.loop()).rmse("y")
    browser.wait(f"document.querySelector('.outcome').textContent.startsWith('{rmse:.1f} cm')")
    assert browser.run(title) == jobs
    assert browser.console == []
    assert all(url.startswith(("file:", "blob:")) for url in browser.requests)


def test_commands_in_the_browser_are_those_of_python(browser, live_page):
    live, page = live_page
    browser.open(page)
    names = [s.name.replace(" ", "_") for s in live.settings]
    values = [[case.get(n, s.value) for n, s in zip(names, live.settings, strict=True)] for case in CASES]
    answers = browser.run(COMMANDS.replace("CASES", json.dumps(values)))
    for case, commands in zip(CASES, answers, strict=True):
        wanted = [float(p.command[0]) for p in closed_loop(**live.loop(**case)).plans]
        assert np.abs(np.subtract(commands, wanted)).max() < 1e-9, case


def test_without_webassembly_the_recorded_drive_plays(browser, live_page, tmp_path):
    _, page = live_page
    plain = tmp_path / "page.html"
    plain.write_text(page.read_text().replace(" 'wasm-unsafe-eval'", ""))
    browser.open(plain)
    browser.run("document.querySelector('.play').click()")
    browser.wait("document.querySelector('.controls output').textContent.includes('frame 20')")
    assert browser.run("document.querySelector('.live').hidden")
    assert browser.run("document.querySelector('summary').textContent") == "Steering and tires against their limits"
    browser.console.clear()


CLIPPED = """Array.from(document.querySelectorAll("h1, h2, h3, p, th, td, label, summary, dt, dd, li")).filter((e) => {
  if (e.closest(".scroll, nav, .skip") || !e.offsetParent) return false;
  const box = e.getBoundingClientRect();
  return box.right > innerWidth + 1 || box.left < -1 || e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 0
    && getComputedStyle(e).display !== "inline";
}).map((e) => e.textContent.slice(0, 60))"""


# Texts of the figures that are cut or lie on one another, and titles of axes among the labels above them.
TANGLED = """Array.from(document.querySelectorAll(".js-plotly-plot")).flatMap((plot) => {
  const frame = plot.getBoundingClientRect(), seen = (e) => [e.textContent, e.getBoundingClientRect()];
  const texts = Array.from(plot.querySelectorAll("svg.main-svg text")).filter((e) => e.textContent.trim()
    && !e.closest(".hoverlayer, .modebar") && e.getBoundingClientRect().width > 0).map(seen);
  const said = texts.filter(([, b]) => b.left < frame.left - 1 || b.right > frame.right + 1 || b.top < frame.top - 1
    || b.bottom > frame.bottom + 1).map(([t]) => t + " is cut in " + plot.id);
  texts.forEach(([s, a], i) => texts.slice(i + 1).forEach(([t, b]) => {
    const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
    const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
    if (wide > 2 && high > 3) said.push(s + " lies on " + t + " in " + plot.id);
  }));
  for (const title of plot.querySelectorAll("text[class$=xtitle]")) {
    const low = title.getBoundingClientRect().top + 3;
    const above = Array.from(plot.querySelectorAll(".xtick text")).map((e) => e.getBoundingClientRect());
    if (above.some((b) => b.bottom > low)) said.push(title.textContent + " stands among labels in " + plot.id);
  }
  return said;
})"""


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_nothing_is_cut_at_any_width(browser, tmp_path, width):
    path = example_page().write(tmp_path / "page.html")
    browser.console.clear()
    browser.open(path, width)
    assert browser.run("document.documentElement.scrollWidth") <= width
    assert browser.run(CLIPPED) == []
    for k in range(browser.run("document.querySelectorAll('.plot').length")):
        browser.run(f"document.querySelectorAll('.plot')[{k}].scrollIntoView()")
        browser.wait(f"document.querySelectorAll('.plot')[{k}].querySelector('svg.main-svg') !== null")
        box = browser.run(f"document.querySelectorAll('.plot')[{k}].getBoundingClientRect().toJSON()")
        assert 0 <= box["left"] <= box["right"] <= width
    assert browser.run(TANGLED) == []
    assert browser.console == []


@pytest.mark.parametrize("width", [390, 1280])
def test_many_panels_stand_apart(browser, tmp_path, width):
    """Four columns of panels on a desk are two on a phone."""
    names = tuple(CHANGES)
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-0.2, 0.2, (64, len(names)))
    cars = Trials(names=names, changes=drawn, results=(rng.uniform(size=(64, 5)) > 0.3).astype(float))
    path = write(tmp_path, Figure(title="inside", figure=shares_by_change(cars)))
    browser.open(path, width)
    browser.wait("document.querySelector('.plot svg.main-svg') !== null")
    assert browser.run(TANGLED) == []
    plot = "document.querySelector('.plot')._fullLayout"
    ends = [browser.run(f"{plot}.xaxis{k}.domain[0]") for k in ("", 2, 3, 4)]
    assert len({round(e, 3) for e in ends}) == (2 if width < 520 else 4)


@pytest.mark.parametrize("before", [390, 700])
def test_a_window_that_grows_has_figures_of_its_size(browser, tmp_path, before):
    """A way at equal scale is as high as its width asks, whatever width the page was opened at."""
    t = np.linspace(0.0, 2 * np.pi, 200)
    path = write(tmp_path, Figure(title="way", figure=path_map(90.0 * np.cos(t), 60.0 * np.sin(t), t + np.pi / 2)))
    height, drawn = "document.querySelector('.plot svg.main-svg')?.height.baseVal.value", {}
    for width in (before, 1280):
        browser.open(path, width)
        browser.wait(f"{height} > 0")
        drawn[width] = browser.run(height)
    browser.open(path, before)
    browser.wait(f"{height} > 0")
    size = {"width": 1280, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **size)
    assert drawn[before] < 0.8 * drawn[1280]
    browser.wait(f"Math.abs({height} - {drawn[1280]}) < 2")


def test_figures_are_drawn_when_they_come_near(browser, tmp_path):
    """The first screen answers before the library is there; a figure far below waits."""
    far = Section(title="far", blocks=(Text(text="\n\n".join("x" for _ in range(200))), *figures_of(example_page())))
    browser.open(Page(title="t", sections=(far,)).write(tmp_path / "page.html"))
    assert browser.run("document.querySelectorAll('.js-plotly-plot').length") == 0
    browser.run("document.querySelector('.plot').scrollIntoView()")
    browser.wait("document.querySelectorAll('.js-plotly-plot').length > 0")


def test_a_page_prints_whole_a_moment_after_it_has_loaded(browser, tmp_path):
    """All figures, though none was near the window; the library is there as soon as nothing else is to be done."""
    far = Section(title="far", blocks=(Text(text="\n\n".join("x" for _ in range(200))), *figures_of(example_page())))
    browser.open(Page(title="t", sections=(far,)).write(tmp_path / "page.html"))
    browser.wait("typeof Plotly !== 'undefined'")
    assert browser.run("document.querySelectorAll('.js-plotly-plot').length") == 0
    browser.call("Page.printToPDF")
    drawn, all_of_them = (browser.run(f"document.querySelectorAll('{c}').length") for c in (".js-plotly-plot", ".plot"))
    assert drawn == all_of_them > 0


def test_no_sheet_is_left_half_empty(browser, tmp_path):
    """Six figures of half a sheet and a little more: two to a sheet, where each would have had one to itself."""
    t = np.linspace(0.0, 1.0, 50)
    tall = [path_map(20.0 * t, np.sin(9.0 * t), 0.0 * t) for _ in range(6)]
    for figure in tall:
        figure.update_layout(height=520, meta=None)
    path = write(tmp_path, *(Figure(title=f"figure {k}", figure=figure) for k, figure in enumerate(tall)))
    browser.open(path)
    browser.wait("typeof Plotly !== 'undefined'")
    pdf = base64.b64decode(browser.call("Page.printToPDF", preferCSSPageSize=True)["data"])
    assert len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 4, "the last one may hold the footer alone"
    browser.wait("document.querySelector('.plot').style.height === '520px'")  # the screen is as it was


def figures_of(page):
    return [f for section in page.sections for f in figures(section.blocks)]


def test_what_is_pointed_at_in_a_figure_is_where_the_drive_stands(browser, tmp_path):
    """A figure over time, the map and the drive that plays follow one another."""
    t, X = 0.05 * np.arange(21), np.linspace(0.0, 20.0, 21)
    over_time = signals(t, [Signal(channel=Channel("r", "rad/s"), values=np.sin(t))]).update_layout(
        meta={"drive": "time"}
    )
    above = path_map(X, 0.5 * X, np.full(21, np.arctan(0.5)))
    above.update_layout(meta={**above.layout.meta, "drive": "place"})
    blocks = drive(), Figure(title="time", figure=over_time), Figure(title="map", figure=above)
    browser.console.clear()
    browser.open(write(tmp_path, *blocks), 1280, 2400)
    browser.wait("document.querySelectorAll('[data-linked]').length === 2")
    said = "document.querySelector('.controls output').textContent"
    x, y = browser.run(
        "(() => { const p = document.querySelector('[data-linked=time]'), b = p.getBoundingClientRect();"
        " const l = p._fullLayout, x = l.xaxis;"
        " return [b.left + x._offset + x.l2p(0.6), b.top + l.yaxis._offset + 40]; })()"
    )
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)
    browser.wait(f"{said} === '0.60 s: frame 12'")
    assert "X 12.0 m" in browser.run("document.querySelector('[data-linked=place] .hoverlayer').textContent")
    browser.run("const s = document.querySelector('.controls input'); s.value = 5; s.dispatchEvent(new Event('input'))")
    browser.wait("document.querySelector('[data-linked=place] .hoverlayer').textContent.includes('X 5.0 m')")
    assert "X 5.0 m" in browser.run("document.querySelector('[data-linked=place] .hoverlayer').textContent")
    assert "0.25" in browser.run("document.querySelector('[data-linked=time] .hoverlayer').textContent")
    assert browser.console == []
