"""``slipangle lap``: the fastest lap of a job's car on a track."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar
from slipangle.errors import ConfigError, nearest
from slipangle.files import check_output, replaced, write_atomic

if TYPE_CHECKING:
    from slipangle.optimal.lap.driven import LapDelta
    from slipangle.optimal.lap.lap import Lap

_ABOUT = """\
Identify a model as JOB.toml says, and find the fastest lap of that car on a track: its line between the edges, its
speeds, and what each parameter of the car is worth. The folder then holds a page (index.html) and the lap (lap.csv).

Where the job has a table [race], a racer then drives laps on a plant that is another model, and is judged by the edges.

What the model does not know of the car is set by name, its power always: --set power=2e5 --set drag=0.4.
"""
_MORE = """\
With --json: time, time_std (by what the log leaves open of the car), quasi_steady, iterations and sensitivities (s per
unit); with --driven also its time and sectors, with [race] race.laps, off_track, room, corners. Exit code 1 where the
racer left the track or did not finish its laps.
See docs/fastest-lap.md.
"""
_COLUMNS = ("s", "t", "X", "Y", "psi", "n", "v_x", "v_y", "r", "delta", "F_x", "a_x", "a_y", "grip_f", "grip_r")


def add(commands: Commands) -> None:
    """Describe the command."""
    sub = commands.add("lap", _lap, "the fastest lap of a job's car on a track", about=_ABOUT, more=_MORE)
    sub.add_argument("file", metavar="JOB.toml", help="a job, as for 'slipangle run'")
    sub.add_argument("track", metavar="TRACK", nargs="?", help="its file, instead of the job's: see [lap]")
    sub.add_argument("--model", help="name of the job's model (the first that knows what its tires can hold)")
    sub.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="a parameter of the car, SI")
    sub.add_argument("--line", choices=("free", "given"), help="given: drive the track's own line")
    sub.add_argument("--points", type=int, help="collocation points (one every 5 m)")
    sub.add_argument("--margin", type=float, metavar="M", help="kept free beside the car [m]")
    sub.add_argument("--smoothness", type=float, help="weight of a calm drive (0.3)")
    sub.add_argument("--driven", metavar="LOG", help="a log with X, Y or latitude, longitude: where its best lap loses")
    sub.add_argument("--out", default="slipangle-out/lap", help="folder for the results (default: %(default)s)")


def _lap(options: argparse.Namespace) -> Answer:
    from slipangle.optimal.lap.fastest_lap import fastest_lap
    from slipangle.paths.path import Path as Track
    from slipangle.report.lap import beaten, lap_page, lost_most, remarks
    from slipangle.workflow import race
    from slipangle.workflow.lap import identified_car
    from slipangle.workflow.settings import read_settings

    settings = read_settings(options.file)
    said = {k: getattr(options, k) for k in ("track", "model", "line", "points", "margin", "smoothness", "driven")}
    wanted = replace(settings.lap, **{k: v for k, v in said.items() if v is not None})
    values = _known(wanted.set) | _values(options.set)
    if wanted.track is None:
        raise ConfigError(f"'{options.file}' names no track; expected one: add [lap] with track, or name its file")
    track = Track.from_file(wanted.track, smoothing=wanted.smoothing)
    check_output(options.out)
    folder = Path(options.out)
    with Bar(quiet=options.json or options.quiet) as bar:
        bar(0.0, "identifying the car")
        model, car, supposed = identified_car(settings, wanted.model or None, values)
        bar(0.2 if settings.race else 0.5, "finding the lap")
        how = ("line", "points", "margin", "smoothness", "v_max", "v_start", "tolerance", "iterations")
        lap = fastest_lap(car, track, **{key: getattr(wanted, key) for key in how})
        std = lap.time_std(model, known=values)
        delta = None if wanted.driven is None else _driven(wanted.driven, lap, wanted.origin)
        drive = settings.race
        raced = drive and race.raced(
            drive, settings.plant, model, car, track, wanted.points, lambda s, what: bar(0.3 + 0.6 * s, what)
        )
        bar(0.95, "writing the page")
        folder.mkdir(parents=True, exist_ok=True)
        before = replaced(folder / "index.html")
        more = (race.section(raced, options.said),) if raced else ()
        page = lap_page(lap, settings.title, options.said, delta, more, std, supposed).write(folder / "index.html")
        write_atomic(folder / "lap.csv", _csv(lap))
        bar(1.0, "done")
    found = {"time": lap.time, "time_std": std, "quasi_steady": lap.quasi_steady, "iterations": lap.iterations}
    found |= {"supposed": supposed} if supposed else {}
    words = f"{lap.track.name}: {lap.time:.3f} s ({lap.quasi_steady:.3f} s quasi-steady, {lap.iterations} iterations)."
    words += remarks(lap, std, supposed)
    if delta is not None:
        sectors = [{"begin": s.begin, "end": s.end, "corner": s.corner, "lost": s.lost} for s in delta.sectors]
        found |= {"driven": {"lap": delta.driven.number, "time": delta.driven.time, "sectors": sectors}}
        words += "".join(f"\nyou lose {s.lost:.2f} s at {s.corner:.0f} m" for s in lost_most(delta, 3))
        words += beaten(delta)
    if raced:
        found |= {"race": race.metrics(raced)}
        words += f"\nThe race: {race.word(raced)}. {race.sentence(raced)}"
    code = 1 if raced and race.word(raced) == "poor" else 0
    return Answer(found | {"sensitivities": lap.sensitivities}, f"{words}\n\nThe page: {page.resolve()}{before}", code)


def _driven(file: str | Path, lap: Lap, origin: tuple[float, float] | None) -> LapDelta:
    """The best lap of a log against the fastest one; ``origin`` of the track's frame in degrees."""
    from slipangle.data.readers import read
    from slipangle.optimal.lap.driven import driven_laps, lap_delta
    from slipangle.units import deg

    zero = None if origin is None else (deg(origin[0]), deg(origin[1]))
    return lap_delta(lap, min(driven_laps(read(file), lap.track, origin=zero), key=lambda driven: driven.time))


def _known(values: Mapping[str, float]) -> dict[str, float]:
    """The same, if a lap's car has these parameters."""
    from slipangle.optimal.lap.car import LapCar

    for name in values:
        if name not in LapCar.metadata():
            raise ConfigError(f"a lap's car has no parameter '{name[:60]}'; {nearest(name, LapCar.metadata())}")
    return dict(values)


def _values(given: list[str]) -> dict[str, float]:
    values: dict[str, float] = {}
    for text in given:
        name, _, number = text.partition("=")
        _known({name: 0.0})
        try:
            values[name] = float(number)
        except ValueError:
            raise ConfigError(f"--set is '{text[:60]}'; expected a number: --set {name}=1.0") from None
    return values


def _csv(lap: Lap) -> str:
    rows = zip(*(getattr(lap, name).tolist() for name in _COLUMNS), strict=True)
    return "\n".join([",".join(_COLUMNS), *(",".join(f"{v:.6g}" for v in row) for row in rows)]) + "\n"
