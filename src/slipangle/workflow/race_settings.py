"""What a job says of the laps that a racer drives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from slipangle.control.racing.sensing import NOISE
from slipangle.errors import ParameterError, nearest, shown
from slipangle.workflow.entries import Seed, Weight, Within


@dataclass(frozen=True, kw_only=True)
class RaceSettings:
    """Laps on the track of ``[lap]`` by a racer that learns, on a plant, which ``slipangle lap`` drives.

    Parameters
    ----------
    laps : int
        How many.
    plant : str
        A dual track of the catalogue; by default that of ``[plant]`` on tires of files, else one around the car of the
        fastest lap.
    friction : float
        Of the plant's road over the friction that the racer believes in at first.
    grip_std : float
        How far the racer takes that friction to be off, a standard deviation, at first.
    share : float
        Of the friction that is sure, which laps are planned with.
    margin : float, optional
        Kept free between the car's side and the edges by plans; by default 0.4 m for a full car, in proportion to the
        wheelbase. [m]
    noise : table
        Standard deviation of what the racer sees, by channel: X, Y, psi, v_x, r, a_x, a_y, in SI units.
    seed : int
        Of the noise.
    """

    laps: Annotated[int, Within(1, 100)] = 3
    plant: Literal["", "bmw-320i", "vw-vanagon"] = ""
    friction: Annotated[float, Within(0.3, 1.5)] = 0.95
    grip_std: Annotated[float, Within(0.0, 0.5)] = 0.05
    share: Annotated[float, Within(0.3, 1.0)] = 0.92
    margin: Annotated[float, Within(0.0, 10.0, "m")] | None = None
    noise: dict[str, Weight] = field(default_factory=dict)
    seed: Seed = 0

    def __post_init__(self) -> None:
        for name in self.noise:
            if name not in NOISE:
                raise ParameterError(f"noise names {shown(name)}; {nearest(name, NOISE, every=True)}: use one of these")
