"""`Planner`: the next seconds of a lap at the limit, from where the car is."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from slipangle.control.mpc import MPC
from slipangle.control.racing.along_track import AlongTrack, LateAlongTrack, along_track
from slipangle.control.racing.on_road import slowest, steps_in
from slipangle.control.racing.pedals import Pedals
from slipangle.control.racing.sectors import Sectors
from slipangle.ops import Scalar, Vector
from slipangle.optimal.guess import Guess
from slipangle.optimal.lap.car import LapCar, forces, held, slip
from slipangle.optimal.lap.lap import Lap
from slipangle.optimal.lap.program import saturation, without_peak
from slipangle.optimal.ocp import Reference
from slipangle.optimal.realtime.backend import RealTime
from slipangle.optimal.solution import Plan
from slipangle.optimal.terms import Limits, Weights
from slipangle.paths.path import Path

STATES = AlongTrack.states
FEWEST = 2  # explicit steps of a stage
# All numbers in m and s are for a car of usual size, `LapCar.size` says how far another is from that.
# Weights of distances from the lap, per m2, rad2, (m/s)2, (rad/s)2, and of forces over half the weight.
FROM_LAP = {"n": 2.0, "chi": 20.0, "v_x": 10.0, "v_y": 0.2, "r": 2.0, "delta": 20.0, "F_x": 1.0}
POWER = {"n": -2.0, "v_x": -1.0, "v_y": -1.0, "r": 1.0, "rates": 1.0}  # of the size, that these weights go with
RATES = {"delta_rate": 10.0, "F_rate": 0.3}  # per (rad/s)2, of force rates over half the weight
# Squared and plain price of leaving limits: edges [m], drive, slip over that at the peak, use of the axles' force.
PRICES = {"n": (1000.0, 60.0), "F_asked": (5.0, 5.0), "slip_f": (200.0, 20.0), "slip_r": (400.0, 30.0)}
PRICES |= {"use_f": (50.0, 8.0), "use_r": (50.0, 8.0)}
SLIP, USE = 0.95, 0.93  # up to which slip angles and longitudinal forces go, over their largest
AHEAD = 0.3  # m/s, of what can be reached
FADE = 0.4  # s, in which what is unexplained now fades from a plan
SPEED_IN = (0, 0, 1, 1, 1, 0, 2, 2, 0)  # power of the speed that each state goes with, on the same line


class Planner:
    """Follows a lap of a car by an `MPC` over arc length, at the limits of its tires, its drive and the edges.

    Decided are the rates of steering and longitudinal force. Stages last ``dt`` at the speeds of the lap; the last
    one ends on the lap, at its speed, from which there is a way on. Limits of tires, drive and edges are soft, so that
    a car that is beyond them is brought back. What a filter finds unexplained now fades from a plan within half a
    second: a car whose plans hold it for longer swings about its line.

    Parameters
    ----------
    car : LapCar
        As believed; friction and drive are told with every plan.
    track : Path
        Closed, with its edges.
    pedals : Pedals
        How late forces follow.
    steering_lag : float
        How late the steering follows, see `along_track`. [s]
    dt : float
        Of a stage, and between plans. [s]
    horizon : int
        Stages.
    """

    def __init__(
        self, car: LapCar, track: Path, pedals: Pedals, *, dt: float, horizon: int, steering_lag: float = 0.0
    ) -> None:
        self.car, self.track, self.dt, self.horizon = car, track, dt, horizon
        force, size = 0.5 * car.weight, float(car.size)
        self.slowest, self._ahead = float(slowest(car)), AHEAD * math.sqrt(size)
        self._fading = np.exp(-dt / (FADE * math.sqrt(size)) * np.arange(horizon + 1))
        units = {"F_asked": force, "n": size}
        prices = {k: (p[0] / units.get(k, 1.0) ** 2, p[1] / units.get(k, 1.0)) for k, p in PRICES.items()}
        weights = {name: value * size ** POWER.get(name, 0.0) for name, value in FROM_LAP.items()}
        slow = size ** POWER["rates"]
        self.mpc = MPC(
            along_track(
                steering_lag,
                params=car,
                drive_lag=pedals.lag,
                brake_lag=pedals.brake_lag,
                dt=dt,
                substeps=max(steps_in(car, dt), FEWEST),
            ),
            horizon=horizon,
            controls=("delta_rate", "F_rate"),
            Q=Weights({**weights, "F_x": weights["F_x"] / force**2}),
            R=Weights(delta_rate=slow * RATES["delta_rate"], F_rate=slow * RATES["F_rate"] / force**2),
            terms=_limited(car),
            limits=Limits(
                delta_rate=car.delta_rate,
                F_rate=car.force_rate * car.weight,
                **dict(n=np.inf, F_asked=np.inf, slip_f=SLIP, slip_r=SLIP, use_f=USE, use_r=USE),
            ),
            slack=Weights({name: price[0] for name, price in prices.items()}),
            slack_linear=Weights({name: price[1] for name, price in prices.items()}),
            solver=RealTime(iterations=2, accept=1e6, max_iterations=30),
        )

    @property
    def lag(self) -> float:
        """How late the steering follows, as far as that counts. [s]"""
        return self.mpc.model.steering_lag if isinstance(self.mpc.model, LateAlongTrack) else 0.0

    def follow(self, lap: Lap, room: float, sectors: Sectors | None = None) -> None:
        """The lap to drive, the room between the car's centre and an edge [m], and how its corners differ by now."""
        length, turns = lap.track.length, (-1, 0, 1)
        states = np.column_stack([lap.n, lap.chi, lap.v_x, lap.v_y, lap.r, lap.delta, lap.F_x, lap.F_x, lap.delta])
        states = states[:, : self.mpc.model.n_states]
        self._s = np.concatenate([lap.s + k * length for k in turns])
        self._states = np.vstack([states] * 3)
        self._rate = 1.0 / np.gradient(np.concatenate([lap.t + k * lap.time for k in turns]), self._s)
        self._room, self._sectors = room, sectors or Sectors(lap, 0.0)

    def at(self, s: np.ndarray) -> np.ndarray:
        """States of the lap at arc lengths [m], shape (n, n_states): at the speed of its sectors, forces with it."""
        place = np.asarray(s) % self.track.length
        states = np.column_stack([np.interp(place, self._s, column) for column in self._states.T])
        return _at_speed(states, self._sectors.speed(place))

    def plan(
        self,
        x: np.ndarray,
        s: float,
        grip: float,
        most: Callable[[np.ndarray, np.ndarray], np.ndarray],
        unexplained: Mapping[str, float],
        previous: Plan | None,
        *,
        brake: float | None = None,
    ) -> Plan:
        """Plan from a state of `AlongTrack`, and the angle asked for, shape (9,), at an arc length. [m]

        Parameters
        ----------
        x, s
            Where the car is.
        grip : float
            Friction of the tires over that of the lap's car. [-]
        most : callable
            Force at full throttle [N] at arc lengths [m] and speeds. [m/s]
        unexplained : mapping of str to float
            Accelerations that the car has now beyond its model's, ``d_v_x`` [m/s2] and ``d_r`` [rad/s2].
        previous : Plan, optional
            The plan before. Where that leads nowhere, the lap itself is the first guess; if that does not either, the
            plan is the fallback of `MPC.plan`.
        brake : float, optional
            Of the weight, with which the car is to come down to its slowest speed instead.
        """
        x, nodes = x[: self.mpc.model.n_states], self._nodes(s, float(x[2]))
        wanted = self._within_reach(self.at(nodes), nodes, float(x[2]), most, brake)
        reference = self._reference(nodes, wanted, grip, most, unexplained)
        plan = self.mpc.plan(x, reference, previous)
        if plan.age == 0:
            return plan
        anew = self.mpc.plan(x, reference, self._along(wanted))
        return replace(anew, health=plan.health) if anew.age == 0 else replace(plan, unfinished=None)

    def ahead(
        self, x: np.ndarray, s: float, coming: np.ndarray, sample: float, grip: float, unexplained: Mapping[str, float]
    ) -> tuple[np.ndarray, float]:
        """State and arc length, as of `plan`, behind rates of steering and force that are on their way.

        Parameters
        ----------
        coming : np.ndarray
            Rates [rad/s, N/s], shape (n, 2), each for a ``sample``. [s]
        """
        car, (step, pace) = self.car, self.moving
        x = x[: self.mpc.model.n_states]
        for turn, rise in coming:
            curvature = float(self.track.at(np.array([s])).curvature[0])
            way = sample / float(pace(x, curvature))
            given = [turn, rise, curvature, way, grip * car.mu_f, grip * car.mu_r]
            x = step(x, np.array([*given, unexplained["d_v_x"], unexplained["d_r"]])).full().ravel()
            s += way
        return x, s

    @cached_property
    def moving(self) -> tuple[ca.Function, ca.Function]:
        """The model's step, and the time per metre [s/m] at a state and a curvature. [1/m]"""
        model, x, curvature = self.mpc.model, ca.SX.sym("x", self.mpc.model.n_states), ca.SX.sym("curvature")
        pace = model.pace(x[0], x[1], x[2], x[3], curvature)
        return model.functions[0], ca.Function("pace", [x, curvature], [pace])

    def _within_reach(
        self,
        wanted: np.ndarray,
        nodes: np.ndarray,
        v_x: float,
        most: Callable[[np.ndarray, np.ndarray], np.ndarray],
        brake: float | None,
    ) -> np.ndarray:
        """States of the lap, none much faster than full throttle, or the brake, makes the car from now on.

        A plan that lags far behind what is wanted would give up its line for a little speed.
        """
        car, v, reached = self.car, v_x, []
        ahead = self._ahead if brake is None else 0.0
        force = most(nodes, wanted[:, 2])
        for pull, way, at_most in zip(force, np.diff(nodes, append=nodes[-1]), wanted[:, 2], strict=True):
            v = min(v, at_most)
            reached.append(v)
            gain = ((pull if brake is None else -brake * car.weight) - car.resistance(v)) / car.mass
            v = math.sqrt(max(v * v + 2.0 * gain * way, self.slowest**2))
        return _at_speed(wanted, np.minimum((np.array(reached) + ahead) / wanted[:, 2], 1.0))

    def _nodes(self, s: float, v_x: float) -> np.ndarray:
        """Arc lengths of the stages: at the lap's speeds, as much faster or slower as the car is now. [m]"""
        length, nodes = self.track.length, [s]
        off = v_x - float(self.at(np.array([s]))[0, 2])
        faster = float(self._sectors.speed(s % length))
        for _ in range(self.horizon):
            rate = faster * float(np.interp(nodes[-1] % length, self._s, self._rate)) + off
            nodes.append(nodes[-1] + self.dt * max(rate, self.slowest))
        return np.array(nodes)

    def _reference(
        self,
        nodes: np.ndarray,
        wanted: np.ndarray,
        grip: float,
        most: Callable[[np.ndarray, np.ndarray], np.ndarray],
        unexplained: Mapping[str, float],
    ) -> Reference:
        ocp, car, here = self.mpc.ocp, self.car, self.track.at(nodes)
        stage = np.diff(nodes)
        bend = np.diff(here.psi) / stage
        same = np.ones(len(nodes))
        given = {
            "curvature": np.append(bend, here.curvature[-1]),
            "stage": np.append(stage, stage[-1]),
            **{name: grip * getattr(car, name) * same for name in ("mu_f", "mu_r")},
            **{name: value * self._fading for name, value in unexplained.items()},
        }
        limits = ocp.limits_at_nodes.copy()
        n, F = ocp.limited.index("n"), ocp.limited.index("F_asked")
        room = self._room + self._sectors.spare(nodes)
        limits[:, n] = np.column_stack([room - here.right, here.left - room])
        limits[:, n].sort(axis=1)
        wanted[:, 0] = np.clip(wanted[:, 0], *limits[:, n].T)
        limits[:, F] = np.column_stack([-car.brake_force * same, most(nodes, wanted[:, 2])])
        return Reference(
            tracked=wanted[:, [STATES.index(name) for name in ocp.references]],
            exogenous=np.column_stack([given[name] for name in ocp.exogenous]),
            limits=limits,
        )

    def _along(self, wanted: np.ndarray) -> Guess:
        """The lap as a guess."""
        bounds, rates = self.mpc.ocp.input_bounds, np.diff(wanted[:, [5, 7]], axis=0) / self.dt
        return self.mpc.guess(x=wanted, u=np.clip(rates, bounds[:, 0], bounds[:, 1]))


def _at_speed(states: np.ndarray, faster: np.ndarray) -> np.ndarray:
    """States on the same line, shape (n, n_states), at speeds over their own. [-]"""
    return states * np.column_stack([faster**power for power in SPEED_IN[: states.shape[1]]])


def _limited(car: LapCar) -> dict[str, Callable[[Vector, Vector, Any], Scalar]]:
    """Slip angles over those of the largest force, and longitudinal forces over what the axles hold, by name."""
    flags = without_peak(car)

    def slips(x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        here = AlongTrack.on(car, u)
        return saturation(*slip(x[2], x[3], x[4], x[5], here), here, flags)

    def used(x: Vector, u: Vector) -> tuple[Scalar, Scalar]:
        here = AlongTrack.on(car, u)
        acting = forces(0.0, 0.0, x[6], held(x[2], x[4], here), x[2], here)
        return acting.front.use, acting.rear.use

    return {
        "slip_f": lambda x, u, p: slips(x, u)[0],
        "slip_r": lambda x, u, p: slips(x, u)[1],
        "use_f": lambda x, u, p: used(x, u)[0],
        "use_r": lambda x, u, p: used(x, u)[1],
    }
