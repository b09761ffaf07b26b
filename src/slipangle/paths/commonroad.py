"""Lanes of CommonRoad scenarios (XML, format versions 2018 and 2020): the centre line of lanelets in a row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from slipangle.errors import FormatError, ParameterError
from slipangle.files import read_bytes

MOST_LANELETS = 10_000


@dataclass(frozen=True, kw_only=True)
class Lane:
    """Lanelets one after another: points of the centre line and half widths there, shape (n,), their numbers. [m]

    ``closed`` says whether the last one leads to the first.
    """

    X: np.ndarray
    Y: np.ndarray
    half: np.ndarray
    lanelets: tuple[int, ...]
    closed: bool


@dataclass(frozen=True)
class _Lanelet:
    left: np.ndarray
    right: np.ndarray
    follows: tuple[int, ...]


def is_commonroad(head: bytes) -> bool:
    """Whether the beginning of a file is that of a scenario."""
    return b"<commonRoad" in head


def read_lane(file: str | Path, lanelets: Sequence[int] = ()) -> Lane:
    """The lane of a scenario that begins with a lanelet and goes on where only one follows.

    Parameters
    ----------
    file : str or Path
        XML in UTF-8.
    lanelets : sequence of int
        Numbers of the lanelets in driving order; one alone is where to begin; none where the scenario has a single
        beginning.

    Raises
    ------
    MissingFileError
        If there is no such file.
    FormatError
        If it is no such scenario, or damaged.
    ParameterError
        If the lane forks or begins at several places and ``lanelets`` does not say which, or names what is not there.
    """
    known = _lanelets(Path(file))
    row: Sequence[int] = tuple(lanelets) if len(lanelets) > 1 else _row(known, tuple(lanelets), str(file))
    for number in row:
        if number not in known:
            raise ParameterError(
                f"'{file}' has no lanelet {number}; expected one of {_some(known)}: correct the number"
            )
    for a, b in pairwise(row):
        if b not in known[a].follows:
            raise ParameterError(
                f"lanelet {b} of '{file}' does not follow {a}; expected {_some(known[a].follows) or 'none'}: name "
                "lanelets in driving order"
            )
    left = np.vstack([known[n].left for n in row])
    right = np.vstack([known[n].right for n in row])
    middle = (left + right) / 2
    new = np.concatenate([[True], np.hypot(*np.diff(middle, axis=0).T) > 1e-6])
    half = np.hypot(*(left - right).T) / 2
    return Lane(
        X=middle[new, 0],
        Y=middle[new, 1],
        half=half[new],
        lanelets=tuple(row),
        closed=row[0] in known[row[-1]].follows,
    )


def _row(known: dict[int, _Lanelet], first: tuple[int, ...], file: str) -> tuple[int, ...]:
    """From the first lanelet on, as far as one alone follows."""
    after = {b for lanelet in known.values() for b in lanelet.follows}
    starts = list(first) or [n for n in known if n not in after] or [min(known)]
    if len(starts) > 1:
        raise ParameterError(
            f"'{file}' begins at {len(starts)} lanelets, {_some(starts)}; expected one: say which with "
            f"lanelets=({starts[0]},)"
        )
    row = [starts[0]]
    while row[-1] in known and known[row[-1]].follows:
        follows = known[row[-1]].follows
        if len(follows) == 1 and follows[0] in row:
            break
        if len(follows) > 1:
            raise ParameterError(
                f"after lanelet {row[-1]} of '{file}' come {_some(follows)}; expected one: name all in driving "
                f"order with lanelets=({', '.join(map(str, row[-3:]))}, ...)"
            )
        row += follows
    return tuple(row)


def _some(numbers: Sequence[int] | dict[int, _Lanelet]) -> str:
    listed = [str(n) for n in numbers]
    return ", ".join(listed[:12]) + (f" and {len(listed) - 12} more" if len(listed) > 12 else "")


def _lanelets(file: Path) -> dict[int, _Lanelet]:
    raw = read_bytes(file, "the track", "a CommonRoad scenario: check the path")
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw or b"\0" in raw:
        raise FormatError(f"'{file}' declares a document type; expected a plain CommonRoad scenario in UTF-8")
    try:
        root = ElementTree.fromstring(raw)
        nodes = [node for node in root if node.tag == "lanelet"]
        found = {int(node.get("id", "")): _lanelet(node) for node in nodes[: MOST_LANELETS + 1]}
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise FormatError(
            f"'{file}' is no whole CommonRoad scenario ({str(error)[:80]}); expected lanelets with numbers, bounds and "
            "points: export it again"
        ) from None
    if not found or len(nodes) > MOST_LANELETS:
        raise FormatError(f"'{file}' has {len(nodes)} lanelets; expected 1 to {MOST_LANELETS}: use another scenario")
    return found


def _lanelet(node: ElementTree.Element) -> _Lanelet:
    left, right = (_points(node.find(side)) for side in ("leftBound", "rightBound"))
    if len(left) != len(right):
        longer = max(len(left), len(right))
        left, right = (_evenly(points, longer) for points in (left, right))
    follows = tuple(int(child.get("ref", "")) for child in node if child.tag == "successor")
    return _Lanelet(left, right, follows)


def _points(side: ElementTree.Element | None) -> np.ndarray:
    points = [] if side is None else [(p.findtext("x", ""), p.findtext("y", "")) for p in side if p.tag == "point"]
    if len(points) < 2:
        raise ValueError(f"a bound of {len(points)} points")
    values = np.array([[float(x), float(y)] for x, y in points])
    if not np.isfinite(values).all():
        raise ValueError("a point that is not finite")
    return values


def _evenly(points: np.ndarray, count: int) -> np.ndarray:
    """As many points, evenly over the length."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    wanted = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(wanted, along, column) for column in points.T])
