"""Data sets as files that other programs open, and that `slipangle.read` gives back equal."""

from __future__ import annotations

import io
import json
import re
import tempfile
import warnings
from pathlib import Path

import numpy as np
from scipy.io import savemat

from slipangle.data.dataset import Dataset
from slipangle.data.readers.arrow import META as ARROW_META
from slipangle.data.readers.csv import write_csv
from slipangle.data.readers.matlab import META as MATLAB_META
from slipangle.data.readers.mdf import OURS
from slipangle.errors import ParameterError, WriteError, nearest
from slipangle.extras import extra
from slipangle.files import write_atomic

_LONGEST = 63  # letters of a name in MATLAB


def write(data: Dataset, path: str | Path) -> Path:
    """Write a data set as the file's suffix says: .csv, .parquet, .feather, .mat (version 5) or .mf4 (MDF 4).

    `slipangle.read` gives it back equal, with channels, units, experiments and notes.

    Raises WriteError if there is no such format or the place cannot be written, ParameterError if a channel's name
    cannot be one of MATLAB, ConfigError if a library is not installed.
    """
    file = Path(path)
    makers = {".csv": write_csv, ".parquet": _parquet, ".feather": _feather, ".mat": _mat, ".mf4": _mdf}
    maker = makers.get(file.suffix.lower())
    if maker is None:
        raise WriteError(
            f"'{file.name}' has the suffix '{file.suffix}'; {nearest(file.suffix, makers)}: "
            f"use one of {', '.join(makers)}"
        )
    return maker(data, file)


def _arrow(data: Dataset) -> object:
    arrow = extra("pyarrow", "io", "writing a Parquet or Feather file")
    units, columns = data.meta["units"], data.table()
    fields = [arrow.field(n, arrow.float64(), metadata={b"unit": units[n].encode()}) for n in columns]
    schema = arrow.schema(fields, metadata={ARROW_META: json.dumps(data.meta).encode()})
    return arrow.table([arrow.array(np.ascontiguousarray(x)) for x in columns.values()], schema=schema)


def _parquet(data: Dataset, path: Path) -> Path:
    content = io.BytesIO()
    extra("pyarrow.parquet", "io", "writing a Parquet file").write_table(_arrow(data), content)
    return write_atomic(path, content.getvalue())


def _feather(data: Dataset, path: Path) -> Path:
    content = io.BytesIO()
    extra("pyarrow.feather", "io", "writing a Feather file").write_feather(_arrow(data), content)
    return write_atomic(path, content.getvalue())


def _mat(data: Dataset, path: Path) -> Path:
    columns = data.table()
    for name in columns:
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or len(name) > _LONGEST:
            raise ParameterError(
                f"channel '{name}' cannot be a variable of MATLAB; expected letters, digits and _, a letter first, at "
                f"most {_LONGEST}: rename it"
            )
    content = io.BytesIO()
    variables = {n: x[:, None] for n, x in columns.items()}
    savemat(content, variables | {MATLAB_META: json.dumps(data.meta)}, long_field_names=True)
    return write_atomic(path, content.getvalue())


def _mdf(data: Dataset, path: Path) -> Path:
    asammdf = extra("asammdf", "io", "writing an MDF file")
    units, columns = data.meta["units"], data.table()
    t = columns.pop("t")
    note = json.dumps(data.meta).replace("<", "\\u003c").replace("&", "\\u0026").replace(">", "\\u003e")
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        with asammdf.MDF(version="4.10") as file:
            file.append([asammdf.Signal(np.ascontiguousarray(x), t, name=n, unit=units[n]) for n, x in columns.items()])
            file.header.comment = OURS + note
            saved = file.save(Path(folder) / "data.mf4", overwrite=True)
        return write_atomic(path, Path(saved).read_bytes())
