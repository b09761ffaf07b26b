"""ROS 1 and 2 bags and MCAP files, by rosbags: every topic is a clock of its own, with the numbers of its messages."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from slipangle.data.readers.recording import Recording
from slipangle.data.readers.registry import reader
from slipangle.data.readers.tables import Header
from slipangle.errors import FormatError, MissingColumnError, SlipangleError
from slipangle.extras import extra

_DEEPEST, _WIDEST = 8, 64  # messages in messages, and numbers of an array that become columns
_MAGIC = (b"#ROSBAG V2.0", b"\x89MCAP0\r\n")
_SKIPPED = ("header", "covariance", "__msgtype__")  # parts whose numbers are no signals


def _known(head: bytes) -> bool:
    return head.startswith(_MAGIC) or (head.startswith(b"SQLite format 3\0"))


@reader("ROS", recognises=_known, suffixes=(".bag", ".mcap", ".db3"), folders=True)
def read_ros(path: Path) -> Recording:
    """A bag of ROS 1, one of ROS 2 (its folder, or the file in it), or an MCAP file.

    Time is that of a message's header where it has one, else when it was recorded. [s]

    Raises FormatError if it is damaged, ConfigError if rosbags is not installed.
    """
    tables: dict[str, _Topic] = {}
    try:
        with _opened(path) as bag:
            for topic in dict.fromkeys(c.topic for c in bag.connections):
                fields = _first(bag, topic)
                if fields:
                    tables[topic] = _Topic(path, topic, tuple(fields))
    except SlipangleError:
        raise
    except Exception as error:  # of many kinds: it trusts every byte
        raise _damaged(path, error) from None
    return Recording(name=path.stem, tables=tables)  # type: ignore[arg-type]  # a topic is a table


def _damaged(path: Path, error: Exception) -> FormatError:
    why = (str(error).splitlines() or [type(error).__name__])[0][:120]
    return FormatError(
        f"'{path}' cannot be read as a bag ({why}); expected a whole one: reindex, copy or record it again"
    )


def _opened(path: Path) -> Any:
    bags = extra("rosbags.highlevel", "io", "reading a bag")
    types = extra("rosbags.typesys", "io", "reading a bag")
    return bags.AnyReader([path], default_typestore=types.get_typestore(types.Stores.ROS2_HUMBLE))


def _first(bag: Any, topic: str) -> dict[str, float]:
    """Names of the numbers in a topic's first message."""
    own = [c for c in bag.connections if c.topic == topic]
    for connection, _, raw in bag.messages(connections=own):
        return dict(_numbers(bag.deserialize(raw, connection.msgtype), "", 0))
    return {}


def _numbers(message: Any, above: str, depth: int) -> Iterator[tuple[str, float]]:
    """Every number in a message, by the names on the way to it."""
    if depth > _DEEPEST:
        return
    for name in getattr(message, "__dataclass_fields__", ()):
        if any(word in name for word in _SKIPPED):
            continue
        value, way = getattr(message, name), f"{above}.{name}" if above else name
        if isinstance(value, bool | int | float | np.number):
            yield way, float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf" and value.size <= _WIDEST:
            for k, number in enumerate(value.ravel().tolist()):
                yield f"{way}[{k}]", float(number)
        elif hasattr(value, "__dataclass_fields__"):
            yield from _numbers(value, way, depth + 1)


def _stamp(message: Any, recorded: int) -> float:
    """When a message was measured, in seconds. [s]"""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    seconds = getattr(stamp, "sec", 0)
    return seconds + 1e-9 * stamp.nanosec if stamp is not None and seconds else 1e-9 * recorded


class _Topic:
    """The messages of one topic, read when a column is first asked for."""

    named = True

    def __init__(self, path: Path, topic: str, fields: tuple[str, ...]) -> None:
        self._path, self._topic, self._fields = path, topic, fields
        self.name = f"topic {topic} of '{path.name}'"
        self.headers = (Header(text="t", name="t", unit="s"), *(Header(text=f, name=f) for f in fields))

    def numbers(self, column: int) -> np.ndarray:
        """One column, shape (n_messages,)."""
        return self._rows[:, column]

    def row_name(self, row: int) -> str:
        """The message counted from 1."""
        return f"message {row + 1}"

    @cached_property
    def _rows(self) -> np.ndarray:
        rows: list[list[float]] = []
        try:
            with _opened(self._path) as bag:
                own = [c for c in bag.connections if c.topic == self._topic]
                for connection, recorded, raw in bag.messages(connections=own):
                    message = bag.deserialize(raw, connection.msgtype)
                    values = dict(_numbers(message, "", 0))
                    rows.append([_stamp(message, recorded), *(values.get(f, np.nan) for f in self._fields)])
        except SlipangleError:
            raise
        except Exception as error:  # of many kinds: it trusts every byte
            raise _damaged(self._path, error) from None
        if not rows:
            raise MissingColumnError(f"{self.name} has no message; expected some")
        table = np.array(rows, dtype=float)
        return table[np.argsort(table[:, 0], kind="stable")]
