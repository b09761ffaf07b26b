"""A project: the files of one exported thing, written whole into a folder of its own or not at all."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any

from slipangle.errors import WriteError
from slipangle.export.names import with_prefix
from slipangle.files import check_output, output_folder


@dataclass(frozen=True, kw_only=True)
class Project:
    """What is exported: its name, what it is in a sentence, its files but for those that all projects have.

    ``files`` are templates, which call everything ``car``, ``sources`` those to be compiled, and ``drive`` is what was
    recorded. ``facts`` go into the manifest; ``about`` into the README, in Markdown, whose template is ``readme``;
    ``flags`` are those that Python compiles the same code with.
    """

    name: str
    kind: str
    sentence: str
    files: Mapping[str, str]
    drive: str
    sources: tuple[str, ...] = ("car.c",)
    about: str = ""
    readme: str = "README.md"
    flags: tuple[str, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def everything(self) -> dict[str, str]:
        """All files by name, the manifest too."""
        named = {n: template(n).replace("@SOURCES@", " ".join(self.sources)) for n in SHELLS}
        named |= {**self.files, "README.md": template(self.readme)}
        made = {key.replace("car", self.name): with_prefix(text, self.name) for key, text in named.items()}
        made = {key: guarded(key, text) for key, text in made.items()}
        made["drive.csv"] = self.drive
        made["README.md"] = made["README.md"].replace("@SENTENCE@", self.sentence).replace("@ABOUT@", self.about)
        made["LICENSE"] = LICENCE
        sums = {n: hashlib.sha256(text.encode()).hexdigest() for n, text in sorted(made.items())}
        record = {"name": self.name, "kind": self.kind, "slipangle": version("slipangle"), **self.facts, "sha256": sums}
        made["manifest.json"] = json.dumps(record, indent=2) + "\n"
        return made


SHELLS = ("Makefile", "CMakeLists.txt", "car_sfun.c", "car_node.cpp")
LICENCE = """\
What slipangle writes into this folder may be used under the terms of the MIT licence, as slipangle itself; there is no
code of third parties in it. It comes without any warranty.
"""


def template(name: str) -> str:
    """A file of ``export/c``."""
    return (files("slipangle.export") / "c" / name).read_text(encoding="utf-8")


def guarded(name: str, text: str) -> str:
    """A file of a project; in front of what has statements stands what a compiler's flags may not be.

    Flags for numbers that are all finite take out every test for NaN, which is how the code tells what is missing.
    """
    return template("finite_math.h") + text if name.endswith((".c", ".cpp", "_block.h")) else text


def replay(name: str) -> str:
    """A ``main.c`` of ``export/c``, with what all of them read numbers by."""
    return template(name).replace("@READ_NUMBERS@", template("read_numbers.c"))


def written(folder: Path) -> list[str]:
    """Names of the files of the project in a folder, which may hold others too."""
    record = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    build = record.get("build", {})
    names = {"manifest.json", *record["sha256"], *build.get("files", {})}
    if build:
        names |= {build["library"]} | ({"model.json"} if "starts" in build and "without_model" not in build else set())
    return sorted(names)


def write(
    project: Project, folder: str | Path, *, force: bool = False, more: Callable[[Path], object] = lambda scratch: None
) -> Path:
    """Write a project into a folder, which is new or empty, whole or not at all.

    Parameters
    ----------
    project : Project
        What to write.
    folder : str or Path
        Where.
    force : bool
        Write into a folder that is not empty too: files of the same names are replaced, others stay.
    more : callable, optional
        Adds to the files while nothing of them is in place yet; of the scratch folder that holds them.

    Raises
    ------
    WriteError
        If the folder is not empty, holds a folder by the name of a file, or cannot be written.
    """
    target = Path(folder)
    check_output(target)
    if target.is_dir() and any(target.iterdir()) and not force:
        raise WriteError(
            f"the folder '{target}' is not empty; expected a new one: name another, or replace what is there with "
            "force (--force)"
        )
    new = not target.exists()
    output_folder(target)
    try:
        with tempfile.TemporaryDirectory(dir=target, prefix=".export.") as scratch:
            for name, text in project.everything.items():
                (Path(scratch) / name).write_text(text, encoding="utf-8", newline="\n")
            more(Path(scratch))
            names = {p.name for p in Path(scratch).iterdir()} - {"manifest.json"}
            ordered = (*sorted(names), "manifest.json")  # which says what belongs together
            folders = [name for name in ordered if (target / name).is_dir()]
            if folders:
                raise WriteError(
                    f"'{target / folders[0]}' is a folder, where a file is to be written; expected no folder of that "
                    "name: move it, or name another place"
                )
            for name in ordered:
                os.replace(Path(scratch) / name, target / name)
    except OSError as error:
        raise WriteError(
            f"'{target}' cannot be written ({error.strerror or error}); expected a folder with write permission and "
            "room: name another one"
        ) from None
    finally:
        if new:
            with suppress(OSError):  # it holds what was written
                target.rmdir()
    return target
