"""A drive that plays on the page, and one that the reader drives: what the page's script needs of both."""

from __future__ import annotations

import base64
import gzip
import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from slipangle.report.jsoned import jsoned
from slipangle.report.tables import typeset
from slipangle.units import angle_said, read_in


@dataclass(frozen=True, kw_only=True)
class Slider:
    """A setting of a live drive: what it is, its value in the unit shown, and how the program wants it.

    The program is given ``value`` times ``scale``; with ``ratio`` the slider moves by equal factors.
    """

    label: str
    value: float
    low: float
    high: float
    unit: str = ""
    scale: float = 1.0
    ratio: bool = False


@dataclass(frozen=True, kw_only=True)
class LiveDrive:
    """A loop that drives in the browser: WebAssembly of `slipangle.export.live.Live`, and what its numbers mean.

    Parameters
    ----------
    program : bytes
        The WebAssembly.
    sliders : sequence of Slider
        One of each of its settings, in its order; one whose ends are equal is not shown.
    row : int
        Numbers of a row: t, s, e_y, v_x, X, Y, psi, steering, plan, then the tire forces used.
    dt : float
        Time between two plans. [s]
    state : tuple of int
        Numbers of a predicted state, nodes, and where X and Y are.
    """

    program: bytes
    sliders: Sequence[Slider]
    row: int
    dt: float
    state: tuple[int, int, int, int]


@dataclass(frozen=True, kw_only=True)
class Beside:
    """Another drive of the same manoeuvre, to compare with: its name, times [s] and pose [m, m, rad]."""

    label: str
    t: Sequence[float]
    X: Sequence[float]
    Y: Sequence[float]
    psi: Sequence[float]


@dataclass(frozen=True, kw_only=True)
class Playback:
    """A drive that plays: its drawing with a moving car, the frames, and what is said at each.

    Parameters
    ----------
    svg : str
        Of `slipangle.report.drawing.seen_from_above` with ``moving``.
    t, X, Y, psi : sequence of float
        Times of the frames [s] and the car's pose then [m, m, rad].
    horizon : sequence of sequence
        X and Y of the predicted path of each frame, one after the other; empty where nothing was predicted. [m]
    said : sequence of str
        What is said at each frame, such as the steering angle.
    steering, limit : sequence of float, float
        Angle of the road wheels at each frame and its largest size, drawn over time [rad]; empty for none.
    axles : sequence of sequence
        Tire forces at each frame over the available ones: along and across, front then rear; empty for none. [-]
    beside : Beside, optional
        Another controller's drive, drawn as well.
    live : LiveDrive, optional
        The loop for the reader to drive.
    """

    title: str
    svg: str
    t: Sequence[float]
    X: Sequence[float]
    Y: Sequence[float]
    psi: Sequence[float]
    said: Sequence[str]
    horizon: Sequence[Sequence[float]] = ()
    steering: Sequence[float] = ()
    limit: float = 0.0
    axles: Sequence[Sequence[float]] = ()
    beside: Beside | None = None
    live: LiveDrive | None = None
    caption: str = ""
    _speeds: tuple[float, ...] = field(default=(0.25, 0.5, 1, 2, 4), repr=False)

    def to_html(self) -> str:
        """The block, without its heading."""
        frames: dict[str, Any] = {"t": _rounded(self.t, 3), **_pose(self), "said": list(self.said)}
        frames |= {"horizon": [_rounded(h, 2) for h in self.horizon]}
        frames |= {"steering": _rounded(self.steering, 5), "limit": self.limit}
        frames |= {"axles": [_rounded(a, 3) for a in self.axles]}
        if self.beside is not None:
            frames["beside"] = {"label": self.beside.label, "t": _rounded(self.beside.t, 3), **_pose(self.beside)}
        speeds = "".join(f'<option value="{v}"{" selected" if v == 1 else ""}>{v:g} ×</option>' for v in self._speeds)
        under = f'<div class="caption"><p>{typeset(self.caption)}</p></div>' if self.caption else ""
        most = len(self.t) - 1
        return (
            f'<div class="block playback"><h3>{html.escape(self.title)}</h3>{self.svg}<div class="controls">'
            '<button type="button" class="play">Play</button>'
            f'<input type="range" min="0" max="{most}" value="0" step="1" aria-label="time of the drive">'
            f'<select aria-label="speed of the playback">{speeds}</select><output></output></div>'
            f"{self._more()}"
            f'<script type="application/json" class="frames">{jsoned(frames)}</script>{under}</div>'
        )

    def _more(self) -> str:
        """What unfolds: gauges, and the loop to drive."""
        inside = self._gauges() + _driven(self.live)
        if not inside:
            return ""
        return f"<details><summary>Steering and tires against their limits</summary>{inside}</details>"

    def _gauges(self) -> str:
        """Steering over time against its limit, and the friction circle of each axle."""
        parts = []
        if len(self.steering):
            most = angle_said(self.limit)
            said = f"steering over the drive, between its limits of ±{most}"
            parts.append(
                '<div class="gauge wide"><svg class="strip" viewBox="0 0 600 90" preserveAspectRatio="none" '
                f'role="img" aria-label="{said}"><path class="limits" d="M0 8H600M0 82H600"/>'
                '<path class="zero" d="M0 45H600"/>'
                '<path class="besides"/><path class="steered"/><path class="cursor"/></svg>'
                f"<span>steering, limits ±{most} dashed</span></div>"
            )
        if len(self.axles):
            for axle in ("front", "rear"):
                parts.append(
                    '<div class="gauge"><svg class="circle" viewBox="-1.15 -1.15 2.3 2.3" role="img" '
                    f'aria-label="{axle} axle: tire force used, the circle is all there is"><circle r="1"/>'
                    '<path class="zero" d="M-1 0H1M0 -1V1"/><path class="trace"/><circle class="dot" r="0.09"/></svg>'
                    f"<span>{axle} tires: force used of all there is</span></div>"
                )
        return f'<div class="gauges">{"".join(parts)}</div>' if parts else ""


