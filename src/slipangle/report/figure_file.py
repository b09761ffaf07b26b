"""`save_figure`: a figure as a file for a publication, in the width of one or two columns."""

from __future__ import annotations

import html
import io
import json
import os
import re
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import plotly.graph_objects as go
from plotly.utils import PlotlyJSONEncoder

from slipangle.errors import ConfigError, ParameterError
from slipangle.extras import extra
from slipangle.files import write_atomic
from slipangle.report.bundle import bundle
from slipangle.report.paper import matplotlib_figure, size_of

_PIXEL = 25.4 / 96  # mm, of CSS
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome", "msedge")
_SECONDS = 90.0
_AS_TEXT = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "slipangle"}  # text stays text


def save_figure(
    figure: go.Figure,
    path: str | Path,
    *,
    columns: Literal[1, 2] = 1,
    height: float | None = None,
    font: float = 8.0,
    drawn_by: Literal["", "matplotlib", "browser"] = "",
) -> Path:
    """Write a figure as SVG, PDF or HTML, by the ending of the file, in a publication's size; returns where it is.

    SVG and PDF are vector graphics with text as text, drawn by matplotlib (extra ``plot``) where it is installed, else
    by Chromium or Chrome; the environment variable SLIPANGLE_BROWSER names another one.

    Raises ParameterError if the ending or the size is none of these, MissingExtraError or ConfigError if what is to
    draw it is missing or fails, and WriteError if the place cannot be written.

    Parameters
    ----------
    figure : plotly figure
        Such as what ``.plot()`` of a result gives; it is not changed.
    path : path
        File to write.
    columns : 1 or 2
        Width of 88 or 181 mm.
    height : float, optional
        By default two thirds of the width in one column, one half in two, more for three panels and up. [mm]
    font : float
        Size of the text. [pt]
    drawn_by : {"", "matplotlib", "browser"}
        Who draws SVG and PDF; by default matplotlib where it is installed.

    For example ``sa.save_figure(linear.bode("r", "delta").plot(), "bode.pdf")``.
    """
    place = Path(path)
    kind = place.suffix.lower()
    if kind not in (".svg", ".pdf", ".html"):
        raise ParameterError(f"the file is '{place.name}'; expected a name that ends in .svg, .pdf or .html")
    if drawn_by not in ("", "matplotlib", "browser"):
        raise ParameterError(
            f"drawn_by is {drawn_by!r}; expected 'matplotlib' or 'browser', or nothing for what is there"
        )
    wide, tall = size_of(figure, columns, height, font)
    if kind != ".html" and (drawn_by == "matplotlib" or (not drawn_by and find_spec("matplotlib"))):
        made = matplotlib_figure(figure, columns=columns, height=tall, font=font)
        file = io.BytesIO()
        with extra("matplotlib", "plot", "a figure by matplotlib").rc_context(_AS_TEXT):
            made.savefig(file, format=kind[1:], metadata={"Date" if kind == ".svg" else "CreationDate": None})
        return write_atomic(place, file.getvalue())
    printed = sized(figure, round(wide / _PIXEL), round(tall / _PIXEL), font)
    if kind == ".html":
        return write_atomic(place, printed.to_html(include_plotlyjs=True, full_html=True))
    with tempfile.TemporaryDirectory() as folder:
        drawn = _drawn(printed, Path(folder))
        if kind == ".svg":
            return write_atomic(place, drawn)
        return write_atomic(place, _printed(drawn, wide, tall, Path(folder)).read_bytes())


def sized(figure: go.Figure, width: int, height: int, font: float) -> go.Figure:
    """A copy in a size [px] with text of one size [pt], thin lines and narrow margins."""
    pixels = font / 72 * 25.4 / _PIXEL
    copy = go.Figure(figure)
    text = {"size": pixels}
    copy.update_layout(width=width, height=height, font=text, legend={"font": text}, meta=None)
    copy.update_layout(margin={"l": 6 * pixels * 0.75, "r": pixels, "t": 2.2 * pixels, "b": 3.6 * pixels})
    copy.update_xaxes(title_font=text, tickfont=text, nticks=6, ticklen=3, title_standoff=4)
    copy.update_yaxes(title_font=text, tickfont=text, nticks=5, ticklen=3, title_standoff=4)
    copy.update_annotations(font_size=pixels)
    return copy


def _drawn(figure: go.Figure, folder: Path) -> str:
    """The figure as SVG, drawn by a browser from a page of its own."""
    kinds = frozenset(trace["type"] for trace in figure.to_dict().get("data", []))
    spec = json.dumps(figure.to_dict(), cls=PlotlyJSONEncoder).replace("<", "\\u003c")
    width, height = figure.layout.width, figure.layout.height
    script = (
        f"const spec = {spec};\nPlotly.newPlot('plot', spec.data, spec.layout).then((p) => Plotly.toImage(p, "
        f"{{format: 'svg', width: {width}, height: {height}}})).then((url) => {{ document.getElementById('out')"
        ".textContent = decodeURIComponent(url.slice(url.indexOf(',') + 1)); });"
    )
    page = folder / "page.html"
    library = bundle(kinds).replace("</script", "<\\/script")
    page.write_text(
        f'<!DOCTYPE html><meta charset="utf-8"><script>{library}</script>'
        f'<body><div id="plot"></div><pre id="out"></pre><script>{script}</script></body>',
        encoding="utf-8",
    )
    text = _browse(folder, "--virtual-time-budget=20000", "--dump-dom", page.as_uri())
    found = re.search(r'<pre id="out">(.*?)</pre>', text, re.S)
    drawn = html.unescape(found.group(1)) if found else ""
    if not drawn.startswith("<svg"):
        raise ConfigError("the browser drew no figure; expected SVG: write an .html file and print that instead")
    return drawn + "\n"


def _printed(drawn: str, wide: float, tall: float, folder: Path) -> Path:
    """SVG as a PDF of one page of its size [mm]."""
    page, made = folder / "print.html", folder / "figure.pdf"
    look = f"@page {{ size: {wide:g}mm {tall:g}mm; margin: 0; }} body {{ margin: 0; }} svg {{ display: block; }}"
    page.write_text(f'<!DOCTYPE html><meta charset="utf-8"><style>{look}</style>{drawn}', encoding="utf-8")
    _browse(folder, "--no-pdf-header-footer", f"--print-to-pdf={made}", page.as_uri())
    if not made.is_file():
        raise ConfigError("the browser printed no PDF; expected one: write an .svg file and convert that instead")
    return made


def _browse(folder: Path, *options: str) -> str:
    """What a headless browser prints."""
    wanted = os.environ.get("SLIPANGLE_BROWSER", "")
    found = next((p for name in ((wanted,) if wanted else _BROWSERS) if (p := shutil.which(name))), None)
    if found is None:
        raise ConfigError(
            f"SVG and PDF need {f'the browser {wanted}' if wanted else 'Chromium or Chrome'}, which is not installed; "
            "expected it, or an .html file: install it, or name another in SLIPANGLE_BROWSER"
        )
    quiet = ["--headless", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    if hasattr(os, "geteuid") and os.geteuid() == 0:  # Chromium has no sandbox for root, as in containers
        quiet.append("--no-sandbox")
    try:
        done = subprocess.run(
            [found, *quiet, *options], capture_output=True, text=True, timeout=_SECONDS, check=True, encoding="utf-8"
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise ConfigError(
            f"the browser '{found}' failed ({type(error).__name__}); expected a Chromium that runs headless: write an "
            ".html file instead"
        ) from None
    return done.stdout
