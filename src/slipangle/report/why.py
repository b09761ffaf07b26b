"""What a sentence of a report means and what to do: the entries of docs/troubleshooting.md, which a wheel has too."""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

_FILE = "troubleshooting.md"
_ENTRY = re.compile(r'^(\*\*"[^*]*"\*\*(?:(?:, | \.\.\. )\*\*"[^*]*"\*\*)*): (.*?)(?=\n\n|\Z)', re.S | re.M)
_WORDS = re.compile(r'\*\*"(.*?)"\*\*')


class Entry(NamedTuple):
    """An entry: alternatives, each words that a sentence has all of; and what they mean."""

    words: tuple[tuple[str, ...], ...]
    text: str

    @property
    def parts(self) -> list[str]:
        """All words that it is found by."""
        return [part for each in self.words for part in each]

    def mentions(self, words: str) -> bool:
        """Whether its text, or what it is found by, has these words."""
        return any(words.lower() in part.lower() for part in (*self.parts, self.text))

    def fits(self, sentence: str) -> bool:
        """Whether a sentence has the words of one of the alternatives."""
        return any(all(each in sentence for each in words) for words in self.words)


@cache
def entries() -> tuple[Entry, ...]:
    """Entries in their order, as plain text."""
    beside, source = Path(__file__).with_name(_FILE), Path(__file__).parents[3] / "docs" / _FILE
    found = beside if beside.is_file() else source
    page = found.read_text(encoding="utf-8") if found.is_file() else ""
    return tuple(Entry(_alternatives(head), _plain(text)) for head, text in _ENTRY.findall(page))


def explained(sentence: str) -> str:
    """What the sentence means and what to do, of the first entry that fits it; "" if none does.

    >>> explained("friction ends at its bound of 3").split(".")[0]
    'The optimum is outside the range'
    """
    return next((entry.text for entry in entries() if entry.fits(sentence)), "")


def why_html(sentence: str) -> str:
    """The explanation behind a click, for the page; "" if there is none."""
    text = explained(sentence)
    return f'<details class="why"><summary>what it means</summary>{html.escape(text)}</details>' if text else ""


def _alternatives(head: str) -> tuple[tuple[str, ...], ...]:
    return tuple(
        tuple(words.removesuffix(" ...") for words in _WORDS.findall(each)) for each in re.split(r'(?<="\*\*), ', head)
    )


def _plain(text: str) -> str:
    """Without the marks of Markdown; the first letter large, unless it is of code."""
    code = text.startswith("`")
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(text.split())).replace("`", "")
    return text if code else text[:1].upper() + text[1:]
