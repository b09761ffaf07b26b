"""``python -m docs.site [FOLDER]``: build the site into a folder, by default build/docs; anything doubtful fails."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from docs.site.api import write_pages
from docs.site.gallery import write_gallery
from docs.site.links import broken
from docs.site.notebooks import write_page
from sphinx.cmd.build import build_main

DOCS = Path(__file__).parents[1]


def main(folder: Path) -> int:
    """Exit code: 0 where every page was built without a warning and every link leads somewhere."""
    source, site = folder / "source", folder / "html"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(DOCS, source, ignore=shutil.ignore_patterns("__pycache__", "*.py", "*.json"))
    write_pages(source / "api")
    write_gallery(source / "gallery")
    write_page(source)
    given = ["-W", "--keep-going", "-q", "-b", "html", "-d", str(folder / "doctrees"), "-c", str(DOCS / "site")]
    if build_main([*given, str(source), str(site)]):
        return 1
    wrong = broken(site)
    print("\n".join(wrong) or f"{len(list(site.rglob('*.html')))} pages, all links lead somewhere: {site}/index.html")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "build/docs")))
