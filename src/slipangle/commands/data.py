"""``slipangle data list | get | check``."""

import argparse

from slipangle.commands import Answer, Commands
from slipangle.commands.progress import Bar


def add(commands: Commands) -> None:
    """Describe the commands."""
    about = (
        "Public data sets, each named by its origin and SHA-256. They are looked for in the folder that the\n"
        "environment variable SLIPANGLE_DATA names, then in the cache, then downloaded."
    )
    actions = commands.group("data", "public data sets: list, get, check", about)
    actions.add("list", _data_list, "what there is, with licence")
    for sub in (
        actions.add("get", _data_get, "find or download a set"),
        actions.add("check", _data_check, "compare a set's files with their SHA-256"),
    ):
        sub.add_argument("names", nargs="+", metavar="NAME", help="as in 'slipangle data list'")


def _data_list(options: argparse.Namespace) -> Answer:
    from slipangle.data.public import registry

    sets = registry.list_sets()
    rows = [
        {"name": s.name, "title": s.title, "licence": s.licence, "citation": s.citation, "files": len(s.files)}
        for s in sets
    ]
    words = (f"{s.name}\n  {s.title}: {s.description}\n  licence: {s.licence}\n" for s in sets)
    return Answer(rows, "\n".join(words))


def _data_get(options: argparse.Namespace) -> Answer:
    from slipangle.data.public import registry

    with Bar(quiet=options.json or options.quiet) as bar:
        places = {name: registry.fetch(name, progress=lambda what: bar(0.5, what)) for name in options.names}
    known = {name: {file: str(place) for file, place in files.items()} for name, files in places.items()}
    return Answer(known, "\n".join("\n  ".join([f"{name}:", *files.values()]) for name, files in known.items()))


def _data_check(options: argparse.Namespace) -> Answer:
    from slipangle.data.public import registry

    states = {name: registry.check(name) for name in options.names}
    rows = {
        name: [{"file": s.file.path, "here": s.place is not None, "as_published": s.good} for s in state]
        for name, state in states.items()
    }
    words = ("\n  ".join([f"{name}:", *(s.sentence for s in state)]) for name, state in states.items())
    return Answer(rows, "\n".join(words), 0 if all(s.good for state in states.values() for s in state) else 1)
