"""A folder that `slipangle.export.build` wrote: its manifest, its library, and whether both are of this machine."""

from __future__ import annotations

import ctypes
import hashlib
import json
import platform
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.codegen import compiler
from slipangle.errors import ConfigError, FormatError, HashError
from slipangle.files import read_bytes

TESTED = 16  # steps of the recorded drive that a library repeats before it is used
AGREES = 1e-9  # largest difference of a command from the recorded one, relative to 1 + its size
EXPECTED = "a folder that 'slipangle build' wrote"


def machine(portable: bool) -> dict[str, Any]:
    """What a library depends on."""
    processor = "" if portable else hashlib.sha256(compiler.processor().encode()).hexdigest()
    own = {"system": platform.system(), "machine": platform.machine(), "bits": 8 * ctypes.sizeof(ctypes.c_void_p)}
    return {**own, "processor": processor}


class BuiltFolder:
    """A built folder, checked: no file was changed, and its library is for this machine.

    Parameters
    ----------
    folder : str or Path
        Where it is.

    Raises
    ------
    MissingFileError
        If a file is not there.
    FormatError
        If the manifest is none.
    HashError
        If a file is not the one that was built.
    ConfigError
        If it was built for another machine.
    """

    def __init__(self, folder: str | Path) -> None:
        self.path = Path(folder)
        self.record = record = self._manifest()
        self.made = made = record["build"]
        sums = {made["library"]: made["sha256"], "drive.csv": record["sha256"]["drive.csv"], **made.get("files", {})}
        for file, sum_ in sums.items():
            if hashlib.sha256(read_bytes(self.path / file, "the built controller's", EXPECTED)).hexdigest() != sum_:
                raise HashError(
                    f"'{file}' in '{folder}' is not the file that was built; expected it whole: build again"
                )
        for key, value in machine(not made["processor"]).items():
            if made[key] != value:
                said = "another processor" if key == "processor" else f"{key} {made[key]}, this one's is {value}"
                raise ConfigError(
                    f"'{folder}' was built for {said}; expected this machine: build it here, or there with --portable"
                )

    def _manifest(self) -> dict[str, Any]:
        try:
            record = json.loads(read_bytes(self.path / "manifest.json", "the manifest", EXPECTED))
            missing = {"build", "interface", "sizes", "sha256", "dt", "name", "kind"} - set(record)
        except (ValueError, TypeError) as error:
            if isinstance(error, OSError | FormatError) or type(error).__module__.startswith("slipangle"):
                raise
            raise FormatError(f"'{self.path / 'manifest.json'}' is no manifest; expected {EXPECTED}") from None
        if missing:
            raise FormatError(f"'{self.path}' was exported, not built (no {min(missing)}); expected {EXPECTED}")
        return record

    def library(self) -> ctypes.CDLL:
        """The library, loaded; raises ConfigError if that fails."""
        file = self.made["library"]
        try:
            return ctypes.CDLL(str((self.path / file).resolve()))
        except OSError as error:
            raise ConfigError(f"'{file}' cannot be loaded ({error}); expected this machine: build it here") from None

    def drive(self, columns: int) -> np.ndarray:
        """The beginning of the recorded drive, a row a step.

        Raises FormatError if it has not so many columns.
        """
        with (self.path / "drive.csv").open(encoding="utf-8") as file:
            rows = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2, max_rows=TESTED)
        if rows.shape[1] != columns:
            raise FormatError(f"'{self.path / 'drive.csv'}' has {rows.shape[1]} columns; expected those of the header")
        return rows

    def check_repeated(self, command: np.ndarray, recorded: np.ndarray) -> None:
        """Raise ConfigError if a command of the drive is another one than when it was recorded."""
        off = np.abs(command - recorded).max() / (1 + np.abs(recorded).max())
        if not off <= AGREES:
            raise ConfigError(
                f"the library of '{self.path}' decides otherwise than when it was built (by {off:.2g}); expected "
                f"{AGREES:g} at most: build it again, here"
            )


def loaded(kind: Any, folder: Path) -> Any:
    """What is in a folder, again, as of its pickle."""
    return kind(BuiltFolder(folder))


def memory(size: int) -> np.ndarray:
    """So many bytes, from a multiple of 64 on."""
    raw = np.zeros(size + 64, dtype=np.uint8)
    return raw[-raw.ctypes.data % 64 :]


def view(of: ctypes.Structure, name: str) -> np.ndarray:
    """A member that is an array, as one of NumPy."""
    return np.ctypeslib.as_array(getattr(of, name))


def numbers(*lengths: int) -> Any:
    """The type of an array of doubles."""
    kind: Any = ctypes.c_double
    for length in reversed(lengths):
        kind = kind * length
    return kind
