"""Find a C compiler, compile small sources once, keep the libraries in a cache.

The compiler is ``cc``, else the one in the ``ziglang`` package; ``SLIPANGLE_CC`` names another, or ``none``. Without
one, everything runs without compiled code, slower, and `sentence` says so.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path

from slipangle.errors import ModelWarning

NATIVE = ("-O3", "-march=native")
PORTABLE = ("-O3",)


def compiler() -> tuple[str, ...] | None:
    """Command of the C compiler, or None."""
    return _compiler(os.environ.get("SLIPANGLE_CC", ""))


@cache
def _compiler(named: str) -> tuple[str, ...] | None:
    if named.strip().lower() == "none":
        return None
    if named.strip():
        command = tuple(shlex.split(named))
        return command if shutil.which(command[0]) else None
    found = shutil.which("cc")
    if found:
        return (found,)
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined")
    return None


def sentence() -> str:
    """Which compiler is used, or what to do without one; for reports and the command line."""
    command = compiler()
    if command:
        return f"compiled with {' '.join(command)}"
    return (
        "no C compiler was found, so models run uncompiled and slower; install one as cc, or run "
        "pip install ziglang, or name one in SLIPANGLE_CC"
    )


def cache_folder() -> Path:
    """Folder of compiled libraries: ``slipangle`` under XDG_CACHE_HOME, by default under ``~/.cache``."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "slipangle"


def library(source: str, *, name: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """The source as a loaded shared library; compiled at most once per content, compiler and processor.

    Parameters
    ----------
    source : str
        C source of one translation unit, which may use the C standard library.
    name : str
        Stem of the cached file's name, for people who look into the folder.
    flags : tuple of str, optional
        More flags for the compiler, such as ``"-fno-math-errno"``.

    Returns
    -------
    CDLL or None
        None without a compiler.

    Warns
    -----
    ModelWarning
        If there is a compiler but it rejects the source; None is returned then too.
    """
    command = compiler()
    return _library(source, name, (*command, *flags), cache_folder()) if command else None


@cache
def _library(source: str, name: str, command: tuple[str, ...], folder: Path) -> ctypes.CDLL | None:
    suffix = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")
    identity = "\0".join((source, *command, _version(command), _processor()))
    target = folder / f"{name}-{hashlib.sha256(identity.encode()).hexdigest()[:24]}{suffix}"
    if not target.is_file():
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            complaint = _compile(source, command, target)
        except OSError:  # a read-only home: keep the library for this process only
            target = Path(tempfile.mkdtemp(prefix="slipangle-")) / target.name
            complaint = _compile(source, command, target)
        if complaint:
            warnings.warn(
                f"'{' '.join(command)}' did not compile '{name}' ({complaint}); the model runs uncompiled and slower: "
                "set SLIPANGLE_CC to another compiler, or to none to silence this",
                ModelWarning,
                stacklevel=4,
            )
            return None
    return ctypes.CDLL(str(target))


def _compile(source: str, command: tuple[str, ...], target: Path) -> str:
    """Compile to ``target``, whole or not at all; returns the compiler's complaint, empty when it worked."""
    complaint = ""
    environment = {"ZIG_GLOBAL_CACHE_DIR": str(target.parent / "zig"), **os.environ}
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.stem}.") as scratch:
        code, made = Path(scratch) / "model.c", Path(scratch) / target.name
        code.write_text(source, encoding="utf-8")
        for flags in (NATIVE, PORTABLE):  # not every compiler knows -march=native
            call = [*command, *flags, "-shared", "-fPIC", "-std=gnu11", "-o", str(made), str(code), "-lm"]
            done = subprocess.run(call, capture_output=True, text=True, check=False, env=environment)
            if done.returncode == 0 and made.is_file():
                os.replace(made, target)
                return ""
            said = done.stderr.strip().splitlines()
            complaint = next((line for line in said if "error" in line), f"exit code {done.returncode}")
    return complaint


@cache
def _version(command: tuple[str, ...]) -> str:
    done = subprocess.run([*command, "--version"], capture_output=True, text=True, check=False)
    return done.stdout


@cache
def _processor() -> str:
    """What ``-march=native`` depends on, so that a shared home never serves another processor's code."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(errors="replace").splitlines() if info.is_file() else []
    keys = ("model name", "flags", "Features", "CPU part")
    seen = sorted({line for line in lines if line.startswith(keys)})
    return "\n".join([platform.machine(), platform.processor(), *seen])
