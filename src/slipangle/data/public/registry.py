"""Where the public data sets are: named files with origin and sha256; local folder first, then download.

The table itself is ``public.toml`` beside this file. None of the data is part of this package.
"""

import hashlib
import http.client
import os
import tomllib
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from slipangle.errors import HashError, MissingFileError, ParameterError, nearest
from slipangle.files import cache_folder, read_bytes, write_atomic

RAW = "https://raw.githubusercontent.com/{repo}/{commit}/{path}"
"""Address of a file at its origin."""
_TIMEOUT = 30.0  # [s]
_LARGEST = 100_000_000  # bytes of an answer that are taken; the largest published file has 3 million


@dataclass(frozen=True, kw_only=True)
class PublicFile:
    """One published file: its name within the set, its place below the folder SLIPANGLE_DATA or the cache, its hash.

    It is published at ``urls``, tried in turn; empty if nowhere. The hash decides whether it is the file.
    """

    name: str
    path: str
    sha256: str
    urls: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class PublicSet:
    """One published data set: what it is, whose it is, and its files."""

    name: str
    files: tuple[PublicFile, ...]
    title: str
    description: str
    licence: str
    citation: str

    def file(self, name: str) -> PublicFile:
        """A file of the set.

        Raises ParameterError if there is none of that name.
        """
        files = {file.name: file for file in self.files}
        if name not in files:
            raise ParameterError(
                f"the data set '{self.name}' has no file '{name}'; {nearest(name, files)}: use one of these"
            )
        return files[name]


@dataclass(frozen=True, kw_only=True)
class FileState:
    """What `check` found for one file."""

    file: PublicFile
    place: Path | None
    sha256: str | None

    @property
    def good(self) -> bool:
        """Whether the file is here and is the published one."""
        return self.sha256 == self.file.sha256

    @property
    def sentence(self) -> str:
        """The state in words."""
        if self.place is None:
            return f"{self.file.path} is not here yet"
        if self.good:
            return f"{self.file.path} is here and is the published file"
        return f"{self.file.path} is here ({self.place}) but its sha256 is {self.sha256}, not {self.file.sha256}"


def _address(origin: str, folder: str, entry: str) -> str:
    """URL of one entry: a path below the origin's folder, from the repository's root, or a full origin."""
    if ":" in entry:
        origin, _, path = entry.partition(":")
    elif entry.startswith("/"):
        path = entry.lstrip("/")
    else:
        path = f"{folder}/{entry}"
    repo, _, commit = origin.partition("@")
    return RAW.format(repo=repo, commit=commit, path=urllib.parse.quote(path))


def _read_set(name: str, table: dict) -> PublicSet:
    origin, _, origin_folder = table["origin"].partition(":")
    files = []
    for line in table["files"]:
        digest, file_name, *rest = line.split(maxsplit=2)
        entries = (rest[0] if rest else file_name).split("|")
        files.append(
            PublicFile(
                name=file_name,
                path=os.path.normpath(f"{table['folder']}/{file_name}"),
                sha256=digest,
                urls=tuple(_address(origin, origin_folder, e) for e in entries) if origin else (),
            )
        )
    facts = {key: table[key] for key in ("title", "description", "licence", "citation")}
    return PublicSet(name=name, files=tuple(files), **facts)


@cache
def list_sets() -> tuple[PublicSet, ...]:
    """All public data sets.

    >>> [s.name for s in list_sets()][:3]
    ['ferrari-250lm', 'ferrari-250lm-session', 'robot-arm']
    """
    text = resources.files("slipangle.data.public").joinpath("public.toml").read_text(encoding="utf-8")
    return tuple(_read_set(name, table) for name, table in tomllib.loads(text).items())


def find_set(name: str) -> PublicSet:
    """A public data set by name.

    Raises ParameterError if there is none; the nearest names are given.
    """
    sets = {public.name: public for public in list_sets()}
    if name not in sets:
        raise ParameterError(f"there is no public data set '{name}'; {nearest(name, sets)}: use one of these names")
    return sets[name]


def _places(file: PublicFile) -> Iterable[Path]:
    own = os.environ.get("SLIPANGLE_DATA")
    if own:
        yield Path(own) / file.path
    yield cache_folder() / file.path


def _digest(path: Path) -> str:
    raw = read_bytes(path, "the data file", "a readable file: check its permissions")
    return hashlib.sha256(raw).hexdigest()


def check(name: str) -> tuple[FileState, ...]:
    """Look for the files of a set and compare their hashes, one state each; nothing is downloaded.

    Raises ParameterError if there is no such set.
    """
    states = []
    for file in find_set(name).files:
        place = next((p for p in _places(file) if p.is_file()), None)
        states.append(FileState(file=file, place=place, sha256=_digest(place) if place else None))
    return tuple(states)


def fetch(name: str, *wanted: str, progress: Callable[[str], None] = lambda sentence: None) -> dict[str, Path]:
    """Make the files of a set available and say where they are.

    The folder that the environment variable SLIPANGLE_DATA names comes first, then the cache, then the
    origin. Every file's hash is compared every time.

    Parameters
    ----------
    name, *wanted : str
        The data set, and names of its files; by default all of them.
    progress : callable
        Is told each download in a sentence.

    Returns
    -------
    dict
        Path of each file, by name.

    Raises
    ------
    ParameterError
        If there is no such set or file.
    HashError
        If a file is not the published one; both hashes are named.
    MissingFileError
        If a file is not here and cannot be downloaded.
    """
    public = find_set(name)
    files = tuple(public.file(w) for w in wanted) or public.files
    return {file.name: _fetch_file(public, file, progress) for file in files}


def _fetch_file(public: PublicSet, file: PublicFile, progress: Callable[[str], None]) -> Path:
    for place in _places(file):
        if place.is_file():
            digest = _digest(place)
            if digest != file.sha256:
                raise HashError(
                    f"'{place}' has sha256 {digest}; expected {file.sha256}, the published {file.path} of "
                    f"'{public.name}': delete the file and fetch it again"
                )
            return place
    if not file.urls:
        raise MissingFileError(
            f"{file.path} of '{public.name}' is published nowhere and not on this machine; expected it below the "
            "folder that SLIPANGLE_DATA names: set that variable"
        )
    target = cache_folder() / file.path
    reasons: list[str] = []
    wrong = ""
    for url in file.urls:
        progress(f"downloading {file.path} from {url}")
        try:
            with urllib.request.urlopen(url, timeout=_TIMEOUT) as answer:
                raw = answer.read(_LARGEST + 1)
        except (urllib.error.URLError, http.client.HTTPException, OSError) as error:
            reasons.append(f"{url}: {getattr(error, 'reason', None) or error}")
            continue
        if len(raw) > _LARGEST:
            reasons.append(f"{url}: more than {_LARGEST / 1e6:g} MB")
            continue
        digest = hashlib.sha256(raw).hexdigest()
        if digest != file.sha256:
            wrong = wrong or f"{url} has sha256 {digest}"
            continue
        return write_atomic(target, raw)
    if wrong:
        raise HashError(
            f"{wrong}; expected {file.sha256}, the published {file.path} of '{public.name}': nothing was kept; look "
            "for the original elsewhere and put it below the folder that SLIPANGLE_DATA names"
        )
    raise MissingFileError(
        f"{file.path} of '{public.name}' is not on this machine and cannot be downloaded ({'; '.join(reasons)}); "
        "expected the network, or the file below the folder that SLIPANGLE_DATA names: connect, or set that variable"
    )
