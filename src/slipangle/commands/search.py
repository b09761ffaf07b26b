"""``slipangle search``: lags, layers and neurons of a NARX network, here or on a cluster."""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from slipangle.commands import Answer, Commands
from slipangle.commands.models import read_job
from slipangle.commands.progress import Bar
from slipangle.errors import SlipangleError
from slipangle.files import check_output, replaced

if TYPE_CHECKING:
    from slipangle.identify.networks.narx import NARX
    from slipangle.identify.search.narx import NarxObjective
    from slipangle.identify.search.search import SearchResult

_ABOUT = """\
Search lags, layers and neurons of a NARX network for the log that FILE.toml names. Only its training part is
used: networks are trained on its beginning and run free over the stretches that follow; the score is the RMSE
of those free runs over the standard deviation of the measured output, so 0.06 is a fit of 94 %.

The journal keeps every finished trial. A search that was stopped, or whose cluster went away, goes on where it
was when the command is repeated. The trials are the same whatever the number of workers.
"""
_MORE = """\
A cluster: ray start --head here, ray start --address=HOST:6379 on other machines with the same installation,
then slipangle search FILE.toml --cluster auto. Needs pip install 'slipangle[cluster]'.

With --json: best.settings, best.score, and trials with number, settings, score, seconds, failure.
"""


_EVERY, _RENEWED = 5.0, 15  # s between two pages while the search goes on, and after which a browser loads them anew


def add(commands: Commands) -> None:
    """Describe the command."""
    sub = commands.add(
        "search", _search, "search the architecture of a network, here or on a cluster", about=_ABOUT, more=_MORE
    )
    sub.add_argument("file", metavar="FILE.toml", help="a job, as for 'slipangle run'")
    sub.add_argument("--trials", type=int, default=64, help="how many, those of a stopped search included (64)")
    sub.add_argument("--space", choices=("thesis", "wider"), default="wider", help="what is tried (wider)")
    sub.add_argument("--epochs", type=int, default=150, help="of each of the two stages of training (150)")
    sub.add_argument("--seed", type=int, default=0, help="of the sampler; trial i trains from seed + i (0)")
    sub.add_argument("--workers", type=int, default=2, help="processes of the local pool (2)")
    sub.add_argument("--cluster", metavar="ADDRESS", help="of a Ray cluster, such as auto or 10.0.0.5:6379")
    sub.add_argument("--pruner", choices=("median", "none"), default="median", help="give up bad trials early (median)")
    sub.add_argument("--out", default="slipangle-out/search", help="folder for journal and page (default: %(default)s)")


def _search(options: argparse.Namespace) -> Answer:
    from slipangle.identify.search.narx import STAGES, THESIS, WIDER, NarxObjective
    from slipangle.identify.search.search import Search
    from slipangle.report.search import search_table, search_verdict

    check_output(options.out)
    folder = Path(options.out)
    train = read_job(options.file)[1].train
    folder.mkdir(parents=True, exist_ok=True)
    search = Search(
        space=THESIS if options.space == "thesis" else WIDER,
        trials=options.trials,
        journal=folder / "search.journal",
        seed=options.seed,
        workers=options.workers,
        cluster=options.cluster,
        pruner=options.pruner,
    )
    objective = NarxObjective(data=train, stages=tuple(replace(s, epochs=options.epochs) for s in STAGES))
    before = replaced(folder / "index.html")
    with Bar(quiet=options.json or options.quiet) as bar:
        bar(0.0, "starting the workers")
        result = search.run(objective, progress=bar, watch=_Written(options, train.name))
        bar(1.0, "a linear model beside it")
        linear = _linear(objective)
    best = result.best
    entry = _entry(objective.estimator(best.settings, options.seed + best.number))
    page = _page(result, options, train.name, linear=linear, entry=entry)
    rows = [
        {"number": t.number, "settings": t.settings, "score": None if t.failure else t.score}
        | {"seconds": t.seconds, "failure": t.failure}
        for t in result.trials
    ]
    first = {"number": best.number, "settings": best.settings, "score": best.score}
    said = search_verdict(result, linear).sentence
    words = (
        f"{search_table(result, rows=12).to_text()}\n{said}\n\nIn a job:\n\n{entry}\n\nThe page: "
        f"{page.resolve()}{before}"
    )
    return Answer({"best": first, "linear": linear, "trials": rows}, words)


def _linear(objective: NarxObjective) -> float | None:
    """Score of a linear model; None where there is none of these data."""
    try:
        return objective.linear()
    except SlipangleError:
        return None


def _entry(best: NARX) -> str:
    """A job's entry of a network."""
    stages = ", ".join(
        f"{{ horizon = {s.horizon}, epochs = {s.epochs}, learning_rate = {s.learning_rate!r} }}" for s in best.stages
    )
    lines = {
        "name": '"searched"',
        "kind": '"narx"',
        "na": best.na,
        "nb": best.nb,
        "hidden": list(best.hidden),
        "activation": f'"{best.activation}"',
        "stages": f"[{stages}]",
        "holdout": best.holdout,
        "seeds": list(best.seeds),
        "linear_start": "false",
    }
    return "\n".join(["[[model]]", *(f"{name} = {value}" for name, value in lines.items())])


class _Written:
    """Writes the page while the search goes on, not more often than every few seconds; a trial at least must count."""

    def __init__(self, options: argparse.Namespace, name: str) -> None:
        self._options, self._name, self._last = options, name, -math.inf

    def __call__(self, result: SearchResult) -> None:
        """Write it with the trials so far."""
        done, waited = len(result.trials), time.monotonic() - self._last
        if done >= self._options.trials or waited < _EVERY or all(t.failure for t in result.trials):
            return
        _page(result, self._options, self._name, done=done)
        self._last = time.monotonic()


def _page(
    result: SearchResult,
    options: argparse.Namespace,
    name: str,
    *,
    done: int = 0,
    linear: float | None = None,
    entry: str = "",
) -> Path:
    """Verdict, parallel coordinates, every trial, a job's entry; ``done`` trials so far, where the search goes on."""
    from slipangle.report import Figure, Listing, Page, Section
    from slipangle.report.search import parallel_coordinates, search_table, search_verdict

    so_far = f"{done} of {options.trials} trials so far. " if done else ""
    own = {"trials": options.trials, "seed": options.seed, "space": options.space, "epochs": options.epochs}
    command = " ".join([f"slipangle search {options.file}", *(f"--{key} {value}" for key, value in own.items())])
    command += "" if options.pruner == "median" else f" --pruner {options.pruner}"
    verdict = search_verdict(result, linear)
    use = [Listing(title="As a model of the job", text=entry)] if entry else []
    figure = Figure(
        title="Settings and score",
        figure=parallel_coordinates(result, score="free-run error [-]"),
        caption="One line per trial: the best tenth blue, the better half yellow. Point at a line for its settings.",
    )
    page = Page(
        title="Search of network architectures",
        subtitle=f"{so_far}{name}; training part only, free runs over stretches that follow what was trained on",
        renewed=_RENEWED if done else 0,
        sections=(
            Section(title="Verdict", blocks=(verdict, *use)),
            Section(title="Trials", blocks=(figure, search_table(result))),
        ),
        command=command,
    )
    return page.write(Path(options.out) / "index.html")
