"""README's moving picture, from the drive of a demo's page: ``python -m docs.site.lane_change PAGE``.

Above the whole manoeuvre, below what is around the car at four times that scale; both at one scale for both axes.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

PICTURE = Path(__file__).parents[1] / "lane-change.svg"
WIDTH, ABOVE, BELOW = 860, 64, 170  # px: both strips, the whole manoeuvre, around the car
NEAR = 18.0  # px/m around the car
PACE = 0.1  # s between frames

_PICTURE = """\
<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="Helvetica, Arial, sans-serif">
<title>{title}</title>
<style>
text {{ fill: #57606b; font-size: 13px; }}
path, polyline, polygon {{ fill: none; vector-effect: non-scaling-stroke; }}
.lane {{ stroke: #b3320c; stroke-width: 1.6; }} .line {{ stroke: #57606b; stroke-dasharray: 5 4; }}
.now {{ fill: #8f6400; stroke: #16191d; }} .horizon {{ stroke: #00795a; stroke-width: 3; }}
</style>
<rect width="{width}" height="{height}" fill="#ffffff"/>
<svg width="{width}" height="{above}"><g transform="translate(0 {top:.2f}) scale({scale:.4f})">{lines}{car}</g></svg>
<svg y="{above}" width="{width}" height="{below}"><rect width="{width}" height="{below}" fill="#f5f6f8"/>
<g><g transform="translate(0 {under:.2f}) scale({near})">{lines}{horizon}{car}</g>{camera}</g></svg>
<text x="0" y="{said}">{caption}</text>
</svg>
"""


def draw(page: str) -> str:
    """The picture of the drive on a page, as SVG that moves.

    Raises ValueError if no drive plays on the page.
    """
    drawing = re.search(r'<svg class="drawing".*?</svg>', page, re.DOTALL)
    frames = re.search(r'<script type="application/json" class="frames">(.*?)</script>', page, re.DOTALL)
    if drawing is None or frames is None:
        raise ValueError("no drive plays on the page; expected that of a job with a controller: run slipangle demo")
    svg, drive = ElementTree.fromstring(drawing[0]), json.loads(frames[1])
    low, high = float(svg.attrib["data-x"]), float(svg.attrib["data-y"])
    _, _, size, across = map(float, svg.attrib["viewBox"].split())
    t = np.array(drive["t"])
    rows = np.searchsorted(t, np.arange(0.0, t[-1], PACE) - 1e-9)
    x, y = np.array(drive["X"])[rows] - low, high - np.array(drive["Y"])[rows]
    turned = -np.degrees(np.array(drive["psi"])[rows])
    outline = next(part for part in svg if part.attrib["class"] == "now").attrib["d"]
    car = (
        f'<g><g><path class="now" d="{outline}"/>{_moves("rotate", [f"{a:.2f}" for a in turned], t[-1])}</g>'
        f"{_moves('translate', _pairs(x, y), t[-1])}</g>"
    )
    ahead = [np.reshape(drive["horizon"][k], (-1, 2)) * [1.0, -1.0] + [-low, high] for k in rows]
    least = min(map(len, ahead))
    points = [" ".join(_pairs(*h[:least].T, between=",")) for h in ahead]
    lines = "".join(
        f'<path class="{part.attrib["class"]}" d="{part.attrib["d"]}"/>'
        for part in svg
        if part.attrib["class"] in ("lane", "line")
    )
    title, scale = svg.attrib["aria-label"], WIDTH / size
    view = np.clip(WIDTH / 3 - NEAR * x, WIDTH - NEAR * size, 0.0)
    return _PICTURE.format(
        title=title,
        caption=f"{title.partition(':')[0]}, as slipangle demo drives it; green: what the controller predicts",
        lines=lines,
        car=car,
        horizon=f'<polyline class="horizon" points="{points[0]}">{_changes("points", points, t[-1])}</polyline>',
        camera=_moves("translate", _pairs(view, 0.0 * view), t[-1]),
        scale=scale,
        top=(ABOVE - scale * across) / 2,
        under=(BELOW - NEAR * across) / 2,
        near=NEAR,
        width=WIDTH,
        above=ABOVE,
        below=BELOW,
        height=ABOVE + BELOW + 24,
        said=ABOVE + BELOW + 18,
    )


def _pairs(x: np.ndarray, y: np.ndarray, between: str = " ") -> list[str]:
    return [f"{a:.2f}{between}{b:.2f}" for a, b in zip(x, y, strict=True)]


def _moves(kind: str, values: list[str], seconds: float) -> str:
    return _changes("transform", values, seconds, f'Transform type="{kind}"')


def _changes(name: str, values: list[str], seconds: float, more: str = "") -> str:
    return (
        f'<animate{more} attributeName="{name}" dur="{seconds:.2f}s" repeatCount="indefinite" '
        f'values="{";".join(values)}"/>'
    )


if __name__ == "__main__":
    PICTURE.write_text(draw(Path(sys.argv[1]).read_text(encoding="utf-8")), encoding="utf-8")
    print(PICTURE)
