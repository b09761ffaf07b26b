"""Headings, which start again after a full turn: what is between two samples lies on the circle, not across it."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from slipangle import units
from slipangle.data.channels import STANDARD

TURN = 2 * np.pi
_WORDS = ("heading", "course", "azimuth", "bearing", "compass", "hdg", "yaw", "gierwinkel", "kurs")
_WHOLE = re.compile(
    "(gps|gnss)?(cog|track|tracktrue|truetrack|trackangle|trackmadegood)(gps|gnss)?"
)  # CoG may be a place
_OTHERS = ("rate", "vel", "speed", "acc", "dot", "moment", "torque", "steer", "wheel", "lenk", "std", "sigma", "delta")
_WIDEST = 2.002  # turns from the smallest value to the largest: of more, numbers that leap are no wrapped angles


def is_heading(name: str, unit: str | None) -> bool:
    """Whether a channel is an angle on the circle, by its name and the quantity of its unit; never one of steering.

    A channel called ``psi`` is one without a unit, too.

    >>> is_heading("psi", "-"), is_heading("Yaw angle", "deg"), is_heading("yaw", "deg/s"), is_heading("delta", "rad")
    (True, True, False, False)
    """
    angle = unit is not None and units.known(unit) and units.quantity(unit) == "angle"
    if name in STANDARD:
        return name == "psi" and (angle or unit in (None, "-"))
    plain = re.sub("[^a-z]", "", name.lower())
    named = (
        any(word in plain for word in _WORDS) or _WHOLE.fullmatch(plain) or "psi" in re.split("[^a-z]+", name.lower())
    )
    return angle and bool(named) and not any(word in plain for word in _OTHERS)


def wraps(x: np.ndarray, turn: float = TURN) -> np.ndarray:
    """Rows after which an angle, shape (n,), leaps by more than half a ``turn``, which is in its own unit.

    None at all where it spans more than two turns: these are other numbers, or a wrong unit.

    >>> wraps(np.array([3.0, 3.1, -3.1, -3.0]))
    array([1])
    """
    if len(x) < 2 or not np.ptp(x) <= _WIDEST * turn:
        return np.zeros(0, dtype=int)
    return np.flatnonzero(np.abs(np.diff(x)) > 0.5 * turn)


def unwrapped(x: np.ndarray, turn: float = TURN) -> np.ndarray:
    """The same angles, shape (n,), all finite, without their `wraps`: whole turns are added, and nothing else.

    >>> unwrapped(np.array([350.0, 355.0, 0.0, 5.0]), 360.0).tolist()
    [350.0, 355.0, 360.0, 365.0]
    """
    if not len(wraps(x, turn)):
        return x
    turns = np.concatenate([[0.0], np.cumsum(np.round(np.diff(x) / turn))])
    return x - turn * turns


def continued(table: np.ndarray, names: Sequence[str], unit_of: Sequence[str]) -> tuple[np.ndarray, tuple[str, ...]]:
    """One record, shape (n, n_channels), SI, with its headings unwrapped; and which ones did wrap.

    The very same table where none did.
    """
    headings = [k for k, (name, unit) in enumerate(zip(names, unit_of, strict=True)) if is_heading(name, unit)]
    wrapped = [k for k in headings if len(wraps(table[:, k]))]
    if wrapped:
        table = table.copy()
        for k in wrapped:
            table[:, k] = unwrapped(table[:, k])
    return table, tuple(names[k] for k in wrapped)


def wrap_note(names: Sequence[str]) -> tuple[str, ...]:
    """A note on headings that were unwrapped; none where there are none."""
    if not names:
        return ()
    wrap = "wraps" if len(set(names)) == 1 else "wrap"
    return (f"{', '.join(dict.fromkeys(names))} {wrap}: leaps of a full turn are taken out",)
