"""Text and numbers as files hold them, read strictly: what only Python takes for a number is none."""

from pathlib import Path

from slipangle.errors import FormatError, raises


def to_number(text: str) -> float:
    """The number in a cell, blanks around it allowed; "nan" and "inf" are numbers too.

    Raises ValueError if there is none.

    >>> to_number(" 1.5e3 ")
    1500.0
    >>> to_number("1_0")
    Traceback (most recent call last):
    ValueError: '1_0' is no number
    """
    if "_" in text or not text.isascii():  # float() takes 1_0 for 10, and digits of other scripts
        raise ValueError(f"{text[:40]!r} is no number")
    return float(text)


def is_number(text: str) -> bool:
    """Whether `to_number` reads it."""
    return not raises(ValueError, to_number, text)


def decoded(raw: bytes, path: str | Path, what: str) -> str:
    """The text of a file in whichever common encoding it has: UTF-8, UTF-16 with its mark, else Latin-1.

    Raises FormatError if it is no text.
    """
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    if b"\0" in raw[:4096]:
        raise FormatError(f"'{path}' is not a text file; expected {what}")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")
