"""`Mutant`: one text of the source replaced by a wrong one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCE = Path("src") / "slipangle"


@dataclass(frozen=True)
class Mutant:
    """A mistake that a person could make.

    Parameters
    ----------
    name : str
        What is wrong.
    file : str
        Below ``src/slipangle``.
    old, new : str
        Text that occurs exactly once, and what stands there instead.
    tests : tuple of str
        Test files below ``tests`` (a test of one as ``file::test``) that must fail.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def broken(self, text: str) -> str:
        """The file's text with the mistake.

        Raises
        ------
        ValueError
            If the old text is not there exactly once.
        """
        found = text.count(self.old)
        if found != 1 or self.new == self.old:
            raise ValueError(f"'{self.name}': the text {self.old!r} occurs {found} times in {self.file}; expected once")
        return text.replace(self.old, self.new)


def mistakes(file: str, tests: str | Sequence[str], rows: Iterable[tuple[str, str, str]]) -> list[Mutant]:
    """Mutants of one file that the same tests catch, from rows of name, old text, new text."""
    given = (tests,) if isinstance(tests, str) else tuple(tests)
    return [Mutant(name, file, old, new, given) for name, old, new in rows]
