"""Names on their way into C: a project's own must be one, a channel's is made one, and no text of a model is code."""

from __future__ import annotations

import re
from collections.abc import Iterable

from slipangle.errors import ParameterError, shown

RESERVED = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if inline int long register "
    "restrict return short signed sizeof static struct switch typedef union unsigned void volatile while asm fortran "
    "alignas alignof and and_eq bitand bitor bool catch char8_t char16_t char32_t class co_await co_return co_yield "
    "compl concept consteval constexpr constinit const_cast decltype delete dynamic_cast explicit export false friend "
    "mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public reinterpret_cast "
    "requires static_assert static_cast template this thread_local throw true try typeid typename using virtual "
    "wchar_t xor xor_eq main std linux unix i386 near far errno stdin stdout stderr".split()
)
"""Words of C and C++, and what their libraries and compilers define."""


def checked(name: str) -> str:
    """The name of an exported thing, with which its files and all its functions in C begin.

    Raises ParameterError unless it is a short lower-case identifier that means nothing in C or C++.
    """
    if not (isinstance(name, str) and re.fullmatch(r"[a-z][a-z0-9_]{0,30}", name) and "__" not in name):
        raise ParameterError(
            f"the name is {shown(name)}; expected a lower-case identifier of C of at most 31 letters, such as 'car_mpc'"
        )
    if name in RESERVED or name.endswith("_t"):
        raise ParameterError(f"the name '{name}' is reserved in C or C++; expected another one, such as '{name}_mpc'")
    return name


def constants(prefix: str, names: Iterable[str]) -> dict[str, str]:
    """A constant's name in C for each channel, all different: ``r[k-1]`` is ``PREFIX_R_K_1``."""
    made: dict[str, str] = {}
    for i, name in enumerate(names):
        word = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").upper()[:40] or f"NUMBER_{i}"
        word = f"{prefix}_{word}"
        made[name] = word if word not in made.values() else f"{word}_{i}"
    return made


def comment(text: str) -> str:
    """Text that may stand in a comment of C: without what could end it, or be a line of its own."""
    return re.sub(r"[^A-Za-z0-9 _.,;:()\[\]{}+\-^/'=<>%]", " ", text.replace("*/", " ").replace("/*", " "))[:200]


def with_prefix(text: str, name: str) -> str:
    """A template, which calls everything ``car_...``, for a project of another name."""
    words = {"car": name, "CAR": name.upper()}
    return re.sub(r"(?:\b|(?<=-D))(car|CAR)(?=_|\b)", lambda m: words[m[0]], text)
