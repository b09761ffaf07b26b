"""Find a C compiler, compile small sources once, keep the libraries in a cache.

The compiler is ``cc``, else the one in the ``ziglang`` package; ``SLIPANGLE_CC`` names another, or ``none``. Without
one, everything runs without compiled code, slower, and `sentence` says so. A compiler may take ``SLIPANGLE_CC_LIMIT``
seconds (300) for one library; ``SLIPANGLE_CFLAGS`` replaces its optimisation flags, ``-O3 -march=native``.
"""

from __future__ import annotations

import ctypes
import importlib.util
import math
import os
import platform
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import repeat
from pathlib import Path

from slipangle import files
from slipangle.codegen import cache as code_cache
from slipangle.errors import ConfigError, ModelWarning, shown

NATIVE = ("-O3", "-march=native")
PORTABLE = ("-O3",)
SUFFIX = {"Windows": ".dll", "Darwin": ".dylib"}.get(platform.system(), ".so")  # of shared libraries
_PROTOTYPE = re.compile(r"^(\w+)\s+(\*?)\s*(\w+)\(([^()]*)\)\s*\{", re.MULTILINE)
_TYPES = {"void": None, "int": ctypes.c_int, "long": ctypes.c_long, "double": ctypes.c_double}


def compiler() -> tuple[str, ...] | None:
    """Command of the C compiler, or None."""
    return _compiler(os.environ.get("SLIPANGLE_CC", ""))


@cache
def _compiler(named: str) -> tuple[str, ...] | None:
    if named.strip().lower() == "none":
        return None
    if named.strip():
        command = _words(named, "SLIPANGLE_CC")
        return command if shutil.which(command[0]) else None
    path = shutil.which("cc")
    if path:
        return (path,)
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc", "-fno-sanitize=undefined")
    return None


def _words(text: str, variable: str) -> tuple[str, ...]:
    try:
        return tuple(shlex.split(text))
    except ValueError as error:
        wanted = "the command" if variable == "SLIPANGLE_CC" else "flags"
        raise ConfigError(
            f"{variable} is {shown(text)} ({error}); expected {wanted} of a C compiler, as in a shell: correct it"
        ) from None


def sentence() -> str:
    """Which compiler is used, or what to do without one; for reports and the command line."""
    command = compiler()
    if command:
        return f"compiled with {' '.join(command)}"
    return (
        "no C compiler was found, so models run uncompiled and slower; install one as cc, or run "
        "pip install ziglang, or name one in SLIPANGLE_CC"
    )


def version() -> str:
    """What the compiler calls itself; empty without one."""
    command = compiler()
    return "" if command is None else _version(command).partition("\n")[0]


