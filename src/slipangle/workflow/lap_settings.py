"""What a job says of its car's fastest lap."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from slipangle.workflow.entries import Within


@dataclass(frozen=True, kw_only=True)
class LapSettings:
    """The fastest lap of one of the models' cars, which ``slipangle lap`` finds.

    Parameters
    ----------
    track : file
        Columns x, y, width right, width left [m], or a CommonRoad scenario, relative to the job.
    smoothing : float
        Standard deviation of the track's points about its true line, as of one measured by GPS. [m]
    model : str
        Which model's car; by default the first that knows what its tires can hold.
    set : table
        Parameters of the car that the model does not know or that are to differ, SI units, such as power.
    line : str
        Whether the line is found too, or the track's own line is driven.
    points : int
        Collocation points; by default one every 1.94 wheelbases, 5 m for a full car, more in tight hairpins.
    smoothness : float
        Weight of yaw acceleration and of the rates of steering and force.
    margin : float
        Kept free between the car's side and the edges. [m]
    v_max : float
        Largest speed. [m/s]
    v_start : float
        Speed at the start of an open track; free by default. [m/s]
    tolerance : float
        Of the optimality conditions, scaled.
    iterations : int
        How often the solver may try.
    driven : file
        A log with X, Y or latitude, longitude (lat, lon), whose best lap is held against the fastest one.
    origin : list
        Latitude and longitude where the track's x and y are zero, for a log with latitude, longitude. [deg]
    """

    track: Path | None = None
    smoothing: Annotated[float, Within(0.0, 10.0, "m")] = 0.0
    model: str = ""
    set: dict[str, float] = field(default_factory=dict)
    line: Literal["free", "given"] = "free"
    points: Annotated[int, Within(20, 6000)] | None = None
    smoothness: Annotated[float, Within(1e-3, 100.0)] = 0.3
    margin: Annotated[float, Within(0.0, 10.0, "m")] = 0.0
    v_max: Annotated[float, Within(1.0, 200.0, "m/s")] = 120.0
    v_start: Annotated[float, Within(0.5, 200.0, "m/s")] | None = None
    tolerance: Annotated[float, Within(1e-10, 1e-2)] = 1e-6
    iterations: Annotated[int, Within(1, 100_000)] = 500
    driven: Path | None = None
    origin: tuple[float, float] | None = None
