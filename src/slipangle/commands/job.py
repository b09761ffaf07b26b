"""``slipangle demo`` and ``slipangle run``: the main job."""

import argparse
from collections.abc import Callable
from pathlib import Path

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar
from slipangle.files import check_output, replaced, write_atomic


def add(commands: Commands) -> None:
    """Describe the commands."""
    more = "The folder then also holds the log (drive_log.csv) and the job (demo.toml): change it and use 'run'."
    demo = commands.add("demo", _demo, "the whole job on a built-in car; needs no data", more=more)
    demo.add_argument("--out", default="slipangle-out/demo", help="folder for the results (default: %(default)s)")
    more = "With --json: free_run.<channel>.fit|vaf|rmse of the first model, models.<name>... of all."
    run = commands.add("run", _run, "the whole job on your log, as a TOML file says", more=more)
    run.add_argument("file", metavar="FILE.toml")
    run.add_argument("--out", help="folder for the results; overrides the file's 'out'")


def _demo(options: argparse.Namespace) -> Answer:
    """Drive a built-in car through excitation manoeuvres, log it with sensor noise, identify two models from it.

    They are judged on data they have not seen; MPC on the identified bicycle tracks the ISO 3888-1 double lane change;
    all of it is on a page.
    """
    from slipangle.workflow.demo import prepare_demo

    check_output(options.out)
    with Bar(quiet=options.json or options.quiet) as bar:
        settings = prepare_demo(options.out, progress=lambda share: bar(0.15 * share, "test drive of the built-in car"))
        return _job(settings, options.out, lambda share, what: bar(0.15 + 0.85 * share, what), ["slipangle", "demo"])


def _run(options: argparse.Namespace) -> Answer:
    """Read a log, identify models, judge them on data they have not seen, control with one, and write a page.

    FILE.toml says which log, channels, units, models and manoeuvre; examples/ferrari_250lm.toml explains the entries.
    """
    with Bar(quiet=options.json or options.quiet) as bar:
        return _job(Path(options.file), options.out, bar, ["slipangle", "run", options.file])


def _job(file: Path, out: str | None, progress: Callable[[float, str], None], command: list[str]) -> Answer:
    from slipangle.workflow.job import run_job
    from slipangle.workflow.page import build_page, summary
    from slipangle.workflow.settings import read_settings

    settings = read_settings(file)
    folder = Path(out if out is not None else settings.out)
    check_output(folder)
    target = folder / "index.html"
    before = replaced(target)
    outcome = run_job(settings, progress)
    progress(0.96, "writing the page")
    page = build_page(outcome, command).write(target)
    write_atomic(folder / "metrics.json", outcome.to_json())
    progress(1.0, "done")
    words = "\n".join([*summary(outcome), f"\nThe page: {page.resolve()}{before}"])
    return Answer(outcome.metrics(), words, 1 if outcome.failures else 0)
