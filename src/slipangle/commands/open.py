"""``slipangle open``: the last page in the browser."""

from __future__ import annotations

import argparse
import webbrowser
from pathlib import Path

from slipangle.commands import Answer, Commands
from slipangle.errors import MissingFileError


def add(commands: Commands) -> None:
    """Describe the command."""
    sub = commands.add("open", _open, "show the last page in the browser")
    text = "a page, or a folder in which to look for the last one (default: %(default)s)"
    sub.add_argument("place", metavar="PLACE", nargs="?", default="slipangle-out", help=text)


def _open(options: argparse.Namespace) -> Answer:
    """Show a page in the browser: the one that is named, or the one written last in a folder or below it."""
    page = last_page(Path(options.place)).resolve()
    opened = webbrowser.open(page.as_uri())
    words = str(page) if opened else f"{page}\nThere is no browser here to show it in: open the file in one"
    return Answer({"page": str(page), "opened": opened}, words)


def last_page(place: Path) -> Path:
    """The page itself, or of a folder's the one written last.

    Raises MissingFileError if there is none.
    """
    if place.is_file():
        return place
    pages = [p for p in place.rglob("*.html") if p.is_file()] if place.is_dir() else []
    if not pages:
        raise MissingFileError(
            f"there is no page in '{place}'; expected one that a command wrote: name its folder, or make one"
        )
    return max(pages, key=lambda p: (p.stat().st_mtime_ns, str(p)))
