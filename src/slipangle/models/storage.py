"""Save and load models as readable text: JSON with arrays as rows of numbers, no pickle.

A file names its format's version, the class and every field. Numbers are written with as many digits as it takes to
read the same bits again. Loading creates records of this package's own classes and of those in `RECORDS` only, and runs
nothing from the file.
"""

import importlib
import importlib.metadata
import json
import math
import pkgutil
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from inspect import isabstract
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from slipangle.errors import FormatError, MissingFileError, ModelWarning, ParameterError, SlipangleError, nearest, shown
from slipangle.files import write_atomic
from slipangle.ops import is_symbolic
from slipangle.registry import Registry

FORMAT = "slipangle record"
VERSION = 1
_MODULES = ("slipangle.data.readers.tir", "slipangle.data.readers.tir_lines")  # beside every module of slipangle.models
_DTYPES = ("float64", "int64", "bool")
RECORDS: Registry[type] = Registry("record", "slipangle.records")
"""Dataclasses of others that a file may name: ``@RECORDS.register("Spinner")``."""
_WORDS = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}


def save(record: Any, path: str | Path, *, classes: Sequence[type] = ()) -> Path:
    """Write a model, tire, network or parameter set to a file, whole or not at all.

    Raises ParameterError if a field holds something that a readable file cannot keep, such as a function or a symbol,
    WriteError if the place cannot be written.

    Parameters
    ----------
    record : Model, Tire, Network, ParameterSet or FitInfo
        What to keep; everything it is made of goes into the same file.
    path : str or Path
        Such as ``"car.json"``.
    classes : sequence of type
        Dataclasses of your own that the record is made of; `load` needs the same.
    """
    if not is_dataclass(record) or isinstance(record, type):
        raise ParameterError(f"a {type(record).__name__} was to be saved; expected a model, tire or parameter set")
    content = {
        "format": FORMAT,
        "version": VERSION,
        "written by": f"slipangle {importlib.metadata.version('slipangle')}",
        "record": _encode(record, type(record).__name__, _known(tuple(classes))),
    }
    return write_atomic(path, _text(content) + "\n")


