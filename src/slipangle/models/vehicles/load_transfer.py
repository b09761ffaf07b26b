"""`LoadTransfer`: a car whose axles carry more or less, and hold less across, while it brakes and drives off."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.models.ode import OdeModel
from slipangle.models.parameters import require_in_range
from slipangle.models.vehicles.parameters import GRAVITY
from slipangle.models.wrappers.ode_wrapper import OdeWrapper
from slipangle.ops import Scalar, Vector, clip, concatenate, maximum, minimum, sqrt, stack
from slipangle.units import SI

_SOONEST, _LATEST = 0.01, 0.5  # s, between which loads follow; over less the rate of a logged speed is noise
_MOST = 0.45  # share of the weight that moves, at most
_ALONG = 1.1  # friction of a tire along over that across; 1.05 to 1.22 in public tire files
_LEFT = 0.2  # share of its force across that drive or brakes leave an axle, at least
_MOST_ALONG = _ALONG * math.sqrt(1.0 - _LEFT**2)  # force along that leaves so much, over the largest across


@dataclass(frozen=True)
class LoadTransfer(OdeWrapper):
    """A car whose axles' loads shift as it brakes and drives off, and whose tires hold less across meanwhile.

    The front axle gains ``-mass a_x height / wheelbase`` [N], the rear one loses it. ``a_x = (v_x - v_x_s) / load_lag -
    v_y r`` is told from the car's own input v_x [m/s]; the state ``v_x_s`` [m/s] is that speed behind a lag, about as
    long as a body takes to pitch. What pushes the car along, ``mass a_x``, acts on the axles by fixed shares, drag as
    brakes do. An axle's share ``F_x`` leaves ``sqrt(1 - (F_x / (mu_x F_z))^2)`` of its force across: the friction
    ellipse, J. Y. Wong, Theory of Ground Vehicles, 4th ed., 2008, sec. 1.4, with ``mu_x`` a tenth above ``mu_f``,
    ``mu_r``. In front it also turns with the wheels, which pushes a car that brakes out of a bend. Where steering
    angles are not small (`SaturatingBicycle`), the ``mass v_y r`` by which turned front wheels slow a car in a bend
    is their force across, and no share of it is a brake's.

    Parameters
    ----------
    model : OdeModel
        The car, `SaturatingBicycle` or `RelaxingBicycle`, or around one of these `RearSteered`, `TorqueVectored`,
        `Banked`, `Steered`; `Delayed` comes around it.
    height : float
        Of the centre of gravity above ground; less where tires gain less than in proportion to load. [m]
    load_lag : float
        Time constant with which the loads follow. [s]
    drive_rear, brake_rear : float
        Shares of the driving and of the braking force that the rear wheels have. [-]

    Raises ParameterError if the model is no such car, or a number is out of range.

    Examples
    --------
    ``LoadTransfer(car, height=0.5)``, then ``GreyBox(start=..., free=("C_f", "C_r", "height"))``.
    """

    _: KW_ONLY
    height: float
    load_lag: float = 0.05
    drive_rear: float = 1.0
    brake_rear: float = 0.4

    added_states: ClassVar[tuple[str, ...]] = ("v_x_s",)
    own: ClassVar[dict[str, str]] = {
        "height": "centre of gravity above ground, as far as the tires follow load",
        "load_lag": "time constant with which the loads follow braking",
        "drive_rear": "rear share of the driving force",
        "brake_rear": "rear share of the braking force",
    }

    def __post_init__(self) -> None:
        names = self.model.parameter_names if isinstance(self.model, OdeModel) else ()
        if not {"load_shift", "gain_v_x"} <= {*names} or "height" in names:
            raise ParameterError(
                f"the car with load transfer is a {type(self.model).__name__}; expected a SaturatingBicycle or a "
                "RelaxingBicycle without: wrap that before Delayed or OnGround"
            )
        super().__post_init__()
        for name in self.own:
            require_in_range(name, getattr(self, name), self.si(name))

    def derivative(self, x: Vector, u: Vector) -> Vector:
        """Rates of the car's states, then of ``v_x_s``. [m/s2]"""
        return concatenate([self._loaded(x, u).derivative(*self.inside(x, u)), stack([self._gains(x, u)])])

    def signals(self, x: Vector, u: Vector) -> dict[str, Scalar]:
        """Those of the car on these loads."""
        return self._loaded(x, u).signals(*self.inside(x, u))

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the car on these loads."""
        return self._loaded(x, u).output(*self.inside(x, u))

    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same at another sample time [s], in steps that follow the lag."""
        return super().resampled(dt, substeps=max(substeps, self.following(self.load_lag, dt)), outputs=outputs)

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The car's state, at a speed that stays."""
        return np.append(super().initial_state(data), data["v_x"][data.n_samples - 1])

    def range_of(self, name: str) -> SI:
        """No height is that of tires that do not follow load; the shortest lag is what the integrator can follow."""
        if name == "height":
            return SI("m", self.own[name], 0.0, 5.0)
        if name != "load_lag":
            return SI("-", self.own[name], 0.0, 1.0)
        return SI("s", self.own[name], max(_SOONEST, self.shortest_lag), _LATEST)

    def _gains(self, x: Vector, u: Vector) -> Scalar:
        """Rate of the logged speed, a lag ago. [m/s2]"""
        return (u[self.inputs.index("v_x")] - x[self.model.n_states]) / self.load_lag

    def _loaded(self, x: Vector, u: Vector) -> OdeModel:
        """The car with the loads of this moment, and with what forces along leave of its forces across."""
        p: Any = self.params
        v_y, r = (x[self.states.index(name)] for name in ("v_y", "r"))
        a_x = (p.gain_v_x * self._gains(x, u) - v_y * r) / GRAVITY
        share = p.load_shift - self.height * a_x / p.wheelbase
        shifted = replace(p, load_shift=clip(share, -_MOST, _MOST))
        pushed = a_x if self.small_angles else a_x + v_y * r / GRAVITY
        drive, brake = maximum(pushed, 0.0), minimum(pushed, 0.0)
        rear = self.drive_rear * drive + self.brake_rear * brake
        loads = shifted.load_ratios(p.gain_v_x * u[self.inputs.index("v_x")])
        most_f, most_r = p.mu_f * loads[0] * p.l_r / p.wheelbase, p.mu_r * loads[1] * p.l_f / p.wheelbase
        used = (pushed - rear) / most_f
        left_f, left_r = _across(used), _across(rear / most_r)
        front = {name: left_f * getattr(p, name) for name in ("C_f", "mu_f")}
        back = {name: left_r * getattr(p, name) for name in ("C_r", "mu_r")}
        along_f = most_f * clip(used, -_MOST_ALONG, _MOST_ALONG)
        return self.model.with_values(load_shift=shifted.load_shift, along_f=along_f, **front, **back)


def _across(used: Scalar) -> Scalar:
    """Share of its force across that is left to an axle whose force along is a share of its largest across."""
    return sqrt(maximum(1.0 - (used / _ALONG) ** 2, _LEFT * _LEFT))
