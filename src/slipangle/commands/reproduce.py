"""``slipangle reproduce`` and ``slipangle bench``: numbers with their bounds."""

import argparse
from pathlib import Path

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar
from slipangle.files import check_output, replaced


def add(commands: Commands) -> None:
    """Describe the commands."""
    for name, text, more in (
        ("reproduce", "tables of the thesis beside our numbers", "An experiment is named as in the thesis: table-8.2."),
        ("bench", "speed beside peers, in one run", "Needs a checkout: benchmarks/bench_NAME.py."),
    ):
        about = f"{text[0].upper()}{text[1:]}. {more} Without a name, list them."
        columns = "Records: row, quantity, thesis, here, bound, holds, note. Exit code 1 if one does not hold."
        sub = commands.add(name, _reproduce, text, about=about, more=columns)
        sub.add_argument("names", nargs="*", metavar="NAME")
        sub.add_argument("--out", help="also write a page with the tables and their figures into this folder")


def _reproduce(options: argparse.Namespace) -> Answer:
    from slipangle import reproduce as experiments
    from slipangle.report.records import record_table

    bench = options.command == "bench"
    if not options.names:
        known = experiments.benchmark_names() if bench else experiments.names()
        return Answer(known, "\n".join(known))
    find = experiments.find_benchmark if bench else experiments.find
    if options.out:
        check_output(options.out)
    modules = [(name, find(name)) for name in options.names]
    results = []
    for name, module in modules:
        with Bar(quiet=options.json or options.quiet) as bar:
            result = experiments.run(module.bench if bench else module.reproduce, bar)
        command = f"slipangle {options.command} {name}"
        results.append((name, result, record_table(result.records, title=result.title, command=command)))
    rows = [{"name": name, **record.to_dict()} for name, result, _ in results for record in result.records]
    words = [f"{table.to_text()}\n{result.protocol}\n" for _, result, table in results]
    if options.out:
        before = replaced(Path(options.out) / "index.html")
        words.append(f"The page: {_page(results, options).resolve()}{before}")
    return Answer(rows, "\n".join(words), 0 if all(result.holds for _, result, _ in results) else 1)


def _page(results: list, options: argparse.Namespace) -> Path:
    """Every table with its figures, one section each."""
    from slipangle.report import Figure, Page, Section, Text

    sections = []
    for name, result, table in results:
        titles = (*result.captions, *("" for _ in result.figures[len(result.captions) :]))
        shown = enumerate(zip(titles, result.figures, strict=True), start=1)
        figures = [Figure(title=title or f"Figure {k}", figure=figure) for k, (title, figure) in shown]
        sections.append(Section(title=result.title, short=name, blocks=(table, Text(text=result.protocol), *figures)))
    command = f"slipangle {options.command} {' '.join(options.names)} --out {options.out}"
    page = Page(title="Thesis and our numbers", sections=tuple(sections), command=command)
    return page.write(Path(options.out) / "index.html")
