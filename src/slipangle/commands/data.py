"""``slipangle data list | get | check``."""

from __future__ import annotations

import argparse
import json

from slipangle.commands.progress import Bar


def add(commands: argparse._SubParsersAction, as_json: argparse.ArgumentParser) -> None:
    """Describe the commands."""
    data = commands.add_parser(
        "data",
        help="public data sets: list, get, check",
        description="Public data sets, each named by its origin and SHA-256. They are looked for in the folder that "
        "the environment variable SLIPANGLE_DATA names, then in the cache, then downloaded.",
    )
    actions = data.add_subparsers(dest="action", required=True, metavar="ACTION")
    actions.add_parser("list", parents=[as_json], help="what there is, with licence").set_defaults(function=_data_list)
    for action, text in (("get", "find or download a set"), ("check", "compare a set's files with their SHA-256")):
        sub = actions.add_parser(action, parents=[as_json], help=text)
        sub.add_argument("names", nargs="+", metavar="NAME", help="as in 'slipangle data list'")
        sub.set_defaults(function=_data_get if action == "get" else _data_check)


def _data_list(options: argparse.Namespace) -> int:
    from slipangle.data.public import registry

    sets = registry.list_sets()
    if options.json:
        rows = [
            {"name": s.name, "title": s.title, "licence": s.licence, "citation": s.citation, "files": len(s.files)}
            for s in sets
        ]
        print(json.dumps(rows, indent=2))
        return 0
    for s in sets:
        print(f"{s.name}\n  {s.title}: {s.description}\n  licence: {s.licence}\n")
    return 0


def _data_get(options: argparse.Namespace) -> int:
    from slipangle.data.public import registry

    with Bar(quiet=options.json) as bar:
        found = {
            name: {
                file: str(place) for file, place in registry.fetch(name, progress=lambda what: bar(0.5, what)).items()
            }
            for name in options.names
        }
    if options.json:
        print(json.dumps(found, indent=2))
    else:
        for name, places in found.items():
            print(f"{name}:", *places.values(), sep="\n  ")
    return 0


def _data_check(options: argparse.Namespace) -> int:
    from slipangle.data.public import registry

    states = {name: registry.check(name) for name in options.names}
    if options.json:
        rows = {
            name: [{"file": s.file.path, "here": s.place is not None, "as_published": s.good} for s in found]
            for name, found in states.items()
        }
        print(json.dumps(rows, indent=2))
    else:
        for name, found in states.items():
            print(f"{name}:", *(s.sentence for s in found), sep="\n  ")
    return 0 if all(s.good for found in states.values() for s in found) else 1