def load(path: str | Path, *, classes: Sequence[type] = ()) -> Any:
    """The record in a file that `save` wrote, equal to the last bit.

    ``classes`` are dataclasses of your own that the record is made of. Raises MissingFileError if there is no such
    file, FormatError if `save` did not write it, it is of another version, names an unknown class or field, or lacks
    one, and ParameterError if a value is out of range. A model whose parameters were changed by hand comes back without
    what was said of its fit, with a ModelWarning.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise MissingFileError(
            f"'{file}' cannot be read ({error.strerror or error}); expected a file that slipangle saved: check the path"
        ) from None
    except UnicodeDecodeError:
        raise FormatError(f"'{file}' is not text; expected a file that slipangle saved") from None
    try:
        content = json.loads(text, parse_constant=_no_constant)
    except (json.JSONDecodeError, RecursionError, ValueError) as error:
        raise FormatError(f"'{file}' is not JSON ({error}); expected a file that slipangle saved, whole") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FormatError(f'\'{file}\' does not say "format": "{FORMAT}"; expected a file that slipangle saved')
    version = content.get("version")
    if version != VERSION or isinstance(version, bool):
        writer = str(content.get("written by", "unknown"))[:60]
        raise FormatError(
            f"'{file}' is of format version {shown(version)} (written by {writer}), this "
            f"slipangle reads version {VERSION}; expected the same: use the slipangle that wrote it, or save again"
        )
    try:
        record = _Reader(str(file), _known(tuple(classes))).decode(content.get("record"), "the record")
    except RecursionError:
        raise FormatError(f"'{file}' is nested too deeply; expected a file that slipangle saved") from None
    if not is_dataclass(record):
        raise FormatError(f"'{file}' holds no record; expected one under \"record\": the file was changed")
    return _as_fitted(record, file)


def _as_fitted(record: Any, file: Path) -> Any:
    """The record, without its ``fit_info`` if that tells of other parameters, of which nothing read since says why."""
    info = getattr(record, "fit_info", None)
    if info is None or info.corrections or not hasattr(record, "parameter_names"):
        return record
    told = dict(zip(info.names, map(float, info.values), strict=True))
    there = {n: (v, float(record.value(n))) for n, v in told.items() if n in record.parameter_names}
    other = {n: pair for n, pair in there.items() if not math.isclose(*pair, rel_tol=1e-9, abs_tol=1e-12)}
    if not other:
        return record
    name, (fitted, value) = next(iter(other.items()))
    warnings.warn(
        f"in '{file}' {name} is {value:g}, where its fit found {fitted:g}; expected the same: what was said of the fit "
        "is left out, intervals too",
        ModelWarning,
        stacklevel=3,
    )
    return replace(record, fit_info=None)


def _known(extra: tuple[type, ...]) -> dict[str, type]:
    """Every dataclass that a file may name."""
    return {**_built_in(), **RECORDS, **{c.__name__: c for c in extra}}


@cache
def _built_in() -> dict[str, type]:
    classes: dict[str, type] = {}
    package = importlib.import_module("slipangle.models")
    names = [module.name for module in pkgutil.walk_packages(package.__path__, "slipangle.models.")]
    for name in (*names, *_MODULES):
        for value in vars(importlib.import_module(name)).values():
            if isinstance(value, type) and is_dataclass(value) and value.__module__ == name:
                classes[value.__name__] = value
    return {n: c for n, c in classes.items() if not isabstract(c)}


def _kept(cls: type) -> dict[str, Any]:
    """Fields that the constructor takes, by name."""
    return {f.name: f for f in fields(cls) if f.init}


# ---- from objects to JSON -----------------------------------------------------------------------------------------


def _encode(value: Any, where: str, known: Mapping[str, type]) -> Any:
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else {"float": _word(float(value))}
    value = value.item() if isinstance(value, np.generic) else value
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, np.ndarray):
        return _encode_array(value, where)
    if is_dataclass(value) and not isinstance(value, type):
        name = type(value).__name__
        if known.get(name) is not type(value) and type(value).__module__.startswith("slipangle."):
            raise ParameterError(
                f"{where} is of class {name}, which no model is made of; expected a model, tire or parameter set: "
                "data are written by slipangle.write"
            )
        if known.get(name) is not type(value):
            raise ParameterError(
                f"{where} is of class {name}, which is not slipangle's own; expected it in classes=[...] of both "
                "save and load, or registered in slipangle.models.storage.RECORDS"
            )
        content = {key: _encode(getattr(value, key), f"{where}.{key}", known) for key in _kept(type(value))}
        return {"class": name, "fields": content}
    if isinstance(value, (tuple, list)) and not hasattr(value, "_fields"):
        return [_encode(v, f"{where}[{i}]", known) for i, v in enumerate(value)]
    if isinstance(value, Mapping) and all(isinstance(k, str) for k in value):
        return {"map": {k: _encode(v, f"{where}[{k!r}]", known) for k, v in value.items()}}
    if callable(value):
        raise ParameterError(
            f"{where} is a function, which a readable file cannot keep; expected numbers, text or records: save "
            "model.recorded() where the model is an Ode, or write the function as a frozen dataclass with __call__ and "
            "name that class in classes=[...] of both save and load"
        )
    kind = "a symbol" if is_symbolic(value) else f"a {type(value).__name__}"
    raise ParameterError(f"{where} holds {kind}; expected numbers, text or records, which is what a file can keep")


def _encode_array(value: np.ndarray, where: str) -> Any:
    if value.dtype.name not in _DTYPES:
        raise ParameterError(f"{where} is an array of {value.dtype.name}; expected one of {', '.join(_DTYPES)}")
    flat = value.ravel().tolist()
    if value.dtype == float:
        flat = [v if math.isfinite(v) else _word(v) for v in flat]
    rows: Any = flat
    for n in reversed(value.shape[1:]):
        rows = [rows[i : i + n] for i in range(0, len(rows), n)] if n else []
    coded = {"array": rows}
    if value.dtype != float:
        coded["dtype"] = value.dtype.name
    if value.size == 0 or value.ndim == 0:
        coded["shape"] = list(value.shape)
    return coded


def _word(value: float) -> str:
    return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"


def _text(value: Any, indent: str = "") -> str:
    """JSON with one line per field and one line per row of an array."""
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{deeper}{json.dumps(k, ensure_ascii=False)}: {_text(v, deeper)}" for k, v in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(value, list) and any(isinstance(v, (dict, list)) for v in value):
        return "[\n" + ",\n".join(f"{deeper}{_text(v, deeper)}" for v in value) + f"\n{indent}]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


# ---- from JSON to objects -----------------------------------------------------------------------------------------


def _no_constant(word: str) -> float:
    raise ValueError(f"{word} stands where a number belongs")


class _Reader:
    """Decodes one file; its errors name the file and the place in it."""

    def __init__(self, file: str, known: Mapping[str, type]) -> None:
        self.file, self.known = file, known

    def decode(self, value: Any, where: str) -> Any:
        if isinstance(value, list):
            return tuple(self.decode(v, f"{where}[{i}]") for i, v in enumerate(value))
        if not isinstance(value, dict):
            return value
        if "class" in value:
            return self._record(value, where)
        if "array" in value:
            return self._array(value, where)
        if set(value) == {"float"} and isinstance(value["float"], str) and value["float"] in _WORDS:
            return _WORDS[value["float"]]
        if set(value) == {"map"} and isinstance(value["map"], dict):
            return {k: self.decode(v, f"{where}[{k!r}]") for k, v in value["map"].items()}
        raise self._wrong(where, f"has the keys {shown(sorted(value)[:6])}; expected 'class' or 'array'")

    def _wrong(self, what: str, said: str) -> FormatError:
        return FormatError(f"{what} in '{self.file}' {said}")

    def _record(self, value: dict, where: str) -> Any:
        name, given = value["class"], value.get("fields")
        cls = self.known.get(name) if isinstance(name, str) else None
        if cls is None:
            own = f"{nearest(str(name), self.known)}: update slipangle, or name a class of your own in classes=[...]"
            raise self._wrong(where, f"is of unknown class {shown(name)}; {own}")
        if not isinstance(given, dict):
            raise self._wrong(name, 'has no fields; expected "fields": {...}')
        expected, other = _kept(cls), "the file is of another slipangle, or was changed"
        for key in given:
            if key not in expected:
                raise self._wrong(name, f"has an unknown field '{key}'; {nearest(key, expected)}: {other}")
        missing = [k for k, f in expected.items() if k not in given and "may be missing in a file" not in f.metadata]
        if missing:
            raise self._wrong(name, f"lacks the field '{missing[0]}'; expected every field of the class: {other}")
        hints = get_type_hints(cls, include_extras=False)
        content = {key: self.decode(v, f"{name}.{key}") for key, v in given.items()}
        for key, v in content.items():
            if not fits(v, hints[key]) and not (v is None and expected[key].default is None):
                said = f"is {shown(v)}; expected {_named(hints[key])}: the file was changed"
                raise self._wrong(f"{name}.{key}", said)
        try:
            return cls(**content)
        except SlipangleError as error:
            raise type(error)(f"{name} in '{self.file}': {error}") from None
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            said = f"cannot be made of its fields ({error}); expected fields that fit together: the file was changed"
            raise self._wrong(name, said) from None

    def _array(self, value: dict, where: str) -> np.ndarray:
        dtype = value.get("dtype", "float64")
        if not isinstance(dtype, str) or dtype not in _DTYPES:
            raise self._wrong(where, f"is an array of {shown(dtype)}; expected {', '.join(_DTYPES)}")
        try:
            array = _parsed(value["array"], dtype)
            return array.reshape(value["shape"]) if "shape" in value else array
        except (TypeError, ValueError, OverflowError):
            said = "is not an array of numbers with rows of one length; expected one: the file was changed"
            raise self._wrong(where, said) from None


def _parsed(rows: Any, dtype: str) -> np.ndarray:
    def plain(v: Any) -> Any:
        if isinstance(v, list):
            return [plain(w) for w in v]
        if dtype == "float64":
            if isinstance(v, str):
                return _WORDS[v] if v in _WORDS else float("no number")
            if isinstance(v, (int, float)) and not isinstance(v, bool):
                return float(v)
        elif type(v) is (bool if dtype == "bool" else int):
            return v
        raise TypeError(v)

    return np.array(plain(rows), dtype=dtype)


def fits(value: Any, hint: Any) -> bool:
    """Whether a value can be what a type hint says; hints beyond numbers, text, tuples and classes allow anything.

    >>> fits(1, float), fits("1", float), fits(("a",), tuple[str, ...]), fits(None, float | None)
    (True, False, True, True)
    """
    origin, inside = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return fits(value, inside[0])
    if origin in (Union, UnionType):
        return any(fits(value, h) for h in inside)
    if origin is Literal:
        return any(type(value) is type(option) and value == option for option in inside)
    if origin is tuple:
        if not isinstance(value, tuple):
            return False
        if inside[1:] == (...,):
            return all(fits(v, inside[0]) for v in value)
        return len(value) == len(inside) and all(fits(v, h) for v, h in zip(value, inside, strict=True))
    if hint is Any:
        return True
    if hint is float:
        return isinstance(value, float) or fits(value, int)
    if hint is int:
        return isinstance(value, int) and not isinstance(value, bool) and abs(value) <= sys.maxsize
    if hint is None or hint is type(None):
        return value is None
    if isinstance(hint, type) and origin is None:
        return isinstance(value, hint)
    return True


def _named(hint: Any) -> str:
    return hint.__name__ if isinstance(hint, type) else str(hint).replace("typing.", "").replace("numpy.", "")
