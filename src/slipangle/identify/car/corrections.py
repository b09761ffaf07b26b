"""What a log may need beyond the linear bicycle, one correction after the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycleParams

RECORDING = "recording"  # channel that numbers the recording that a sample is of
DOWNFORCE = ("downforce_f", "downforce_r")
LOCKED = ("locked_half_track",)
SPEED = ("gain_v_x",)
_LATE = {"delay_delta": 0.05, "steering_lag": 0.05}  # s, where a search that begins at none may never come to
_SHARES = (1.1, 2.0)  # friction where its search starts, over the friction that was used
SLOW, FAST = 0.05, 0.95  # quantiles of the speeds that were driven
_UNLIKE = 1.4  # fast over slow driving, from which downforce can be told
_SESSION = 28.0  # s of driving to fit to, mean of several recordings that may have offsets of their own; of 40 s about


@dataclass(frozen=True)
class Correction:
    """Something that a log may need: its name, its parameters, and where these start, in one or several places."""

    said: str
    free: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...] = ({},)
    own: tuple[str, ...] = ()  # of `free`, those with a value for each recording
    relaxing: bool = False  # the car becomes a `RelaxingBicycle`
    steered: bool = False  # the car becomes a `Steered` one
    instead: tuple[str, ...] = ()  # parameters that may have stood in for it, and are not needed beside it

    def adds_nothing_to(self, free: tuple[str, ...], own: tuple[str, ...]) -> bool:
        """Whether its parameters are ``free`` with one value already, or in ``own`` those of each recording."""
        return {*self.free} <= {*own} | ({*free} - {*self.own})


def corrections(
    data: Dataset, wheelbase: float, own: tuple[str, ...] | None, elsewhere: Mapping[str, float] | None = None
) -> tuple[Correction, ...]:
    """Corrections in the order in which they are tried; each stays if it helps on held-out stretches.

    ``own`` are parameters that have a value for each recording anyway; None lets offsets be tried so. ``elsewhere`` is
    where the gain, then tried first, starts too, as where its sign or unit is another than was said.
    """
    biases = tuple(f"bias_{name}" for name in data.outputs)
    used = friction_used(data)
    mu = SaturatingBicycleParams.metadata()["mu_f"]  # wrong units may go beyond any friction
    starts = (float(np.clip(share * used, mu.lower, mu.upper)) for share in _SHARES)
    frictions = tuple({"mu_f": start, "mu_r": start} for start in starts)
    length = 0.1 * wheelbase
    listed = [
        Correction("the steering's delay and lag are free", tuple(_LATE), ({}, _LATE), steered=True),
        Correction("the steering's gain is free", ("steering_gain",)),
        Correction("the axles saturate", ("mu_f", "mu_r"), frictions),
        Correction("the shape of the tire curves is free", ("shape",)),
        Correction("the sensors' biases are free", biases),
        Correction(
            "the tires' relaxation lengths are free",
            ("relaxation_f", "relaxation_r"),
            ({"relaxation_f": length, "relaxation_r": length},),
            relaxing=True,
        ),
    ]
    if "v_y" in data.outputs:
        listed.insert(-1, Correction("the place of the v_y sensor is free", ("lever_v_y",)))
    if "a_y" in data.outputs:
        listed.insert(-1, Correction("place and scale of the a_y sensor are free", ("lever_a_y", "gain_a_y")))
    if {"v_y", "a_y"} & {*data.outputs}:
        listed.append(
            Correction("the rear wheels turn as one", LOCKED, ({LOCKED[0]: 0.25 * wheelbase},), instead=("lever_v_y",))
        )
    slow, fast = np.quantile(data["v_x"], (SLOW, FAST))
    if fast > _UNLIKE * slow:
        listed.append(Correction("the axles' loads grow with speed squared", DOWNFORCE))
    if own is None and _sessions(data):
        differ = (("the steering's offset differs", ("steering_offset",)), ("the sensors' biases differ", biases))
        listed += [Correction(f"{what} between recordings", names, own=names) for what, names in differ]
    if elsewhere:
        gain = next(c for c in listed if c.free == ("steering_gain",))
        listed = [replace(gain, starts=({}, elsewhere)), *(c for c in listed if c is not gain)]
    left = (replace(c, free=tuple(n for n in c.free if n not in (own or ()))) for c in listed)
    return tuple(c for c in left if c.free)


def recordings(data: Dataset) -> tuple[int, ...]:
    """Number of the recording that each experiment is of."""
    if RECORDING not in data:
        return tuple(range(len(data.starts)))
    return tuple(int(data[RECORDING][row]) for row in data.starts)


def _sessions(data: Dataset) -> bool:
    """Whether there are several recordings, long enough to be sessions with sensors zeroed in between."""
    count = len(set(recordings(data)))
    return count > 1 and data.duration > _SESSION * count


def friction_used(data: Dataset, p: SaturatingBicycleParams | None = None) -> float:
    """Largest lateral acceleration of a log over that of gravity, and of the downforce of a car ``p``; no outliers."""
    load = 1.0 if p is None else p.load_ratio(data["v_x"])
    return float(np.quantile(np.abs(data["v_x"] * data["r"]) / load, 0.999)) / GRAVITY
