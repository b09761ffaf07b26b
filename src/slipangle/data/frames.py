"""`InFrames`: data sets as frames of pandas, polars and xarray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from slipangle.extras import extra


class Named(Protocol):
    """A channel's name and unit."""

    @property
    def name(self) -> str:
        """What it is called."""
        ...

    @property
    def unit(self) -> str:
        """Its SI unit."""
        ...


class InFrames:
    """What a data set gives to other libraries: its samples by time, and in ``attrs`` what a frame has no place for."""

    values: np.ndarray
    dt: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    name: str
    starts: tuple[int, ...]
    notes: tuple[str, ...]

    @property
    def meta(self) -> dict[str, Any]:
        """What a file or frame notes beside the samples, so that reading gives an equal data set."""
        channels: Sequence[Named] = self.channels  # type: ignore[attr-defined]  # of a data set
        return {
            "name": self.name,
            "dt": self.dt,
            "inputs": list(self.inputs),
            "outputs": list(self.outputs),
            "notes": list(self.notes),
            "experiment": "experiment" if len(self.starts) > 1 else None,
            "units": {"t": "s", "experiment": "-"} | {c.name: c.unit for c in channels},
        }

    def table(self) -> dict[str, np.ndarray]:
        """Columns by name: ``t`` [s], ``experiment`` where there are several, then the channels, shape (n_samples,)."""
        columns: dict[str, np.ndarray] = {"t": self.t}  # type: ignore[attr-defined]
        if len(self.starts) > 1:
            lengths = np.diff((*self.starts, len(self.values)))
            columns["experiment"] = np.repeat(np.arange(len(self.starts), dtype=float), lengths)
        channels: Sequence[Named] = self.channels  # type: ignore[attr-defined]
        return columns | {c.name: self.values[:, k] for k, c in enumerate(channels)}

    def to_pandas(self) -> Any:
        """A ``pandas.DataFrame`` indexed by ``t`` [s]; ``attrs`` holds units, inputs, outputs and notes.

        Raises ConfigError if pandas is not installed.
        """
        pandas = extra("pandas", "io", "a frame of pandas")
        frame = pandas.DataFrame(self.table()).set_index("t")
        frame.attrs["slipangle"] = self.meta
        return frame

    def to_polars(self) -> Any:
        """A ``polars.DataFrame`` with a column ``t`` [s]; it has no place for units.

        Raises ConfigError if polars is not installed.
        """
        return extra("polars", "io", "a frame of polars").DataFrame(self.table())

    def to_xarray(self) -> Any:
        """An ``xarray.Dataset`` along ``t`` [s], each variable with its unit in ``attrs``.

        Raises ConfigError if xarray is not installed.
        """
        xarray = extra("xarray", "io", "a data set of xarray")
        units, columns = self.meta["units"], self.table()
        t = columns.pop("t")
        variables = {n: ("t", x, {"units": units[n]}) for n, x in columns.items()}
        return xarray.Dataset(variables, coords={"t": ("t", t, {"units": "s"})}, attrs={"slipangle": self.meta})
