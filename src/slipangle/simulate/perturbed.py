"""`Spread`: how far a car may be from its model; `PerturbedCar`: many such cars in one compiled kernel."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated

import numpy as np

from slipangle.errors import ConfigError, ParameterError
from slipangle.fields import Checked, Within
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula
from slipangle.models.vehicles.car import DualTrackParams
from slipangle.models.vehicles.driveline import Brakes, Driveline, Steering
from slipangle.models.vehicles.dual_track.contact import Contact, Patch
from slipangle.models.vehicles.dual_track.dual_track import DualTrack
from slipangle.models.vehicles.dual_track.kernel import Kernel
from slipangle.models.vehicles.parameters import GRAVITY, BicycleParams
from slipangle.ops import Scalar, Vector, clip, stack

Share = Annotated[float, Within(0, 0.9)]
Size = Annotated[float, Within(0, 100)]
SLOPE = 30.0  # cornering stiffness over load of the kernel's tire before it is scaled [1/rad]
MOST = 2.5  # of the scale: beyond it a millisecond is too long for the tire's relaxation


@dataclass(frozen=True, kw_only=True)
class Spread(Checked):
    """What differs from the model, drawn evenly and independently for each car.

    Parameters
    ----------
    stiffness_f, stiffness_r, friction, mass : float
        Largest relative change either way of the axles' cornering stiffness, of the friction coefficient, of the mass;
        the yaw inertia goes with the mass. [-]
    delay, lag : float
        Largest further dead time and further time constant of the steering, from zero. [s]
    noise : float
        Largest relative change either way of the sensors' noise: 1 goes from none to double. [-]
    crosswind : float
        Largest lateral force over the mass, either way, steady, at the centre of gravity. [m/s2]

    >>> Spread().names[:3]
    ('stiffness_f', 'stiffness_r', 'friction')
    """

    stiffness_f: Share = 0.2
    stiffness_r: Share = 0.2
    friction: Share = 0.3
    mass: Share = 0.15
    delay: Size = 0.03
    lag: Size = 0.05
    noise: Annotated[float, Within(0, 1)] = 1.0
    crosswind: Size = 0.7

    @property
    def names(self) -> tuple[str, ...]:
        """The changes, in the order of the columns of `draw`."""
        return tuple(f.name for f in fields(self))

    def draw(self, numbers: Sequence[int], seed: int = 0) -> np.ndarray:
        """Changes of the cars of these numbers, shape (n, 8); car 7 of seed 0 is the same one wherever it is drawn."""
        most = np.array([getattr(self, name) for name in self.names])
        table = np.array([np.random.default_rng([seed, k]).uniform(-1, 1, len(most)) for k in numbers])
        table = table.reshape(len(numbers), len(most))
        late = [self.names.index(n) for n in ("delay", "lag")]
        table[:, late] = 0.5 * (1 + table[:, late])
        return table * most


_CHOSEN = ("mass", "inertia_z", "wheelbase", "l_f", "track_f", "track_r", "relaxation_y", "inertia_wheel_f")
_CHOSEN += ("inertia_wheel_r", "steering_gain", "steering_offset", "mu_fl", "mu_fr", "mu_rl", "mu_rr")
_CHOSEN += ("downforce_f", "downforce_r")


@dataclass(frozen=True, kw_only=True)
class PerturbedCar(DualTrack):
    """A dual track with more inputs: the speed that is held [m/s], a side wind [N], scales of the slip angles [-].

    The speed is held by a force at the centre of gravity, of -5 to 2 m/s2: the tires have all their friction for the
    side. A scaled slip angle scales the cornering stiffness and leaves the largest force as it is.
    """

    inputs = ("delta", "throttle", "brake", "v_held", "F_wind", "slip_f", "slip_r")

    def patches(self, x: Vector, u: Vector) -> tuple[list[Patch], list[Scalar]]:
        """As the dual track's, across the wheels at the scale of their slip angles."""
        places, angles = super().patches(x, u)
        scales = u[5], u[5], u[6], u[6]
        scaled = [p._replace(v_y=p.v_y * k, side=p.side * k) for p, k in zip(places, scales, strict=True)]
        return scaled, angles

    def rates(
        self, x: Vector, u: Vector, start: Vector, loads: Sequence[Scalar], contacts: Sequence[Contact], angles: Vector
    ) -> Vector:
        """As the dual track's, with the wind and what holds the speed."""
        rates = super().rates(x, u, start, loads, contacts, angles)
        rows = [rates[i] for i in range(self.n_states)]
        v_x, v_y = (self.states.index(n) for n in ("v_x", "v_y"))
        rows[v_x] = rows[v_x] + clip(2.0 * (u[3] - x[v_x]), -5.0, 2.0)
        rows[v_y] = rows[v_y] + u[4] / self.params.mass
        return stack(rows)


