"""`SteadyStates`: the side slip and the steering that keep a model on a bend, pushed as it is."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from slipangle.errors import ParameterError
from slipangle.models.model import Model

_SPEEDS = np.concatenate([np.arange(1.5, 8.0, 0.5), np.arange(8.0, 62.0, 2.0)])  # m/s


class SteadyStates:
    """Steady driving of a lateral model about straight ahead, tabled over speed.

    Solves ``x = step(x, u)`` with a given yaw rate for the state and the input that is decided, linearised about
    straight driving; states ``d_...``, which `Disturbed` adds, stay as they are, and so do inputs besides the decided
    one and the speed, such as the angle of steered rear wheels, a yaw moment or the road's bank.

    Parameters
    ----------
    model : Model
        Knows r, and v_y or beta, as states or outputs; on the ground or off it. Without v_y and beta it is zero.
    control : str
        Input that is decided.

    Raises
    ------
    ParameterError
        If the model has no yaw rate or no such input.
    """

    def __init__(self, model: Model, control: str = "delta") -> None:
        base = model.off_ground
        if control not in base.inputs or "r" not in (*base.states, *base.outputs):
            raise ParameterError(
                f"the model has inputs {list(base.inputs)} and outputs {list(base.outputs)}; expected a yaw rate 'r' "
                f"and an input '{control}'"
            )
        self.disturbances = tuple(i for i, name in enumerate(base.states) if name.startswith("d_"))
        known = (control, "v_x", "v_x_dot")
        self.measured = tuple(i for i, name in enumerate(base.inputs) if name not in known)
        self._base, self._control = base, base.inputs.index(control)
        self._table = np.array([self._at(v) for v in _SPEEDS])

    def _at(self, v_x: float) -> np.ndarray:
        """v_y and the input at no yaw rate, and their derivatives by it and what pushes, shape (2, 2 + n)."""
        base, n = self._base, self._base.n_states
        x, u = np.zeros(n), np.array([v_x if name == "v_x" else 0.0 for name in base.inputs])
        later, y, A, B, C, D = (np.asarray(m.full()) for m in self._slopes(x, u))
        own = [i for i in range(n) if i not in self.disturbances]
        b, by = B[:, self._control], list(self.measured)

        def row(name: str) -> tuple[np.ndarray, np.ndarray, float]:
            """Of a channel: over own states and the input, over the measured inputs, and at no state; none unknown."""
            if name in base.states:
                return np.append(np.eye(n)[base.states.index(name)][own], 0.0), np.zeros(len(by)), 0.0
            if name in base.outputs:
                i = base.outputs.index(name)
                return np.append(C[i, own], D[i, self._control]), D[i, by], y[i, 0]
            return np.zeros(len(own) + 1), np.zeros(len(by)), 0.0

        (yaw, yaw_by, yaw_0), (slip, slip_by, slip_0) = row("r"), row("v_y")
        if "v_y" not in (*base.states, *base.outputs):
            slip, slip_by, slip_0 = (v_x * part for part in row("beta"))
        rest = np.hstack([np.eye(len(own)) - A[np.ix_(own, own)], -b[own][:, None]])
        first = 2 + len(self.disturbances)
        given = np.zeros((len(own) + 1, first + len(by)))
        given[:-1, 0], given[-1, 0] = later[own, 0], -yaw_0
        given[-1, 1] = 1.0
        given[:-1, 2:first], given[:-1, first:] = A[np.ix_(own, self.disturbances)], B[np.ix_(own, by)]
        given[-1, first:] = -yaw_by
        steady = np.linalg.lstsq(np.vstack([rest, yaw]), given, rcond=1e-13)[0]
        v_y = slip @ steady
        v_y[0] += slip_0
        v_y[first:] += slip_by
        return np.array([v_y, steady[-1]])

    @cached_property
    def _slopes(self) -> ca.Function:
        step, output, _ = self._base.functions
        x, u = ca.MX.sym("x", self._base.n_states), ca.MX.sym("u", self._base.n_inputs)
        later, y = step(x, u), output(x, u)
        slopes = [ca.jacobian(a, b) for a in (later, y) for b in (x, u)]
        return ca.Function("slopes", [x, u], [later, y, *slopes])

    def __call__(self, v_x: float, r: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steady lateral velocity [m/s] and input for yaw rates ``r``, shape (n,), at a speed, pushed by ``d``.

        ``d`` are the disturbances, then the `measured` inputs, in the model's order of each. Speeds outside 1.5 to
        60 m/s count as the nearest of these.
        """
        place = float(np.interp(v_x, _SPEEDS, np.arange(len(_SPEEDS))))
        i = min(int(place), len(_SPEEDS) - 2)
        share = place - i
        slip, control = (1.0 - share) * self._table[i] + share * self._table[i + 1]
        return slip[0] + slip[1] * r + _sum(slip[2:], d), control[0] + control[1] * r + _sum(control[2:], d)

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """Speeds [m/s], shape (m,), and v_y there at no yaw rate and per yaw rate and what pushes, shape (m, 2 + n)."""
        return _SPEEDS, self._table[:, 0]


def _sum(a: np.ndarray, b: np.ndarray) -> float:
    """Of the products, one after the other: the same number whatever library multiplies."""
    total = 0.0
    for left, right in zip(a.tolist(), b.tolist(), strict=True):
        total += left * right
    return total
