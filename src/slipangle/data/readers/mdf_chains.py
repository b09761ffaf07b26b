"""The chains of blocks in an MDF file, followed once before a library does, which goes round for ever in a damaged one.

References
----------
.. [1] ASAM MDF 4.1, Measurement Data Format, Programmers Guide, sec. 4 (blocks and links); MDF 3.3, sec. 2.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

from slipangle.errors import FormatError

_LINKS4 = {  # which links of a block of MDF 4 lead on, to a block that no other one leads to
    **{b"##HD": (0, 1, 2, 3, 4), b"##DG": (0, 1, 2), b"##CG": (0, 1), b"##CN": (0, 1), b"##CA": (0,)},
    **{b"##DL": (0,), b"##HL": (0,), b"##FH": (0,), b"##CH": (0, 1), b"##AT": (0,), b"##EV": (0,)},
}
_LINKS3 = {b"HD": (0,), b"DG": (0, 1), b"CG": (0, 1), b"CN": (0,)}  # the same of MDF 3


def require_chains(raw: bytes, path: Path) -> None:
    """Raise a FormatError if a block is reached twice: its chain has no end."""
    order = "<" if len(raw) < 26 or raw[24:26] == b"\0\0" else ">"
    links_of: Callable[[int], list[int]]
    if raw[8:9] >= b"4":
        links_of = lambda at: _links(raw, at, _LINKS4, 4, 16, struct.Struct("<Q"), 24)  # noqa: E731
    else:
        links_of = lambda at: _links(raw, at, _LINKS3, 2, 0, struct.Struct(f"{order}I"), 4)  # noqa: E731
    seen, waiting = {64}, [64]
    while waiting:
        for following in links_of(waiting.pop()):
            if following in seen:
                raise FormatError(
                    f"'{path}' is a damaged MDF file (two ways lead to its byte {following}); expected a whole one: "
                    "copy or export it again"
                )
            seen.add(following)
            waiting.append(following)


def _links(
    raw: bytes, at: int, kinds: dict[bytes, tuple[int, ...]], letters: int, count: int, word: struct.Struct, first: int
) -> list[int]:
    """Where the links of a block lead that are followed; none for a block of another kind."""
    wanted = kinds.get(raw[at : at + letters])
    if wanted is None or at + first > len(raw):
        return []
    held = word.unpack_from(raw, at + count)[0] if count else len(wanted)
    found = []
    for k in wanted:
        place = at + first + k * word.size
        if k < held and place + word.size <= len(raw):
            to = int(word.unpack_from(raw, place)[0])
            if to and raw[to : to + letters] in kinds:
                found.append(to)
    return found
