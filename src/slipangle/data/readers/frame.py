"""Frames of pandas, polars, xarray and pyarrow as logs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from slipangle.data.dataset import Dataset, real_row, without_mask
from slipangle.data.readers.recording import Recording, build
from slipangle.data.readers.tables import DATE, Header, LazyTable
from slipangle.data.readers.text_dialect import parse_heading
from slipangle.errors import FormatError, MissingColumnError


def from_frame(frame: Any, columns: Any = None, *, name: str = "frame", **settings: Any) -> Dataset:
    """A data set from a frame of pandas, polars, xarray or pyarrow, or a mapping of names to arrays.

    Units stand in the columns' names (``speed [km/h]``), in a `Column`, or in the ``attrs`` of xarray; instants are
    time. What `Dataset.to_pandas` or `Dataset.to_xarray` gave comes back equal.

    Raises FormatError if it is no frame, MissingColumnError if it has no columns of numbers, ParameterError if one has
    complex numbers or several in a row, and what `slipangle.read` raises.

    Parameters
    ----------
    frame
        Columns of one length; those of words are left out.
    columns, settings
        As `slipangle.read` takes them.
    name : str
        What the data are.
    """
    meta = getattr(frame, "attrs", {}).get("slipangle", {})
    units = dict(meta.get("units", {}))
    found: list[tuple[Header, np.ndarray]] = []
    for heading, values, unit in _columns(frame):
        numbers, kind = _numbers(heading, values)
        if numbers is None:
            continue
        parsed = parse_heading(heading) if heading.strip() else Header(text=heading, name=heading)
        said = kind or units.get(heading) or unit or parsed.unit
        known = heading in units
        found.append((Header(text=heading, name=heading if known else parsed.name, unit=said), numbers))
    if not found:
        raise MissingColumnError(f"'{name}' holds no column of numbers; expected some: convert words to numbers first")
    if len({len(x) for _, x in found}) > 1:
        raise FormatError(f"the columns of '{name}' have different lengths; expected one length")
    table = LazyTable(name=f"'{name}'", headers=tuple(h for h, _ in found), load=lambda i: found[i][1])
    given = {} if meta else {"name": name}
    return build(Recording(name=name, tables={"": table}, meta=meta), columns, **given, **settings)


def _columns(frame: Any) -> Iterator[tuple[str, Any, str | None]]:
    """Name, content and unit of each column, a named or temporal index among them."""
    if isinstance(frame, Mapping) and not hasattr(frame, "data_vars"):
        yield from ((str(n), np.asarray(without_mask(x)), None) for n, x in frame.items())
    elif hasattr(frame, "data_vars"):  # xarray
        for n, x in (*frame.coords.items(), *frame.data_vars.items()):
            if x.ndim == 1:
                yield str(n), x.to_numpy(), x.attrs.get("units")
    elif hasattr(frame, "iloc"):  # pandas
        index = frame.index if getattr(frame.index, "tz", None) is None else frame.index.tz_convert(None)
        if index.name is not None or np.asarray(index).dtype.kind in "mM":
            yield str(index.name or "t"), np.asarray(index), None
        for k, n in enumerate(frame.columns):
            column = frame.iloc[:, k]
            zoned = getattr(column.dtype, "tz", None) is not None
            heading = ".".join(str(part) for part in n if part != "") if isinstance(n, tuple) else str(n)
            yield heading, (column.dt.tz_convert(None) if zoned else column).to_numpy(), None
    elif hasattr(frame, "get_columns"):  # polars
        yield from ((c.name, c.to_numpy(), None) for c in frame.get_columns())
    elif hasattr(frame, "column_names"):  # pyarrow
        yield from ((n, frame[n].to_numpy(), None) for n in frame.column_names)
    else:
        raise FormatError(
            f"a {type(frame).__name__} is no frame; expected one of pandas, polars, xarray or pyarrow, or a mapping of "
            "names to arrays"
        )


def _numbers(heading: str, values: Any) -> tuple[np.ndarray | None, str | None]:
    """Floats, and what they count where that is time; nothing for words."""
    array = np.asarray(values)
    if array.dtype.kind in "mM":
        since = array.astype("M8[ns]" if array.dtype.kind == "M" else "m8[ns]")
        ticks = since.astype("int64").astype(float) / 1e9
        return np.where(np.isnat(array), np.nan, ticks), DATE if array.dtype.kind == "M" else "s"
    if array.dtype.kind not in "biufc":
        try:
            array = array.astype(float)  # numbers among missing ones come as objects
        except (TypeError, ValueError):
            return None, None
    return real_row(heading, array), None
