"""Files are read whole, and written to a temporary name beside the target, then renamed: never half a file."""

import getpass
import math
import os
import tempfile
from datetime import datetime
from pathlib import Path

from slipangle.errors import MissingFileError, WriteError


def cache_folder() -> Path:
    """Folder for what can be made again: ``slipangle`` in XDG_CACHE_HOME if that is absolute, else in ``~/.cache``.

    Without a home it is `private_folder`. The folder need not exist.
    """
    try:
        base = Path(os.environ.get("XDG_CACHE_HOME", ""))
        base = base if base.is_absolute() else Path.home() / ".cache"
    except RuntimeError:  # no home
        base = Path()
    return base / "slipangle" if base.is_absolute() else private_folder()


def private_folder() -> Path:
    """Folder of this user in the temporary directory, the same in every process; it need not exist."""
    own = os.getuid() if hasattr(os, "getuid") else getpass.getuser()
    try:
        base = tempfile.gettempdir()
    except FileNotFoundError:  # none can be written; whoever writes there is told so
        base = os.sep + "tmp"
    return Path(base).absolute() / f"slipangle-{own}"


def output_folder(path: str | Path) -> Path:
    """Create the folder if needed and make sure that it can be written.

    Raises WriteError if it cannot be created or written.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        raise WriteError(
            f"the output folder '{folder}' cannot be written ({reason}); expected a folder with write "
            "permission: name another one with --out"
        ) from None
    return folder


def check_output(path: str | Path) -> Path:
    """Make sure that a folder could be written, without creating anything.

    Raises WriteError if it, or the nearest folder above it that exists, cannot be written.
    """
    folder = Path(path)
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    if not existing.is_dir():
        raise WriteError(f"the output folder '{folder}' cannot be made ('{existing}' is a file); name another one")
    output_folder(existing)
    return folder


def replaced(path: str | Path) -> str:
    """End of a sentence that says which file a new one replaces; empty if there is none."""
    try:
        then = datetime.fromtimestamp(Path(path).stat().st_mtime)  # as the folder shows it
    except OSError:
        return ""
    return f", which replaces the one of {then:%Y-%m-%d %H:%M}"


def read_bytes(path: str | Path, what: str, expected: str) -> bytes:
    """Content of a file; a MissingFileError says that ``what`` cannot be read, what was ``expected`` and what to do."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise MissingFileError(
            f"{what} '{path}' cannot be read ({error.strerror or error}); expected {expected}"
        ) from None


def write_atomic(path: str | Path, content: str | bytes) -> Path:
    """Write ``content`` to ``path`` whole or not at all.

    Raises WriteError if the place cannot be written.
    """
    target = Path(path)
    raw = content.encode() if isinstance(content, str) else content
    folder = output_folder(target.parent)
    try:
        handle, name = tempfile.mkstemp(dir=folder, prefix=f".{target.name[:100]}.", suffix=".tmp")
    except OSError as error:
        raise WriteError(f"'{target}' cannot be written ({error.strerror or error}); name another place") from None
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(raw)
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(name, 0o666 & ~umask)
        os.replace(name, target)
    except OSError as error:
        Path(name).unlink(missing_ok=True)
        raise WriteError(
            f"'{target}' cannot be written ({error.strerror or error}); expected a writable file: "
            "close the program that holds it, or name another place"
        ) from None
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    return target


def or_null(value: float) -> float | None:
    """A number for JSON, which has no infinity and no NaN: None for these."""
    return float(value) if math.isfinite(value) else None