@cache
def _car() -> PerturbedCar:
    """Any car: what matters of it comes with the inputs. Its mass is at the ground, so that no load moves."""
    curve = MagicCurve(B=SLOPE / 1.3, C=1.3, D=1.0, E=-0.5)
    tire = SimpleMagicFormula(longitudinal=curve, lateral=curve)
    params = DualTrackParams(
        **dict.fromkeys(("mass", "inertia_z"), 1500.0),
        wheelbase=2.7,
        l_f=1.35,
        **dict.fromkeys(("track_f", "track_r"), 1.5),
        height=0.0,
        radius=0.32,
        **dict.fromkeys(("inertia_wheel_f", "inertia_wheel_r"), 3.0),
        steering=Steering(),
        brakes=Brakes(),
        driveline=Driveline(),
    )
    return PerturbedCar(params=params, tire_f=tire, tire_r=tire, dt=0.001)


@cache
def _kernel() -> Kernel | None:
    return Kernel.build(_car(), varied=_CHOSEN)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fleet:
    """Many cars around one bicycle, side by side in compiled C at one millisecond.

    Raises ConfigError without a compiler, ParameterError if the tires are stiffer than the kernel's steps bear.

    Parameters
    ----------
    bicycle : BicycleParams
        The car as identified; its downforce, where it has some, is theirs.
    friction : float
        Friction coefficient at which its tires saturate. [-]
    changes : array, shape (n, 8)
        What differs, as `Spread.draw` has it.
    """

    bicycle: BicycleParams
    friction: float
    changes: np.ndarray

    def __post_init__(self) -> None:
        if _kernel() is None:
            raise ConfigError("perturbed cars run in compiled code only; expected a C compiler: install one as cc")
        if self._inputs[:, 5:7].max(initial=0.0) > MOST:
            steepest = SLOPE * self._inputs[:, 5:7].max()
            raise ParameterError(
                f"the axles' cornering stiffness over load and friction reaches {steepest:.3g} per rad; "
                f"expected at most {SLOPE * MOST:g}: raise the friction from {self.friction:g} to "
                f"{math.ceil(100 * self.friction * steepest / (SLOPE * MOST)) / 100:g}, or check C_f, C_r and the mass"
            )

    @property
    def states(self) -> tuple[str, ...]:
        """Names of a car's states."""
        return _car().states

    def straight(self, v_x: float, X: float, Y: float, psi: float) -> np.ndarray:
        """All cars straight ahead at a speed [m/s] and pose [m, m, rad], shape (n, n_states)."""
        return np.tile(_car().straight(v_x, X=X, Y=Y, psi=psi), (len(self.changes), 1))

    def advance(self, x: np.ndarray, delta: np.ndarray, v_x: np.ndarray) -> np.ndarray:
        """States after each millisecond, shape (rows, n, n_states).

        From states ``x``, with the steering that acts ``delta``, shape (rows, n) [rad], and held speeds, shape (n,).
        """
        kernel = _kernel()
        if kernel is None:
            raise AssertionError
        u = np.empty((len(delta), *self._inputs.shape))
        u[:] = self._inputs
        u[:, :, 0], u[:, :, 3] = delta, v_x
        return kernel.run_many(x, u)[1:]

    @property
    def _inputs(self) -> np.ndarray:
        """What is the same at every step: inputs and chosen parameters, shape (n, n_inputs)."""
        known = self.__dict__.get("_table")
        if known is not None:
            return known
        p, n = self.bicycle, len(self.changes)
        stiff_f, stiff_r, friction, mass, _, _, _, wind = self.changes.T
        weight, heavy, grip = p.mass * GRAVITY, p.mass * (1 + mass), self.friction * (1 + friction)
        load_f, load_r = weight * (p.wheelbase - p.l_f) / p.wheelbase, weight * p.l_f / p.wheelbase
        # the stiffness is the axle's, whatever the load; the tire's goes with load and friction
        share = SLOPE * grip * (1 + mass)
        table = np.zeros((n, 7 + len(_CHOSEN)))
        table[:, 4] = wind * heavy
        table[:, 5] = p.C_f / load_f * (1 + stiff_f) / share
        table[:, 6] = p.C_r / load_r * (1 + stiff_r) / share
        values = {
            "mass": heavy,
            "inertia_z": p.inertia_z * (1 + mass),
            **{n: getattr(p, n) for n in ("wheelbase", "l_f", "steering_gain", "steering_offset")},
            **dict.fromkeys(("track_f", "track_r"), 0.55 * p.wheelbase),
            "relaxation_y": 0.19 * p.wheelbase,
            **dict.fromkeys(("inertia_wheel_f", "inertia_wheel_r"), 2e-3 * heavy),
            **dict.fromkeys(("mu_fl", "mu_fr", "mu_rl", "mu_rr"), grip),
            **{n: getattr(p, n, 0.0) / (0.5 * _car().params.air_density) for n in ("downforce_f", "downforce_r")},
        }
        for j, name in enumerate(_CHOSEN):
            table[:, 7 + j] = values[name]
        self.__dict__["_table"] = table
        return table
