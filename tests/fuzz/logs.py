"""Logs of every format, damaged byte by byte, cell by cell and word by word; see `tests.fuzz.targets`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.mutate import Rng, bytes_of, encoded, text_of


@cache
def _whole(name: str) -> bytes:
    """A sound file of a format."""
    from tests.data.readers import logs, test_formats

    made = logs.drive(40)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        if name == "parquet":
            test_formats.parquet(path)
        elif name == "feather":
            test_formats.feather(path)
        elif name == "mat73":
            test_formats.mat73(path)
        elif name == "mat5":
            test_formats.mat5(path)
        elif name == "mat73-labels":
            logs.write_mat73(path, logs.labelled(made))
        elif name in ("timetables-v7", "timetables-v73"):
            path = test_formats.timetables(Path(folder), name.removeprefix("timetables-"))
        elif name == "mat5-labels":
            logs.write_mat5(path, logs.labelled(made))
        elif name in ("mdf3", "mdf4"):
            test_formats.mdf(path)
        elif name == "ld":
            test_formats.ld(path)
        elif name == "bag":
            path = logs.write_bag(path.with_suffix(".bag"), made, ros=1)
        elif name in ("db3", "mcap"):
            path = next(logs.write_bag(path, made, ros=2 if name == "db3" else 3).glob(f"*.{name}"))
        else:
            t = 0.2 * np.arange(20)
            text = {
                "gpx": lambda: logs.gpx(48 + 1e-5 * t, 11 + 1e-5 * t, t),
                "kml": lambda: logs.kml(48 + 1e-5 * t, 11 + 1e-5 * t, t),
                "motec": lambda: logs.motec_csv(made),
                "racecapture": lambda: logs.race_capture(made),
            }[name]()
            path.write_text(text)
        return path.read_bytes()


def maker(*names: str, suffix: str, text: bool = False) -> Callable[[Rng], tuple[str, bytes, dict[str, Any]]]:
    """What makes damaged files of these formats; the headers more often than what is behind them."""

    def make(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
        raw = _whole(str(rng.choice(names)))
        if text and rng.random() < 0.8:
            damaged = encoded(rng, text_of(rng, raw.decode()))
        elif rng.random() < 0.5 and len(raw) > 600:
            end = int(rng.choice([64, 600, len(raw) // 2]))
            damaged = bytes_of(rng, raw[:end]) + raw[end:]
        else:
            damaged = bytes_of(rng, raw)
        options: dict[str, Any] = {}
        if rng.random() < 0.5:
            options["nan"] = str(rng.choice(["error", "gap", "merge"]))
        if rng.random() < 0.2:
            options["dt"] = float(rng.choice([0.01, 0.05, 1.0, 1e-9]))
        return f"run{suffix}", damaged, options

    return make


def read_log(path: Path, **options: Any) -> None:
    """Every channel at its own rate, then all of them on one clock."""
    from slipangle.data.readers import open_log, read
    from slipangle.errors import SlipangleError

    log = open_log(path)
    for name in log.names:
        try:
            signal = log.signal(name)
        except SlipangleError:
            continue
        assert np.isfinite(signal.values).all()
    data = read(path, **options)
    assert np.isfinite(data.values).all()


_WORDS = (
    "a",
    "b",
    "'x y'",
    "t",
    "9",
    "1e308",
    "pi",
    "sin(",
    "atan2(",
    "heading(",
    ")",
    "(",
    ",",
    "+",
    "**",
    "-",
    "/",
    "<",
)
_WORDS += (
    "and",
    "or",
    "not",
    "==",
    "lambda",
    "__import__",
    ".",
    "[",
    "]",
    ":",
    "if",
    "else",
    "'",
    '"',
    "\\",
    "\0",
    "0x",
    "_",
)


def make_expression(rng: Rng) -> tuple[str, bytes, dict[str, Any]]:
    """Words of expressions, and of what is none, in any order."""
    words = rng.choice(_WORDS, size=int(rng.choice([1, 3, 5, 9, 40, 300])))
    return "job.txt", " ".join(words.tolist()).encode(), {}


def read_expression(path: Path) -> None:
    """An expression of three channels."""
    from slipangle.data.expression import Expression

    expression = Expression(path.read_text())
    values = {name: np.linspace(-1, 1, 5) for name in expression.names}
    assert expression(values).size in (1, 5)
