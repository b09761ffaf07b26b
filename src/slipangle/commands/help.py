"""``slipangle help``: commands, and everything that a job may say."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable

from slipangle.commands import Answer, Commands
from slipangle.errors import ConfigError

_ABOUT = """\
Say what a command does, or what a job may say: every table and key with its range, default and meaning, made from the
records that read a job, those of installed packages among them.

  slipangle help                 all commands
  slipangle help run             one of them
  slipangle help job             every table of a job
  slipangle help job data        one table; arx, mpc, controller and so on likewise
  slipangle help why "ends at its bound"    what a warning means and what to do, by words of it
"""


def add(commands: Commands, whole: Callable[[], argparse.ArgumentParser]) -> None:
    """Describe the command; ``whole`` makes the parser that knows all of them."""
    sub = commands.add("help", _help, "commands, and every key of a job: 'help job'", about=_ABOUT)
    sub.add_argument(
        "topic", nargs="*", metavar="TOPIC", help="a command; 'job' and a table; 'why' and words of a warning"
    )
    sub.add_argument("--schema", action="store_true", help="of a job: the JSON schema, for editors")
    sub.add_argument("--markdown", action="store_true", help="of a job: as a page of documentation")
    sub.set_defaults(whole=whole)


def _help(options: argparse.Namespace) -> Answer:
    first, *rest = options.topic or [""]
    if first == "job":
        return _job(rest, options)
    if first == "why":
        return _why(" ".join(rest))
    if options.schema or options.markdown:
        raise ConfigError("--schema and --markdown are of a job; expected: slipangle help job --schema")
    parser: argparse.ArgumentParser = options.whole()
    for name in filter(None, (first, *rest)):
        parser = _inner(parser, name)
    text = parser.format_help().rstrip()
    return Answer({"help": text}, text)


def _inner(parser: argparse.ArgumentParser, name: str) -> argparse.ArgumentParser:
    from slipangle.errors import nearest

    known = next((dict(a.choices) for a in parser._actions if isinstance(a, argparse._SubParsersAction)), {})
    if name not in known:
        near = nearest(name, [*known, "job"], every=True)
        raise ConfigError(f"there is no command '{name}'; {near}: use one of these names")
    return known[name]


def _why(words: str) -> Answer:
    from slipangle.errors import nearest
    from slipangle.report.why import entries

    if not words:
        raise ConfigError('there are no words; expected some of a warning: slipangle help why "ends at its bound"')
    found = [e for e in entries() if e.fits(words)] or [e for e in entries() if e.mentions(words)]
    if not found:
        near = nearest(words, [part for entry in entries() for part in entry.parts])
        raise ConfigError(f"no entry has the words {words!r}; {near}: use words of the sentence")
    said = "\n\n".join(f"{', '.join(e.parts)}\n    {e.text}" for e in found)
    return Answer([{"words": e.parts, "text": e.text} for e in found], said)


def _job(names: list[str], options: argparse.Namespace) -> Answer:
    from slipangle.workflow.reference import find, markdown, tables, text
    from slipangle.workflow.schema import job_schema

    if options.schema:
        schema = job_schema()
        return Answer(schema, json.dumps(schema, indent=2))
    shown = [t for name in names for t in find(name)] or list(tables().values())
    if options.markdown:
        return Answer({"markdown": markdown(shown)}, markdown(shown).rstrip())
    keys = ("name", "takes", "default", "meaning")
    listed = [
        {"table": t.name, "place": t.place, "about": t.about}
        | {"keys": [{n: getattr(k, n) for n in keys} | {"required": k.entry.needed} for k in t.keys]}
        for t in shown
    ]
    return Answer(listed, text(shown).rstrip())
