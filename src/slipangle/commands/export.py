"""``slipangle export`` and ``build``: what was identified as source code or a library that runs without Python."""

from __future__ import annotations

import argparse
import json
import shlex
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from slipangle.commands import Answer, Commands
from slipangle.commands.models import load_models, read_job
from slipangle.commands.progress import Bar
from slipangle.errors import ConfigError, ModelWarning
from slipangle.files import check_output

if TYPE_CHECKING:
    from slipangle.export import Drive
    from slipangle.workflow.race_settings import RaceSettings
    from slipangle.workflow.settings import Settings


def add(commands: Commands) -> None:
    """Describe the commands."""
    about = "Write what a job or a file holds as source code that needs no Python, a folder of its own."
    group = commands.group("export", "a controller or a model as source code that runs without Python", about)
    sub = group.add("c", _c, "self-contained C99: source, header, replay of a drive, Makefile, CMake, README")
    _options(sub, "JOB.toml|MODEL.json", "slipangle-out/export/NAME", "mpc, model, ...")
    sub.add_argument(
        "--precision",
        choices=("double", "single"),
        default="double",
        help="of all numbers; single for processors that know no double (default: double)",
    )
    sub.add_argument(
        "--budget",
        type=int,
        nargs="?",
        const=10_000,
        default=0,
        metavar="N",
        help="count instructions and stack of a step over N hard states (default: 10000); needs Valgrind",
    )
    sub = group.add("fmu", _fmu, "an FMU for co-simulation, FMI 2.0 or 3.0: C source and a library for this machine")
    _options(sub, "JOB.toml|MODEL.json", "slipangle-out/export/NAME.fmu", "mpc, model, ...")
    sub.add_argument("--fmi", type=int, choices=(2, 3), default=2, help="version of the standard (default: 2)")
    sub.add_argument("--source-only", action="store_true", help="compile nothing")
    sub = commands.add("build", _build, "compile the controller of a job, to be loaded where there is no compiler")
    _options(sub, "JOB.toml", "slipangle-out/build/NAME", "mpc, driver, ...")
    sub.add_argument("--portable", action="store_true", help="for every processor of this machine's kind")


def _options(sub: argparse.ArgumentParser, what: str, out: str, names: str) -> None:
    """Options of all that is written."""
    files = "a job with a [controller] or a [race]" + (", or a model's file" if "MODEL" in what else "")
    sub.add_argument("what", metavar=what, help=files)
    sub.add_argument("--out", help=f"where to write it (default: {out})")
    sub.add_argument("--name", help=f"with which files and functions begin (default: {names})")
    sub.add_argument("--force", action="store_true", help="replace what is there")


def _place(options: argparse.Namespace, folder: str, suffix: str = "") -> tuple[str, Path]:
    """The name, checked, and where to write."""
    from slipangle.export.names import checked

    name = checked(options.name) if options.name else ""
    return name, Path(options.out or f"slipangle-out/{folder}/{name or Path(options.what).stem}{suffix}")


def _thing(options: argparse.Namespace, bar: Bar) -> tuple[Any, dict[str, Any]]:
    """The model of a file, or the controller of a job and the drive of its manoeuvre."""
    if options.what.endswith(".json"):
        return next(iter(load_models([options.what]).values())), {}
    thing, drive = _controller(options.what, bar)
    return thing, {"drive": drive}


def _c(options: argparse.Namespace) -> Answer:
    """Write the controller of JOB.toml, on the model that the job identifies, or the model of MODEL.json as C99.

    The program in the folder replays the job's manoeuvre, recorded here, wherever it is compiled. Of a job with a
    [race] and no [controller] it is the racer, on its first lap.
    """
    from slipangle.export import export
    from slipangle.export.project import written

    name, folder = _place(options, "export")
    check_output(folder)
    with Bar(quiet=options.json or options.quiet) as bar:
        thing, drive = _thing(options, bar)
        bar(0.95, "writing C")
        settings = {"name": name, "precision": options.precision, "budget": options.budget, "force": options.force}
        made = export(thing, folder, **settings, **drive)
    listed = written(made)
    words = f"{made.resolve()}\n  {', '.join(listed)}\nTry it: make -C {shlex.quote(str(made))} replay"
    answer: dict[str, Any] = {"folder": str(made), "files": listed}
    if options.budget:
        answer["budget"] = budget = json.loads((made / "manifest.json").read_text(encoding="utf-8"))["budget"]
        words += "\n" + ", ".join(f"{what} {budget[key]}" for what, key in _BUDGET.items())
    return Answer(answer, words)


_BUDGET = {"instructions of the longest call": "most", "of the middle one": "median", "stack": "stack", "code": "code"}


