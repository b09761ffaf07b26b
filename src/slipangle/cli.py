"""The command line: ``slipangle demo | run | init | inspect | export | build | list | data | reproduce``."""

import argparse
import io
import re
import shlex
import sys
from collections.abc import Sequence
from importlib.metadata import version

from slipangle.commands import (
    Commands,
    completion,
    data,
    doctor,
    export,
    help,
    init,
    job,
    lap,
    listing,
    log,
    models,
    open,
    reproduce,
    robust,
    run,
    search,
    tire,
)
from slipangle.errors import SlipangleError

_STORY = """\
From a vehicle's drive log to an identified model to a predictive controller.

Start here:
  slipangle demo                              the whole job on a built-in car, no data needed
  slipangle run examples/ferrari_250lm.toml   the same on a real race car's log
  slipangle open                              the last page, in the browser
  slipangle inspect log.csv                   what is in a log, and what is wrong with it
  slipangle init log.csv                      a commented job for a log, guesses marked
  slipangle advise job.toml                   what to drive next
  slipangle export c job.toml                 its controller as C that runs without Python
  slipangle lap job.toml track.csv            the fastest lap of its car
  slipangle help job                          every table and key of a job, with range, default and meaning
  slipangle list                              kinds of models, signals, controllers and so on, added ones too
  slipangle data list                         public data sets, with licence and origin
  slipangle reproduce table-8.2               a table of the thesis, with our number beside the printed one
"""
_EXITS = """\
Exit code: 0 done, 1 a bound did not hold, a file is not the published one, channels contradict each other, or
some models of a job could not be fitted while others are kept, 2 bad input (one sentence on standard error says
what to do)."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code."""
    for stream in (sys.stdout, sys.stderr):  # a terminal that lacks a letter shows a question mark
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = _parser()
    options = parser.parse_args(_joined(given))
    options.said = shlex.join(["slipangle", *given])
    if options.function is None:
        print(parser.format_help(), end="")
        return 0
    try:
        code = run(options)
        sys.stdout.flush()
        return code
    except SlipangleError as error:
        print(f"slipangle: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    except OSError as error:  # a disk that is full, a folder that was removed
        place = f" ('{error.filename}')" if error.filename else ""
        print(f"slipangle: {error.strerror or error}{place}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("slipangle: stopped; nothing was half-written", file=sys.stderr)
        return 130


def _joined(given: Sequence[str]) -> list[str]:
    """Arguments with ``--option -1:1`` as ``--option=-1:1``: argparse takes a leading minus for an option."""
    joined: list[str] = []
    for argument in given:
        if joined and re.match(r"--[a-z][\w-]*$", joined[-1]) and re.match(r"-[.\d]", argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _parser() -> argparse.ArgumentParser:
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(prog="slipangle", description=_STORY, epilog=_EXITS, formatter_class=raw)
    parser.add_argument("--version", action="version", version=f"slipangle {version('slipangle')}")
    parser.set_defaults(function=None)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for group in (job, init, log, models, export, search, robust, lap, tire, listing, data, doctor, reproduce, open):
        group.add(Commands(commands))
    for about in (help, completion):
        about.add(Commands(commands), _parser)
    return parser


if __name__ == "__main__":
    sys.exit(main())