def _driven(live: LiveDrive | None) -> str:
    """Sliders and the program; hidden until the script has it running."""
    if live is None:
        return ""
    shown = []
    for k, s in enumerate(live.sliders):
        if s.low == s.high:
            continue
        shown.append(
            f'<label><span>{html.escape(s.label)}</span><input type="range" min="0" max="200" step="1" data-at="{k}">'
            "<output></output></label>"
        )
    about: dict[str, Any] = {"row": live.row, "dt": live.dt, "state": list(live.state)}
    about |= {"speed": read_in("v_x", "m/s"), "angle": read_in("", "rad")}
    about["sliders"] = [
        {"value": s.value, "low": s.low, "high": s.high, "unit": s.unit, "scale": s.scale, "ratio": s.ratio}
        for s in live.sliders
    ]
    packed = base64.b64encode(gzip.compress(live.program, 9, mtime=0)).decode()
    return (
        '<fieldset class="live" hidden><legend>Your settings</legend><p class="note">The exported controller and '
        "the car, compiled to WebAssembly, drive in this page, without sensor noise; the dashed car is the drive with "
        f'the job\'s settings.</p><div class="sliders">{"".join(shown)}</div><p class="outcome" role="status"></p>'
        '<button type="button" class="reset">The job\'s settings</button></fieldset>'
        f'<script type="application/json" class="about">{jsoned(about)}</script>'
        f'<script type="application/wasm" class="program">{packed}</script>'
    )


def _pose(drive: Playback | Beside) -> dict[str, list[float]]:
    return {"X": _rounded(drive.X, 2), "Y": _rounded(drive.Y, 2), "psi": _rounded(drive.psi, 4)}


def _rounded(values: Sequence[float], digits: int) -> list[float]:
    return [round(float(v), digits) for v in values]