def _fmu(options: argparse.Namespace) -> Answer:
    """Write the controller of JOB.toml, on the model that the job identifies, or the model of MODEL.json as an FMU.

    A step is a whole number of sample times, inputs are held over it; docs/export.md says which variables there are.
    """
    from slipangle.export.fmi import export_fmu, require_suffix

    name, path = _place(options, "export", ".fmu")
    require_suffix(path)
    check_output(path.parent)
    with Bar(quiet=options.json or options.quiet) as bar:
        thing, _ = _thing(options, bar)
        bar(0.9, "writing the FMU")
        settings = {"name": name, "version": options.fmi, "binary": not options.source_only, "force": options.force}
        made = export_fmu(thing, path, **settings)
    return Answer({"file": str(made)}, str(made.resolve()))


def _build(options: argparse.Namespace) -> Answer:
    """Compile the controller of JOB.toml once; slipangle.export.load takes the folder where there is no compiler.

    A driver is compiled whole. What is loaded checks the files, the machine and what it decides on the recorded drive.
    """
    from slipangle.export import build
    from slipangle.export.project import written

    name, folder = _place(options, "build")
    check_output(folder)
    if options.what.endswith(".json"):
        raise ConfigError(
            f"'{options.what}' holds a model; expected a job with a [controller] or a [race] to build: write the model "
            "as source code with 'slipangle export c'"
        )
    with Bar(quiet=options.json or options.quiet) as bar:
        controller, drive = _controller(options.what, bar)
        bar(0.8, "compiling")
        made = build(controller, folder, name=name, drive=drive, portable=options.portable, force=options.force)
    listed = written(made)
    words = f"{made.resolve()}\n  {', '.join(listed)}\nLoad it: slipangle.export.load('{made}')"
    return Answer({"folder": str(made), "files": listed}, words)


def _controller(file: str, bar: Bar) -> tuple[Any, Drive]:
    """The controller of a job, or its whole driver, and the drive of its manoeuvre; without them its racer and a lap.

    Raises ConfigError if the job has none of them, before anything is identified.
    """
    from slipangle.control.driver import Driver
    from slipangle.export import DriverRecorder, Recorder
    from slipangle.simulate.drive import drive
    from slipangle.simulate.loop import closed_loop
    from slipangle.workflow.drive import CONTROLLERS, build_path, build_plant, unmoved, whole_driver
    from slipangle.workflow.job import identify_named

    settings, logs = read_job(file)
    wanted = settings.controller
    if wanted is None and settings.race is not None:
        return _racer(file, settings, settings.race, bar)
    if wanted is None:
        raise ConfigError(
            f"'{file}' has no [controller]; expected one to export, or a [race]: add it, or name a model that "
            "'slipangle identify' wrote"
        )
    bar(0.1, f"identifying {wanted.model}")
    model = identify_named(settings, wanted.model, logs)
    bar(0.5, "driving in closed loop")
    controller = CONTROLLERS[wanted.kind](model, wanted, **wanted.entries)
    plant, driver, _ = build_plant(settings.plant, model)
    if isinstance(controller, Driver):
        whole = DriverRecorder(whole_driver(controller, driver, settings.estimator))
        drive(plant, whole, width=wanted.width)  # type: ignore[arg-type]
        return whole.driver, whole.drive
    recorder = Recorder(controller)
    how: Any = {"driver": driver, "held": unmoved(plant, controller), "width": wanted.width}
    closed_loop(plant, recorder, build_path(wanted), **how)  # type: ignore[arg-type]
    return controller, recorder.drive


def _racer(file: str, settings: Settings, wanted: RaceSettings, bar: Bar) -> tuple[Any, Drive]:
    """The racer of a job, which keeps its first lap, and a lap on the job's plant.

    Raises ConfigError if the job names no track.
    """
    from slipangle.export import DriverRecorder
    from slipangle.paths.path import Path as Track
    from slipangle.simulate.race import race
    from slipangle.workflow.lap import identified_car
    from slipangle.workflow.race import racer_on

    lap = settings.lap
    if lap.track is None:
        raise ConfigError(f"'{file}' names no track; expected one: add [lap] with track")
    bar(0.1, "identifying the car")
    model, car, supposed = identified_car(settings, lap.model or None, lap.set)
    if supposed:
        warnings.warn(supposed, ModelWarning, stacklevel=2)
    bar(0.4, "fitting the racer's car to the plant")
    track = Track.from_file(lap.track)
    racer, plant, _ = racer_on(wanted, settings.plant, model, car, track, lap.points, between="sectors")
    bar(0.7, "driving a lap")
    recorder = DriverRecorder(racer)
    race(recorder, plant, 1)  # type: ignore[arg-type]
    return racer, recorder.drive
