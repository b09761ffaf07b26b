"""A folder of compiled libraries that only this user can change, and files in it that carry their own checksum.

A library runs with all rights of its user, so it is loaded only from a folder that nobody else can write, and only if
its bytes are those that were once compiled here. The name holds the checksum, ``<name>-<identity>-<checksum>.so``: one
rename publishes both, so processes that compile the same source at once never disturb each other; where the system has
locks, one compiles and the others wait for it.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from slipangle.files import cache_folder, private_folder

try:
    import fcntl
except ImportError:  # not every system has such locks
    fcntl = None

_OLD = 86400.0  # scratch folders untouched for this long were left by a process that was killed [s]
_AGAIN = 0.02  # until a lock is tried again [s]
_LOCK = ".lock"  # how the names of locks end


def folders() -> Iterator[tuple[Path, str]]:
    """Places for libraries, best first, each with the reason why the one before it cannot be used.

    The cache, a folder of this user's own in the temporary directory, and one for this process alone, removed at its
    end. A place that others could write is left out.
    """
    reason = ""
    for candidate in dict.fromkeys((cache_folder(), private_folder())):
        try:
            yield prepare(candidate), reason
        except PermissionError as error:
            reason = reason or (str(error.args[0]) if not error.errno else "")
        except OSError:
            continue  # a read-only home, say
    with contextlib.suppress(OSError):
        yield _passing_folder(), reason


@cache
def _passing_folder() -> Path:
    made = Path(tempfile.mkdtemp(prefix="slipangle-"))
    owner = os.getpid()
    atexit.register(lambda: shutil.rmtree(made, ignore_errors=True) if os.getpid() == owner else None)
    return made


def prepare(folder: Path) -> Path:
    """The folder, made if it is not there, with its links followed, and closed to everybody else.

    Raises
    ------
    PermissionError
        If others could change what is in it; the message says how.
    OSError
        If it cannot be made.
    """
    for part in reversed([folder, *folder.parents]):
        if not part.exists():
            with contextlib.suppress(FileExistsError):
                part.mkdir(mode=0o700)
    real = folder.resolve()
    if hasattr(os, "geteuid"):
        for part in (real, *real.parents):
            complaint = _complaint(part, leaf=part == real)
            if complaint:
                raise PermissionError(f"'{part}' {complaint}")
        if stat.S_IMODE(real.stat().st_mode) != 0o700:
            real.chmod(0o700)
    return real


def _complaint(part: Path, *, leaf: bool) -> str:
    """How somebody else could put a file into this folder of the chain; empty if nobody can."""
    seen = part.lstat()
    trusted = {os.geteuid()} if leaf else {os.geteuid(), 0, Path("/").stat().st_uid}
    if seen.st_uid not in trusted:
        return "belongs to another user"
    if not stat.S_ISDIR(seen.st_mode):
        return "is no folder"
    others = bool(seen.st_mode & stat.S_IWOTH) or (bool(seen.st_mode & stat.S_IWGRP) and not _own_group(seen.st_gid))
    return "can be written by other users" if others and not leaf and not seen.st_mode & stat.S_ISVTX else ""


def _own_group(gid: int) -> bool:
    """Whether a group has this user only, as many systems give every user one."""
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(gid), pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return False
    return group.gr_name == user and not set(group.gr_mem) - {user}


def find(folder: Path, name: str, identity: str, suffix: str) -> Path | None:
    """The library compiled for ``identity``, or None; damaged and foreign files of its name are removed."""
    for path in sorted(folder.glob(f"{name}-{_short(identity)}-*{suffix}")):
        if _own(path) and path.name == _file_name(name, identity, path.read_bytes(), suffix):
            return path
        with contextlib.suppress(OSError):
            path.unlink()
    return None


def _own(path: Path) -> bool:
    """Whether it is a plain file that this user made and nobody else can write."""
    seen = path.lstat()
    if not stat.S_ISREG(seen.st_mode):
        return False
    return not hasattr(os, "geteuid") or (seen.st_uid == os.geteuid() and not seen.st_mode & 0o022)


def keep(made: Path, folder: Path, name: str, identity: str) -> Path:
    """Move a library that was just compiled into the folder, on the disk before it has its name.

    Raises
    ------
    OSError
        If it cannot be written.
    """
    made.chmod(0o700)
    with made.open("rb+") as file:
        target = folder / _file_name(name, identity, file.read(), made.suffix)
        os.fsync(file.fileno())
    os.replace(made, target)
    with contextlib.suppress(OSError):  # not every system opens folders
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    return target


@contextlib.contextmanager
def one_at_a_time(folder: Path, identity: str, seconds: float) -> Iterator[None]:
    """Wait until no other thread or process is inside for the same ``identity``, for so many seconds at most.

    The system frees the lock of a process that ends, however it does. Without locks nobody waits.
    """
    place, handle = folder / f".{_short(identity)}{_LOCK}", None
    if fcntl is not None:
        with contextlib.suppress(OSError):
            handle = os.open(place, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
            until = time.monotonic() + seconds
            while not _locked(handle) and time.monotonic() < until:
                time.sleep(_AGAIN)
    try:
        yield
    finally:
        if fcntl is not None and handle is not None:
            with contextlib.suppress(OSError):  # those who wait have it open, those who come find what was made
                place.unlink()
            with contextlib.suppress(OSError):  # by name, as a forked process may have inherited the handle
                fcntl.flock(handle, fcntl.LOCK_UN)
            os.close(handle)


def _locked(handle: int) -> bool:
    if fcntl is None:
        return True
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def sweep(folder: Path) -> None:
    """Remove the scratch folders and locks of processes that were killed long ago."""
    for path in folder.glob(".*"):
        with contextlib.suppress(OSError):
            if path.is_symlink() or time.time() - path.stat().st_mtime <= _OLD:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            elif path.suffix == _LOCK:
                path.unlink()


def _short(identity: str) -> str:
    return hashlib.sha256(identity.encode()).hexdigest()[:24]


def _file_name(name: str, identity: str, raw: bytes, suffix: str) -> str:
    checksum = hashlib.sha256(identity.encode() + b"\0" + raw).hexdigest()[:32]
    return f"{name}-{_short(identity)}-{checksum}{suffix}"
