"""What the C of a whole loop has around its decisions, a driver's or a racer's: its path, its header, its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from slipangle.control.driver import Driver
from slipangle.control.mpc import MPC
from slipangle.control.racing.racer import Racer
from slipangle.data.channels import Quantity
from slipangle.export.controllers import LANES, table
from slipangle.export.drives import NO_DRIVE, Drive, channels
from slipangle.export.meanings import meaning
from slipangle.export.memory import size_of
from slipangle.export.mpc import mpc_project
from slipangle.export.names import comment, constants
from slipangle.export.project import Project, replay, template
from slipangle.paths.path import Path

LOOPS = ("driver", "racer")  # kinds that these are
Ranges = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, kw_only=True)
class Loop:
    """What is written of a driver or a racer.

    Parameters
    ----------
    driver : Driver or Racer
        What decides.
    planner : MPC
        The controller inside.
    kind, title, when : str
        What it is, in a word and in a few; what its sample time is, and when it is called.
    dt : float
        Its sample time. [s]
    states, outputs : sequence of str
        Of the estimator.
    ranges, bounds : mapping of str to (float, float)
        Beyond which a measurement is taken for a fault, and of the commands.
    heard : mapping of str to str
        What the header says of an output: its noise and how late it is.
    meanings : mapping of str to Quantity
        Of names that are not what the table of channels says, with their units.
    source : str
        What stands after the header in ``car.c``.
    added : str
        What stands behind the planner.
    included, member, more : str
        In the header: another one, what of it is in the struct, and functions that others have not.
    counts : mapping of str to int
        Sizes that others have not.
    window : mapping of str to str
        Files of the estimator's own.
    sizes : mapping of int to int
        Bytes of its memory by the numbers per vector.
    """

    driver: Driver | Racer
    planner: MPC
    kind: str
    title: str
    when: str
    dt: float
    states: Sequence[str]
    outputs: Sequence[str]
    ranges: Ranges
    bounds: Ranges
    source: str
    added: str = ""
    heard: Mapping[str, str]
    meanings: Mapping[str, Quantity]
    included: str = ""
    member: str = ""
    more: str = ""
    counts: Mapping[str, int]
    window: Mapping[str, str]
    sizes: Mapping[int, int]

    def project(self, name: str, drive: Drive) -> Project:
        """The files; name and drive as for `slipangle.export.kinds.project_of`."""
        planner = mpc_project(self.planner, "car_planner", NO_DRIVE)
        parts = [source.removesuffix(".c").replace("car", "car_planner") for source in planner.sources]
        inner = {f"{part}.{suffix}": planner.everything[f"{part}.{suffix}"] for part in parts for suffix in "hc"}
        inner["car_planner.c"] += self.added
        inner |= self.window
        header, planned = self._header(), planner.facts["interface"]
        bytes_ = size_of("\n".join([inner["car_planner.h"], header, self.source]), "Driver", 1)
        most = bytes_ + planner.facts["sizes"]["BYTES"] + max(self.sizes.values())
        return Project(
            name=name,
            kind=self.kind,
            sentence=f"A {comment(self.title)}.",
            files={
                "car.h": header.replace("@BYTES@", str(bytes_)),
                "car.hpp": template("driver.hpp"),
                "car.c": f'#include "car.h"\n{self.source}',
                **inner,
                "car_block.h": template("driver_block.h"),
                "main.c": replay("driver_main.c"),
            },
            sources=("car.c", *(n for n in inner if n.endswith(".c"))),
            drive=drive.text(),
            about=self._about(most),
            readme="DRIVER.md",
            facts={
                "dt": self.dt,
                "horizon": self.planner.horizon,
                "drive": {"steps": len(drive.commands)},
                "interface": {
                    "channels": list(channels(self.driver)),
                    "controls": list(self.driver.controls),
                    "states": list(self.states),
                    "outputs": list(self.outputs),
                    "planned": planned["controls"],
                    "decided": planned["decided"],
                    "times": planned["times"],
                },
                "sizes": {"planner": planner.facts["sizes"], "BYTES": most + 64},
                "bytes": {n: size + bytes_ + self.sizes[n] for n, size in planner.facts["bytes"].items()},
            },
            flags=planner.flags,
        )

    def _header(self) -> str:
        """The text of ``car.h`` but for the size of its memory."""
        listed = {
            "CHANNELS": ("M", channels(self.driver), self.ranges),
            "COMMANDS": ("C", self.driver.controls, self.bounds),
            "STATES": ("X", self.states, {}),
            "OUTPUTS": ("Y", self.outputs, {}),
        }
        counts = {**{k: len(names) for k, (_, names, _) in listed.items()}, **self.counts}
        marks = {"TITLE": comment(self.title), "INCLUDED": self.included, "WINDOW": self.member, "MORE": self.more}
        marks |= {"COUNTS": "\n".join(f"#define CAR_{k} {v}" for k, v in counts.items())}
        marks |= {"DT": repr(self.dt), "WHEN": self.when}
        for mark, (letter, names, known) in listed.items():
            lines = []
            for i, (n, c) in enumerate(constants(f"CAR_{letter}", names).items()):
                said = f", {known[n][0]:.6g} to {known[n][1]:.6g}" if n in known else ""
                said += self.heard.get(n, "") if letter == "Y" else ""
                lines.append(f"#define {c} {i} /* {meaning(n, self.meanings)}{said} */")
            marks[mark] = "\n".join(lines)
        text = template("driver.h")
        for mark, value in marks.items():
            text = text.replace(f"@{mark}@", value)
        return text

    def _about(self, bytes_: int) -> str:
        listed = {"measured": channels(self.driver), "commands": self.driver.controls, "state": self.states}
        lines = [f"- {what}: {', '.join(comment(n) for n in names)}" for what, names in listed.items()]
        path = self.driver.path
        lines.append(f"- path: {len(path.s)} samples over {path.length:.6g} m, constants of {72 * len(path.s)} bytes")
        return "\n".join([*lines, f"- memory: {bytes_} bytes at most, by the vectors of the processor"])


NOTHING: dict[int, int] = dict.fromkeys(LANES, 0)


def path_source(*, ahead: bool = True) -> str:
    """C of what a loop asks of a path: the foot of a point, the line at a place and, for ``ahead``, speeds and more."""
    line = (files("slipangle.paths") / "line.c").read_text(encoding="utf-8")
    unasked = line.index("/* The line at places"), line.index("/* Rows ahead")
    if ahead:
        return (line[: unasked[0]] + line[unasked[1] :]).replace("\nvoid line_ahead", "\nstatic void line_ahead")
    speed = line.index("static double speed_at"), line.index("static double squared")
    return line[: speed[0]] + line[speed[1] : unasked[0]]


def line_tables(path: Path) -> list[str]:
    """The samples of a path."""
    free = np.full_like(path.s, np.inf)
    lane = [free if edge is None else edge for edge in (path.right, path.left)]
    turned = np.cos(path.psi), np.sin(path.psi)
    rows = np.column_stack([path.X, path.Y, path.psi, path.curvature, np.asarray(path.v_x), *lane, *turned])
    lines = [table("LINE", rows), table("SIZE", [path.spacing, path.length])]
    return [*lines, table("SHAPE", [len(rows), path.closed], "long")]
