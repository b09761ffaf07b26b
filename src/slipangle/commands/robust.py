"""``slipangle robust``: a job's controller on thousands of cars that differ from its model."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar
from slipangle.errors import ConfigError
from slipangle.files import check_output, replaced

_ABOUT = """\
Identify the controller's model as FILE.toml says, and drive its manoeuvre with that controller on many cars whose
stiffness, friction, mass, steering delay and lag, sensor noise and side wind differ from the model, side by side in the
compiled dual track. A page shows the share that stays inside the lanes, the map of what breaks it, and the worst cars.

The journal keeps what is done: a run that was stopped goes on where it was when the command is repeated, more cars add
to it. Equal seeds give equal results on any number of workers, here or on a cluster.
"""
_MORE = """\
With --json: cars, share_inside, worst.changes and influence. Exit code 1 below 97 % inside.
"""


def add(commands: Commands) -> None:
    """Describe the command."""
    sub = commands.add("robust", _robust, "a controller on cars that differ from its model", about=_ABOUT, more=_MORE)
    sub.add_argument("file", metavar="FILE.toml", help="a job with a controller, as for 'slipangle run'")
    sub.add_argument("--cars", type=int, default=2000, help="how many, those of a stopped run included (2000)")
    sub.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes (all processors)")
    sub.add_argument("--cluster", metavar="ADDRESS", help="of a Ray cluster, such as auto or 10.0.0.5:6379")
    sub.add_argument("--out", default="slipangle-out/robust", help="folder for journal and page (default: %(default)s)")


def _robust(options: argparse.Namespace) -> Answer:
    from slipangle.workflow import robustness
    from slipangle.workflow.drive import CONTROLLERS
    from slipangle.workflow.job import identify_named
    from slipangle.workflow.log import read_logs
    from slipangle.workflow.settings import read_settings

    if not (1 <= options.cars <= 10_000_000 and 1 <= options.workers <= 1024):
        raise ConfigError(f"--cars is {options.cars}, --workers {options.workers}; expected at least 1 of each")
    settings = read_settings(options.file)
    wanted = settings.controller
    if wanted is None:
        raise ConfigError(f"{options.file} has no [controller]; expected one to try: add it")
    check_output(options.out)
    folder = Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)
    with Bar(quiet=options.json or options.quiet) as bar:
        bar(0.0, "identifying the model")
        logs = read_logs(settings)
        model = identify_named(settings, wanted.model, logs)
        controller = CONTROLLERS[wanted.kind](model, wanted, **wanted.entries)
        trial = robustness.trial_of(wanted, settings.plant, model, controller, settings.estimator)
        signature = robustness.signature_of(Path(options.file), settings, logs, trial.seed)
        with robustness.compiled(
            trial, 0 if options.cluster else options.cars
        ) as trial:  # others have not that library
            trials = robustness.try_many(
                trial,
                options.cars,
                folder / "robust.journal",
                signature,
                workers=options.workers,
                cluster=options.cluster,
                progress=lambda share, what: bar(0.05 + 0.95 * share, what),
            )
    before = replaced(folder / "index.html")
    page = robustness.page(trials, settings, options.said).write(folder / "index.html")
    words = f"{robustness.sentence(trials)}\n\nThe page: {page.resolve()}{before}"
    return Answer(trials.metrics(), words, 0 if trials.good else 1)
