"""``slipangle completion``: what a shell needs to complete commands, options and names."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import NamedTuple

from slipangle.commands import Answer, Commands

_ABOUT = """\
Print a script with which a shell completes commands, options, kinds and tables by the Tab key, other words as files.

  bash:  slipangle completion bash > ~/.local/share/bash-completion/completions/slipangle
  zsh:   slipangle completion zsh > ~/.slipangle.zsh; echo 'source ~/.slipangle.zsh' >> ~/.zshrc
"""
_SCRIPT = """\
# Completion of slipangle, by 'slipangle completion'.
_slipangle() {{
  local at="" word before="" found="" flags="" cur="${{COMP_WORDS[@]:$COMP_CWORD:1}}"
  for word in "${{COMP_WORDS[@]:1:$((COMP_CWORD - 1))}}"; do
    case " {places} " in *" $at/$word "*) at="$at/$word" ;; esac
    before="$word"
  done
  case "$at" in
{cases}
  esac
  case "$at $before" in
{values}
  esac
  case "$cur" in -*) found="$flags" ;; esac
  COMPREPLY=($(compgen -W "$found" -- "$cur"))
}}
complete -o default -F _slipangle slipangle
"""
_ZSH = "autoload -Uz compinit bashcompinit && compinit && bashcompinit\n"


def add(commands: Commands, whole: Callable[[], argparse.ArgumentParser]) -> None:
    """Describe the command; ``whole`` makes the parser that knows all of them."""
    sub = commands.add("completion", _completion, "a script for the Tab key of bash and zsh", about=_ABOUT)
    sub.add_argument("shell", choices=("bash", "zsh"))
    sub.set_defaults(whole=whole)


def _completion(options: argparse.Namespace) -> Answer:
    known = dict(_places(options.whole(), ""))
    cases = [f'    "{at}") found="{" ".join(p.words)}" flags="{" ".join(p.values)}" ;;' for at, p in known.items()]
    values = [
        f'    "{at} {option}") found="{" ".join(words)}" ;;'
        for at, place in known.items()
        for option, words in place.values.items()
        if words
    ]
    parts = {"cases": "\n".join(cases), "values": "\n".join(values)}
    script = _SCRIPT.format(places=" ".join(filter(None, known)), **parts)
    script = (_ZSH if options.shell == "zsh" else "") + script
    return Answer({"script": script}, script.rstrip())


class Place(NamedTuple):
    """What may follow a command or group: words, and options with the values that they may have."""

    words: list[str]
    values: dict[str, list[str]]


def _places(parser: argparse.ArgumentParser, at: str) -> Iterator[tuple[str, Place]]:
    """Each command and group by its place, such as ``/data/get``."""
    place = Place(list(_NAMES.get(at, list)()), {})
    for action in parser._actions:
        choices = [] if action.choices is None else list(map(str, action.choices))
        place.values.update({o: choices for o in action.option_strings if o.startswith("--")})
        place.words.extend([] if action.option_strings else choices)
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from _places(inner, f"{at}/{name}")
    yield at, place


def _tables() -> list[str]:
    from slipangle.workflow.reference import tables

    return ["job", *tables()]


def _lists() -> list[str]:
    from slipangle.commands.listing import REGISTRIES

    return list(REGISTRIES)


_NAMES: dict[str, Callable[[], list[str]]] = {"/help": _tables, "/list": _lists}