def library(source: str, *, name: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """The source as a loaded shared library; compiled at most once per content, compiler and processor.

    Its functions know their arguments, as their prototypes in the source say: pointers are addresses
    (``array.ctypes.data``), ``int``, ``long`` and ``double`` are numbers.

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
        If there is a compiler but it rejects the source or runs too long, or no library can be written; None is
        returned then too. And once if the cache is not safe from other users and a private folder is used instead.

    Raises
    ------
    ConfigError
        If SLIPANGLE_CC, SLIPANGLE_CFLAGS or SLIPANGLE_CC_LIMIT cannot be understood.
    """
    command = compiler()
    return _library(source, name, (*command, *flags), _levels(), files.cache_folder()) if command else None


def compile_file(
    sources: Sequence[Path], target: Path, *, flags: tuple[str, ...] = (), portable: bool = False
) -> dict[str, str | list[str]]:
    """A shared library from files, outside the cache; by which compiler and flags it was made.

    Parameters
    ----------
    sources : sequence of Path
        The C files.
    target : Path
        The library.
    flags : tuple of str, optional
        More flags for the compiler.
    portable : bool
        For every processor of this machine's kind.

    Raises
    ------
    ConfigError
        If there is no compiler, or it rejects a source.
    """
    command = compiler()
    if command is None:
        raise ConfigError(f"{sentence().partition(',')[0]}; expected one: install it as cc, or pip install ziglang")
    given = bool(os.environ.get("SLIPANGLE_CFLAGS", "").strip())
    said, of = "", target
    for level in _levels() if given or not portable else (PORTABLE,):
        options = (*flags, *level, "-shared", "-fPIC", "-std=gnu11")
        try:
            status, text, of = _side_by_side(command, options, sources, target)
        except _RejectedError as error:
            status, text = 1, f"error: {error}"
        if status == 0 and target.is_file():
            return {"compiler": _version(command).partition("\n")[0], "command": list(command), "flags": list(options)}
        said = next((line for line in text.splitlines() if "error" in line), f"exit code {status}")
    raise ConfigError(f"'{' '.join(command)}' did not compile '{of}' ({said[:200]}): set SLIPANGLE_CC to another one")


def _side_by_side(
    command: tuple[str, ...], options: tuple[str, ...], sources: Sequence[Path], target: Path
) -> tuple[int, str, Path]:
    """Exit code, messages and what they are of: the compiler once for each source at the same time, then to link."""
    with tempfile.TemporaryDirectory() as scratch, ThreadPoolExecutor(len(sources)) as pool:
        objects = [str(Path(scratch) / f"{i}.o") for i in range(len(sources))]
        alone = (*command, *(o for o in options if o != "-shared"), "-c")
        calls = [(*alone, "-o", made, str(source)) for made, source in zip(objects, sources, strict=True)]
        for source, (status, text) in zip(sources, pool.map(_run, calls, repeat(os.environ)), strict=True):
            if status:
                return status, text, source
        return *_run((*command, *options, "-o", str(target), *objects, "-lm"), os.environ), target


def _levels() -> tuple[tuple[str, ...], ...]:
    """Optimisation flags, of which the first that the compiler knows are taken."""
    given = os.environ.get("SLIPANGLE_CFLAGS", "").strip()
    if given:
        return (_words(given, "SLIPANGLE_CFLAGS"),)
    return (NATIVE, PORTABLE)  # not every compiler knows -march=native


@cache
def _library(
    source: str, name: str, command: tuple[str, ...], levels: tuple[tuple[str, ...], ...], home: Path
) -> ctypes.CDLL | None:
    """The library, from the first place that holds it or can hold it; ``home`` only tells caches apart."""
    suffix = SUFFIX
    identity = "\0".join((source, *command, str(levels), _version(command), processor()))
    complaint = "no folder for it can be written"
    for folder, reason in code_cache.folders():
        if reason:
            _say_once(
                f"{reason}, so what is compiled there could be changed by others; '{folder}' is used instead: set "
                "XDG_CACHE_HOME to a folder of your own"
            )
        try:
            path = code_cache.find(folder, name, identity, suffix)
            if path is None:
                code_cache.sweep(folder)
                with code_cache.one_at_a_time(folder, identity, _limit()):
                    found = code_cache.find(folder, name, identity, suffix)  # another may have made it by now
                    path = found or _compile(source, (command, levels), folder, name, identity, suffix)
            return _typed(ctypes.CDLL(str(path)), source)
        except _RejectedError as error:
            complaint = str(error)
            break
        except OSError as error:  # a disk that is full or limited, or one whose files may not be run
            complaint = error.strerror or str(error)
    warnings.warn(
        f"'{' '.join(command)}' did not compile '{name}' ({complaint[:200]}); the model runs uncompiled and slower: "
        "set SLIPANGLE_CC to another compiler, or to none to silence this",
        ModelWarning,
        stacklevel=4,
    )
    return None


def _typed(loaded: ctypes.CDLL, source: str) -> ctypes.CDLL:
    """The library with the types of its functions, read from their prototypes."""
    for result, pointer, name, listed in _PROTOTYPE.findall(source):
        arguments = [a.strip() for a in listed.split(",") if a.strip() not in ("", "void")]
        kinds = [ctypes.c_void_p if "*" in a else _TYPES.get(a.split()[0]) for a in arguments]
        function = getattr(loaded, name, None)  # None where the preprocessor leaves it out
        if function is not None and None not in kinds and (pointer or result in _TYPES):
            function.argtypes, function.restype = kinds, ctypes.c_void_p if pointer else _TYPES[result]
    return loaded


@cache
def _say_once(sentence: str) -> None:
    warnings.warn(sentence, ModelWarning, stacklevel=5)


class _RejectedError(Exception):
    """The compiler's complaint."""


def _compile(source: str, how: tuple, folder: Path, name: str, identity: str, suffix: str) -> Path:
    """Compile into the folder, whole or not at all."""
    environment = {"ZIG_GLOBAL_CACHE_DIR": str(folder / "zig"), **os.environ}
    said = ""
    with tempfile.TemporaryDirectory(dir=folder, prefix=f".{name}.") as scratch:
        code, made = Path(scratch) / "model.c", Path(scratch) / f"model{suffix}"
        code.write_text(source, encoding="utf-8")
        command, levels = how
        for flags in levels:
            call = (*command, *flags, "-shared", "-fPIC", "-std=gnu11", "-o", str(made), str(code), "-lm")
            status, text = _run(call, environment)
            if status == 0 and made.is_file():
                return code_cache.keep(made, folder, name, identity)
            lines = text.strip().splitlines()
            said = next((line for line in lines if "error" in line), f"exit code {status}")
    raise _RejectedError(said)


_stuck: set[tuple[str, ...] | None] = set()  # compilers that ran past the limit are not waited for again


def _run(call: tuple[str, ...], environment: Mapping[str, str]) -> tuple[int, str]:
    """Exit code and messages of the compiler, which is stopped with all that it started when its time is over."""
    limit, command = _limit(), compiler()
    if command in _stuck:
        raise _RejectedError(f"it ran past {limit:g} s before")
    try:
        process = subprocess.Popen(
            call,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )
    except OSError as error:
        raise _RejectedError(f"it cannot be run: {error.strerror or error}") from None
    try:
        text, _ = process.communicate(timeout=limit)
    except subprocess.TimeoutExpired:
        _stuck.add(command)
        raise _RejectedError(f"it ran past {limit:g} s; SLIPANGLE_CC_LIMIT sets another limit in seconds") from None
    finally:
        if process.poll() is None:
            _stop(process)
    return process.returncode, text.decode(errors="replace")


def _stop(process: subprocess.Popen) -> None:
    if hasattr(os, "killpg"):
        os.killpg(process.pid, signal.SIGKILL)  # its group has the number of its leader
    else:
        process.kill()
    process.communicate()


def _limit() -> float:
    """Seconds that the compiler may take for one library."""
    named = os.environ.get("SLIPANGLE_CC_LIMIT", "").strip() or "300"
    try:
        limit = float(named)
    except ValueError:
        limit = math.nan
    if not 0 < limit < math.inf:
        raise ConfigError(f"SLIPANGLE_CC_LIMIT is {named[:40]!r}; expected seconds, such as 300: correct the variable")
    return limit


@cache
def _version(command: tuple[str, ...]) -> str:
    try:
        return _run((*command, "--version"), os.environ)[1]
    except _RejectedError:
        return ""


@cache
def processor() -> str:
    """What ``-march=native`` depends on, so that a shared home never serves another processor's code."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(errors="replace").splitlines() if info.is_file() else []
    keys = ("model name", "flags", "Features", "CPU part")
    seen = sorted({line for line in lines if line.startswith(keys)})
    return "\n".join([platform.machine(), platform.processor(), *seen])
