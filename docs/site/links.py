"""Links of built pages: each leads to a file and an anchor that are there, and nothing is fetched from elsewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_FETCHED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}


class _Page(HTMLParser):
    """Anchors of a page, where its links lead, and what a browser fetches to show it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: list[str] = []
        self.fetched: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value or "" for key, value in attrs}
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag in _FETCHED and _FETCHED[tag] in given:
            self.fetched.append(given[_FETCHED[tag]])


def broken(folder: Path) -> list[str]:
    """A sentence for every link of the pages below a folder that leads nowhere, or that needs a network to read."""
    pages = {path.resolve(): _Page(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    said = []
    for path, page in pages.items():
        where = path.relative_to(folder.resolve())
        said += [f"{where}: fetches '{t}' from elsewhere" for t in page.fetched if urlsplit(t).netloc]
        for target in [*page.links, *page.fetched]:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not file.is_file():
                said.append(f"{where}: no file '{target}'")
            elif parts.fragment and file in pages and unquote(parts.fragment) not in pages[file].anchors:
                said.append(f"{where}: no anchor '{target}'")
    return said
