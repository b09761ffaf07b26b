"""What the command line does, a file a command."""

from __future__ import annotations

import argparse
import inspect
import json
from collections.abc import Callable
from typing import Any, NamedTuple

from slipangle.units import shown_in_si


class Answer(NamedTuple):
    """What a command found: for machines, the same in words, and the exit code."""

    data: Any
    words: str
    code: int = 0


def run(options: argparse.Namespace) -> int:
    """Do what was asked for, print what came of it, and return the exit code."""
    with shown_in_si(options.si):
        answer = options.function(options)
    if options.json or not options.quiet:
        print(json.dumps(answer.data, indent=2) if options.json else answer.words)
    return answer.code


class Commands:
    """Where a group adds its commands; every one knows ``--json``, ``--quiet`` and ``--si``."""

    def __init__(self, actions: argparse._SubParsersAction) -> None:
        self._actions = actions
        self._json = argparse.ArgumentParser(add_help=False)
        self._json.add_argument("--json", action="store_true", help="print JSON on standard output, and nothing else")
        self._json.add_argument("--si", action="store_true", help="show m/s, rad and s, not km/h, degrees and ms")
        self._json.add_argument("--quiet", action="store_true", help="print nothing but what is wrong, no progress")

    def add(
        self, name: str, function: Callable[[argparse.Namespace], Answer], text: str, *, about: str = "", more: str = ""
    ) -> argparse.ArgumentParser:
        """A command: its line in the list, what it does (by default the function's docstring), what else to know."""
        shared = {"parents": [self._json], "formatter_class": argparse.RawDescriptionHelpFormatter}
        said = about or inspect.getdoc(function)
        sub = self._actions.add_parser(name, help=text, description=said, epilog=more or None, **shared)
        sub.set_defaults(function=function, said="")  # said: the whole command as a shell takes it
        return sub

    def group(self, name: str, text: str, about: str) -> Commands:
        """A command that has commands of its own."""
        raw = argparse.RawDescriptionHelpFormatter
        sub = self._actions.add_parser(name, help=text, description=about, formatter_class=raw)
        return Commands(sub.add_subparsers(dest="action", required=True, metavar="ACTION"))
