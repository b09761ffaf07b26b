"""Names on their way into C: a project's own must be one, a channel's is made one, and no text of a model is code."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable
from itertools import chain, count

from slipangle.errors import ParameterError, shown
from slipangle.export.reserved import is_reserved


def checked(name: str) -> str:
    """The name of an exported thing, with which its files and all its functions in C begin.

    Raises ParameterError unless it is a short lower-case identifier that means nothing in C, C++ or CMake.
    """
    if not (isinstance(name, str) and re.fullmatch(r"[a-z][a-z0-9_]{0,30}", name) and "__" not in name):
        raise ParameterError(
            f"the name is {shown(name)}; expected a lower-case identifier of C of at most 31 letters, such as 'car_mpc'"
        )
    if is_reserved(name):
        raise ParameterError(f"the name '{name}' is reserved in C, C++ or CMake; expected another, such as 'car_mpc'")
    return name


def constants(prefix: str, names: Iterable[str]) -> dict[str, str]:
    """A constant's name in C for each channel, all different: ``r[k-1]`` is ``PREFIX_R_K_1``."""
    made: dict[str, str] = {}
    for i, name in enumerate(names):
        word = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_").upper()[:40] or f"NUMBER_{i}"
        made[name] = different(f"{prefix}_{word}", made.values(), "_")
    return made


def different(name: str, taken: Container[str], between: str = " ") -> str:
    """The name, where it is taken with the first number from 2 on that makes it another one."""
    return next(n for n in chain((name,), (f"{name}{between}{i}" for i in count(2))) if n not in taken)


def comment(text: str) -> str:
    """Text that may stand in a comment of C: without what could end it, or be a line of its own."""
    return re.sub(r"[^A-Za-z0-9 _.,;:()\[\]{}+\-^/'=<>%]", " ", text.replace("*/", " ").replace("/*", " "))[:200]


def with_prefix(text: str, name: str) -> str:
    """A template, which calls everything ``car_...``, for a project of another name."""
    words = {"car": name, "CAR": name.upper()}
    return re.sub(r"(?:\b|(?<=-D))(car|CAR)(?=_|\b)", lambda m: words[m[0]], text)
