"""How much memory a C struct takes, from its source: who calls exported code provides it before that is compiled."""

from __future__ import annotations

import re

from slipangle.errors import ParameterError

_SIZES = {"double": 8, "int64_t": 8, "int": 4, "char": 1, "float": 4}
_POINTER = 8  # at most


def size_of(source: str, struct: str, lanes: int, number: int = 8) -> int:
    """Bytes of a struct with vectors of ``lanes`` numbers, on any machine at most.

    Parameters
    ----------
    source : str
        C in which the struct, and what it is made of, are ``typedef struct {...} NAME;`` of arrays whose lengths are
        sums and products of ``#define``.
    struct : str
        Its name.
    lanes : int
        Numbers per vector.
    number : int
        Bytes of one of these.

    Raises
    ------
    ParameterError
        If it has a member of another kind.
    """
    text = re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)
    macros = {"LANES": str(lanes)}
    for name, value in re.findall(r"^#define (\w+) (.+)$", text, re.MULTILINE):
        macros.setdefault(name, value)
    for listed in re.findall(r"^enum \{([^}=]*)\}", text, re.MULTILINE):
        macros.update({name.strip(): str(i) for i, name in enumerate(listed.split(","))})
    known = {kind: (size, size) for kind, size in _SIZES.items()}
    known["V"] = known["I"] = (number * lanes, number * lanes)
    found = {name: body for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", text, re.DOTALL)}

    def measure(name: str) -> tuple[int, int]:
        """Size and alignment of a type."""
        if re.fullmatch(r"car\w*_seconds", name):
            return 8, 8
        if name not in known:
            if name not in found:
                raise ParameterError(f"'{name}' is no struct of this source; expected one: name another")
            known[name] = _layout(found[name])
        return known[name]

    def _layout(body: str) -> tuple[int, int]:
        at, widest = 0, 1
        lines = "\n".join(line for line in body.splitlines() if not line.lstrip().startswith("#"))
        for member in filter(None, (m.strip() for m in lines.split(";"))):
            for size, unit in _members(member):
                at = -(-at // unit) * unit + size
                widest = max(widest, unit)
        return -(-at // widest) * widest, widest

    def _members(member: str) -> list[tuple[int, int]]:
        if "(*" in member or member.startswith("void *"):
            return [(_POINTER, _POINTER)]
        aligned = "WIDE_ROW" in member
        words = re.match(r"(?:WIDE_ROW )?(?:const )?(long long int|\w+)\s*(.*)", member, re.DOTALL)
        if words is None:
            raise ParameterError(f"the member '{member[:60]}' of a struct is not understood: expected an array")
        kind = "int64_t" if words[1] == "long long int" else words[1]
        made = []
        for declared in words[2].split(","):
            size, unit = (_POINTER, _POINTER) if "*" in declared.partition("[")[0] else measure(kind)
            for length in re.findall(r"\[([^\]]+)\]", declared):
                size *= _value(length, macros)
            made.append((size, number * lanes if aligned else unit))
        return made

    return measure(struct)[0]


def _value(expression: str, macros: dict[str, str]) -> int:
    """A length in C as a number."""
    while True:
        text = re.sub(r"\bM1\(", "_M1(", expression)
        text = re.sub(r"\b[A-Z]\w*\b(?!\()", lambda m: f"({macros[m[0]]})" if m[0] in macros else m[0], text)
        if text == expression or not re.search(r"\b[A-Z]\w*\b(?!\()", text):
            break
        expression = text
    plain = text.replace("/", "//")
    if not re.fullmatch(r"[\d\s+\-*/()]*", plain.replace("_M1", "")):
        raise ParameterError(f"the length '{expression[:60]}' of an array in C is not understood: expected a number")
    return int(eval(plain, {"__builtins__": {}, "_M1": lambda n: max(n, 1)}))
