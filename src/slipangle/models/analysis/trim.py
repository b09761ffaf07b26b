"""Equations of motion of any model with their derivatives, and the steady state in which they are linearised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError, nearest
from slipangle.models.model import Model

STEERING = ("delta", "delta_sw")  # inputs that steer, the first that there is
_DRIVES = (("throttle",), ("pedal",), ("T_f", "T_r"))  # inputs that hold a speed, the first that there are
_TRIES, _CLOSE = 60, 1e-9


def moving(model: Model) -> tuple[str, ...]:
    """Names of the states that no steady state keeps: position and heading."""
    return ("X", "Y", "psi", "distance") if {"X", "Y", "psi"} <= {*model.states} else ()


@dataclass(frozen=True, kw_only=True)
class Trim:
    """A steady state: states and inputs that keep it, by name and as arrays."""

    x: np.ndarray  # (n_states,)
    u: np.ndarray  # (n_inputs,)
    v_x: float | None  # speed [m/s], where there is one
    a_y: float  # lateral acceleration v_x r [m/s2]


class Motion:
    """``f(x, u, p)``, the rates of the states or the states one sample later, and outputs; with derivatives.

    ``dt`` is 0 for rates. The parameters p are those that were fitted and can be varied; ``values`` are theirs.
    """

    def __init__(self, model: Model, names: tuple[str, ...] = ()) -> None:
        self.model = model
        rates = getattr(model, "derivative", None) if not getattr(model, "own_step", True) else None
        self.dt = 0.0 if rates is not None else model.dt
        self.names = names
        maker: Any = model
        self.values = np.array([maker.value(name) for name in names])

        def build(kind: Any) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
            x, u, p = kind.sym("x", model.n_states), kind.sym("u", model.n_inputs), kind.sym("p", len(names))
            varied = maker.with_values(**{n: p[i] for i, n in enumerate(names)}) if names else maker
            nxt = varied.derivative(x, u) if rates is not None else varied.step(x, u)
            seen = varied.output(x, u)

            def function(name: str, value: Any) -> ca.Function:
                value = ca.densify(value)
                slopes = [ca.densify(ca.jacobian(value, z)) for z in (x, u)]
                return ca.Function(name, [x, u, p], [value, *slopes])

            alone, shown = (
                ca.Function(name, [x, u, p], [ca.densify(v)]) for name, v in (("next", nxt), ("shown", seen))
            )
            return function("motion", nxt), function("seen", seen), alone, shown

        try:
            self._motion, self._seen, self._next, self._shown = build(ca.SX)
        except (RuntimeError, NotImplementedError, TypeError):
            self._motion, self._seen, self._next, self._shown = build(ca.MX)
        self._moves = np.array([s in moving(model) for s in model.states], dtype=bool)

    def many(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Value of f at many states, shape (n_states, n), with the inputs of one."""
        return np.asarray(self._next(x, u, self.values), dtype=float)

    def at(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value of f, and outputs."""
        return self._next(x, u, p).full()[:, 0], self._shown(x, u, p).full()[:, 0]

    def slopes(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, ...]:
        """Value of f and its derivatives by x and u; then outputs and theirs."""
        found = (*self._motion(x, u, p), *self._seen(x, u, p))
        value, by_x, by_u, seen, seen_x, seen_u = (np.asarray(f, dtype=float) for f in found)
        return value[:, 0], by_x, by_u, seen[:, 0], seen_x, seen_u

    def kinks(self, trim: Trim, p: np.ndarray) -> list[str]:
        """States and inputs by which f is not smooth there: a difference over both sides is not the derivative."""
        _, by_x, by_u, *_ = self.slopes(trim.x, trim.u, p)
        z, slope, n = np.concatenate([trim.x, trim.u]), np.hstack([by_x, by_u]), len(trim.x)
        found = []
        for i, name in enumerate((*self.model.states, *self.model.inputs)):
            h = 1e-6 * max(1.0, abs(z[i]))
            ends = [z + sign * h * np.eye(len(z))[i] for sign in (1, -1)]
            up, down = (np.asarray(self._motion(e[:n], e[n:], p)[0], dtype=float)[:, 0] for e in ends)
            off = np.abs((up - down) / (2 * h) - slope[:, i])
            if (off > 0.05 * np.abs(slope).max(axis=1) + 1e-5).any():
                found.append(name)
        return found

    def trim(
        self, v_x: float | None, a_y: float, inputs: Mapping[str, float], p: np.ndarray, near: Trim | None = None
    ) -> Trim:
        """The steady state at a speed and a lateral acceleration, ``v_x r``; searched from straight driving.

        Raises ParameterError if there is none, or what was asked for is not in the model.
        """
        model = self.model
        self._checked(v_x, a_y, inputs)
        x = np.array(model.straight(0.0 if v_x is None else v_x), dtype=float) if near is None else near.x.copy()
        u = np.array([inputs.get(n, v_x if n == "v_x" else 0.0) for n in model.inputs], dtype=float)
        steers = next((n for n in STEERING if n in model.inputs and n not in inputs), None)
        turns = steers is not None and "r" in (*model.states, *model.outputs)
        wanted = [steers] if turns and steers is not None else []
        if "v_x" in model.states and v_x is not None:
            drives = next((d for d in _DRIVES if set(d) <= {*model.inputs}), ())
            wanted += [d for d in drives if d not in inputs]
            for i, name in enumerate(model.states if near is None else ()):
                if name.startswith("omega_"):
                    x[i] = v_x / getattr(getattr(model, "params", None), "radius", 0.3)
        free = np.array([model.inputs.index(n) for n in wanted], dtype=int)
        if near is not None:
            u[free] = near.u[free]
        held = self._moves | np.array([n == "v_x" and v_x is not None for n in model.states], dtype=bool)
        moved, kept = np.flatnonzero(~held), np.flatnonzero(~self._moves)

        def missed(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            value, seen = self.at(x, u, p)
            error = (value - x if self.dt else value)[kept]
            return np.append(error, self._yaw_rate(x, seen) - (a_y / v_x if v_x else 0.0)) if turns else error

        def slope(x: np.ndarray, u: np.ndarray) -> np.ndarray:
            _, by_x, by_u, _, seen_x, seen_u = self.slopes(x, u, p)
            if self.dt:
                by_x = by_x - np.eye(len(x))
            rows = np.hstack([by_x[np.ix_(kept, moved)], by_u[np.ix_(kept, free)]])
            if turns:
                by_state, by_input = self._yaw_slope(seen_x, seen_u)
                rows = np.vstack([rows, np.append(by_state[moved], by_input[free])])
            return rows

        scale = np.concatenate([np.maximum(1.0, np.abs(x[moved])), [_size(n) for n in wanted]])
        x, u, left = _newton(missed, slope, x, u, moved, free, scale)
        if left > 1.0:
            pedal = next((n for n in model.inputs if n not in (*STEERING, "v_x")), "")
            given = f", or give the inputs that hold it, such as inputs={{'{pedal}': ...}}" if pedal else ""
            place = "rest" if v_x is None else f"v_x = {v_x:g} m/s and a_y = {a_y:g} m/s2"
            raise ParameterError(
                f"the {type(model).__name__} has no steady state at {place} that was found; expected one: take a "
                f"smaller a_y{given}"
            )
        return Trim(x=x, u=u, v_x=v_x, a_y=a_y)

    def _yaw_rate(self, x: np.ndarray, seen: np.ndarray) -> float:
        model = self.model
        return float(x[model.states.index("r")] if "r" in model.states else seen[model.outputs.index("r")])

    def _yaw_slope(self, seen_x: np.ndarray, seen_u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the yaw rate by x and u."""
        model = self.model
        if "r" in model.states:
            return np.eye(model.n_states)[model.states.index("r")], np.zeros(model.n_inputs)
        i = model.outputs.index("r")
        return seen_x[i], seen_u[i]

    def _checked(self, v_x: float | None, a_y: float, inputs: Mapping[str, float]) -> None:
        model = self.model
        name = type(model).__name__
        for key in inputs:
            if key not in model.inputs:
                raise ParameterError(f"the {name} has no input '{key}'; {nearest(key, model.inputs)}")
        known = "v_x" in (*model.states, *model.inputs)
        if v_x is None and known:
            raise ParameterError(f"the {name} moves at a speed; expected v_x, such as v_x=20.0 [m/s]")
        if v_x is not None and not known:
            raise ParameterError(
                f"v_x is {v_x:g} m/s, but the {name} knows no speed: it is the same at each; leave v_x out"
            )
        if v_x is not None and not (np.isfinite(v_x) and v_x > 0):
            raise ParameterError(f"v_x is {v_x:g} m/s; expected a positive speed")
        if not np.isfinite(a_y):
            raise ParameterError(f"a_y is {a_y:g} m/s2; expected a finite number")
        if a_y and (v_x is None or "r" not in (*model.states, *model.outputs)):
            raise ParameterError(
                f"a_y is {a_y:g} m/s2, but the {name} has no speed or no yaw rate to turn with; leave a_y out"
            )


def _size(name: str) -> float:
    """A usual size of an input: among inputs that do the same, each takes its share."""
    return 100.0 if name.startswith("T_") else 0.1


def _newton(
    missed: Any, slope_at: Any, x: np.ndarray, u: np.ndarray, moved: np.ndarray, free: np.ndarray, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Smallest damped Newton steps until they vanish; and how far from that they ended, 1 being close enough."""

    def go(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        xz, uz = x.copy(), u.copy()
        xz[moved] += scale[: len(moved)] * z[: len(moved)]
        uz[free] += scale[len(moved) :] * z[len(moved) :]
        return xz, uz

    z = np.zeros(len(scale))
    error, slope = missed(*go(z)), slope_at(*go(z))
    weight = 1.0 / np.maximum(np.linalg.norm(slope * scale, axis=1), 1e-12)
    size = np.inf
    for _ in range(_TRIES):
        if not (np.isfinite(error).all() and np.isfinite(slope).all()):
            return *go(z), np.inf
        step: Any = np.linalg.lstsq(weight[:, None] * slope * scale, -weight * error, rcond=1e-12)[0]
        size = float(np.abs(step).max(initial=0.0))
        if size < _CLOSE:
            z = z + step
            break
        part, before, tried = 1.0, np.linalg.norm(weight * error), go(z)
        while part > 1e-4:
            tried = go(z + part * step)
            error = missed(*tried)
            if np.isfinite(error).all() and np.linalg.norm(weight * error) < before:
                break
            part /= 2
        z, slope = z + part * step, slope_at(*tried)
    rest = np.linalg.norm(weight * missed(*go(z)), ord=np.inf) if len(error) else 0.0
    return *go(z), max(size / (100 * _CLOSE), float(rest) / (100 * _CLOSE))
