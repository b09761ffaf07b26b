"""``slipangle doctor``: what is installed, and what does not work here."""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from slipangle.commands import Answer, Commands

_CORE = ("numpy", "scipy", "casadi", "daqp", "plotly", "rich")
_EXTRAS = {
    "neural": ("jax", "optax"),
    "io": ("asammdf", "h5py", "pyarrow", "rosbags"),
    "cluster": ("optuna", "ray"),
    "live": ("ziglang",),
}
_TRIAL = "double slipangle_doctor(double x) { return 2.0 * x + 1.0; }"


def add(commands: Commands) -> None:
    """Describe the command."""
    more = "Exit code 1 if something that the toolbox cannot do without is missing."
    commands.add("doctor", _doctor, "what is installed, and what does not work here", more=more)


def _doctor(options: argparse.Namespace) -> Answer:
    """Say which Python, packages, extras, compiler and folders are found, what is missing of them, and how to get it.

    A line of C is compiled and run; nothing is installed or changed.
    """
    from slipangle.files import cache_folder

    packages = {name: _version(name) for name in _CORE}
    extras = {extra: {name: _version(name) for name in names} for extra, names in _EXTRAS.items()}
    compiler, compiles = _compiler()
    folders = {"cache": cache_folder(), "here": Path.cwd()}
    locked = [str(f) for f in folders.values() if not _writable(f)]
    wrong = [f"{name} is not installed: pip install {name}" for name, v in packages.items() if not v]
    wrong += [f"the folder '{folder}' cannot be written" for folder in locked]
    python = f"{platform.python_version()} ({sys.executable})"
    system = f"{platform.system()} {platform.machine()}, {os.cpu_count()} processors"
    data = os.environ.get("SLIPANGLE_DATA", "")
    words = [
        f"slipangle {version('slipangle')}, Python {python}, {system}",
        "packages: " + ", ".join(f"{n} {v or 'MISSING'}" for n, v in packages.items()),
        *(_extra(extra, names) for extra, names in extras.items()),
        f"compiler: {compiler}",
        *(f"folder ({use}): {folder}" for use, folder in folders.items()),
        f"public data: {data or 'SLIPANGLE_DATA is not set; they are downloaded when asked for'}",
        *(f"wrong: {sentence}" for sentence in wrong),
        *([] if wrong else ["nothing is wrong"]),
    ]
    found = {"slipangle": version("slipangle"), "python": python, "platform": system, "packages": packages}
    found |= {"extras": extras, "compiler": compiler, "compiles": compiles, "data": data, "wrong": wrong}
    return Answer(found, "\n".join(words), int(bool(wrong)))


def _extra(name: str, packages: dict[str, str]) -> str:
    have = ", ".join(f"{n} {v}" for n, v in packages.items() if v)
    absent = ", ".join(n for n, v in packages.items() if not v)
    return f"extra [{name}]: {have or 'not installed'}" + (
        f"; for {absent}: pip install 'slipangle[{name}]'" if absent else ""
    )


def _version(name: str) -> str:
    """The version of a package, or nothing."""
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _compiler() -> tuple[str, bool]:
    """Which C compiler there is, in words, and whether it makes something that runs."""
    from slipangle.codegen import compiler

    if compiler.compiler() is None:
        return compiler.sentence(), False
    with warnings.catch_warnings(record=True, action="always") as said:
        loaded = compiler.library(_TRIAL, name="doctor")
    if loaded is None:
        return f"{compiler.sentence()}, which fails: {said[-1].message if said else 'no library'}", False
    works = loaded.slipangle_doctor(3.0) == 7.0
    return compiler.sentence() + (", a trial runs" if works else ", whose trial computes something else"), works


def _writable(folder: Path) -> bool:
    """Whether a file could be made there, or in the nearest folder above that exists."""
    existing = next((p for p in (folder, *folder.absolute().parents) if p.exists()), Path(os.sep))
    try:
        with tempfile.TemporaryFile(dir=existing):
            return True
    except OSError:
        return False
