"""Commands of README and docs: each is understood, with its options, choices, tables and benchmarks."""

import re
import shlex
from pathlib import Path

import pytest

from slipangle.cli import _joined, _parser, main
from slipangle.reproduce import find, find_benchmark

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```\n(.*?)^```", re.S | re.M)
INLINE = re.compile(r"`(slipangle [^`]+)`")
LINE = re.compile(r"^(?:    )?(?:\.venv/bin/)?(slipangle .*)$", re.M)


def commands() -> list[str]:
    """Every command that starts with slipangle, of blocks, indented lines and the text."""
    found = set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for block in [*BLOCK.findall(text), re.sub(r"^```.*?^```", "", text, flags=re.S | re.M)]:
            found |= {line.strip() for line in LINE.findall(block)}
        found |= {line for line in INLINE.findall(text) if not re.search(r"[A-Z]{3,}|\.\.\.| > ", line)}
    return sorted(found)


def words(command: str) -> list[str]:
    return _joined(shlex.split(command, comments=True)[1:])


def named_only(given: list[str]) -> bool:
    """Whether a page speaks of a command and its options, without the file that it takes."""
    alone = all(word.startswith("-") for word in given[1:])
    return alone and given[0] not in ("demo", "list", "doctor", "reproduce", "bench", "open")


@pytest.mark.parametrize("command", commands())
def test_a_command_is_understood(command, capsys):
    """Its options and choices are there, and so are the tables and benchmarks that it names."""
    given = words(command)
    if named_only(given):
        with pytest.raises(SystemExit) as stop:
            main([*given[:1], "--help"])
        assert stop.value.code == 0
        assert all(option in capsys.readouterr().out for option in given[1:])
        return
    options = _parser().parse_args(given)
    assert options.function is not None
    for name in getattr(options, "names", []) if options.command in ("reproduce", "bench") else []:
        assert find(name) if options.command == "reproduce" else find_benchmark(name)


def test_make_targets_are_there():
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M))
    named = {t for page in PAGES for t in re.findall(r"(?:^|`)make ([a-z][\w-]+)", page.read_text(), re.M)}
    assert {"demo", "test", "docs"} <= named <= targets


def test_scripts_that_are_named_are_there():
    named = {s for page in PAGES for s in re.findall(r"python ((?:examples|benchmarks)/\S+\.py)", page.read_text())}
    assert named
    assert [s for s in named if not (ROOT / s).exists()] == []
