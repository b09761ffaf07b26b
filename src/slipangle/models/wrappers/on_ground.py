"""`OnGround`: any model of lateral motion, with its position and heading on the ground."""

from dataclasses import KW_ONLY, dataclass
from math import isfinite
from typing import Literal

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest
from slipangle.models.model import Model, derived, taken
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import Scalar, Vector, concatenate, cos, sin, stack, tan

POSE = ("X", "Y", "psi")


@dataclass(frozen=True)
class OnGround(Wrapper):
    """A model of lateral motion plus X, Y [m] and psi [rad].

    ``psi' = r``, ``X' = v_x cos(psi) - v_y sin(psi)``, ``Y' = v_x sin(psi) + v_y cos(psi)``: the velocities and the yaw
    rate are taken linear in time between samples (second order), the inputs held, and the position follows by Simpson's
    rule, so a steady circle is exact to fourth order. A model like any other: the base model's states and outputs come
    first, X, Y and psi last; `correct` takes the measured X, Y and psi as they are and leaves the rest to the base
    model. Raises ParameterError if the model is on the ground already, has no yaw rate, or no lateral velocity and no
    option.

    Parameters
    ----------
    model : Model
        Knows the yaw rate ``r`` (state or output) and, unless ``v_y`` says otherwise, ``v_y`` or ``beta``.
        Its speed is ``v_x``: a state, an input or an output; a model without one, such as an ARX model
        identified at one speed, gets ``v_x`` as one more input, the last.
    v_y : {"zero"} or float, optional
        What to take where the model does not know its lateral velocity: ``"zero"``, or the distance ``l`` [m]
        from the centre of gravity back to the point that does not slip, ``v_y = l r`` (the rear axle
        at low lateral acceleration; ``l_r - mass l_f v_x^2 / (wheelbase C_r)`` in steady cornering, which may be
        negative). By default such a model is an error: better identify ``v_y`` as an output too.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, eqs. 3-7, 3-8.
    """

    model: Model
    _: KW_ONLY
    v_y: Literal["zero"] | float | None = None

    fit_info = taken("model.fit_info")
    off_ground = taken("model")
    states = derived(lambda self: (*self.model.states, *POSE))
    outputs = derived(lambda self: (*self.model.outputs, *POSE))

    def __post_init__(self) -> None:
        base = self.model
        known = (*base.states, *base.outputs)
        taken = [n for n in POSE if n in (*known, *base.inputs)]
        if taken:
            raise ParameterError(f"the model already has {taken}; expected one without X, Y, psi: use it as it is")
        if "r" not in known:
            raise ParameterError(
                f"the model has no yaw rate 'r' among its states and outputs; {nearest('r', known)}: "
                "identify it with 'r' as an output"
            )
        if self.v_y is None and not {"v_y", "beta"} & {*known, *base.inputs}:
            raise ParameterError(
                "the model knows neither 'v_y' nor 'beta'; expected a lateral velocity to move on the ground: "
                'say v_y="zero", or v_y=l with the distance in m from the centre of gravity to the rear axle'
            )
        if not (self.v_y is None or self.v_y == "zero" or (isinstance(self.v_y, int | float) and isfinite(self.v_y))):
            raise ParameterError(f'v_y is {self.v_y!r}; expected "zero", a distance in m, or nothing')

    @derived
    def inputs(self) -> tuple[str, ...]:
        """Inputs of the base model, and v_x where it has no speed."""
        base = self.model
        if "v_x" in (*base.states, *base.inputs, *base.outputs):
            return tuple(base.inputs)
        return (*base.inputs, "v_x")

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The base model's state and the pose at the last of the first `memory` samples."""
        pose = [float(data[name][self.memory - 1]) for name in POSE]
        return np.concatenate([np.asarray(self.model.initial_state(data), dtype=float), pose])

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        n, v = self.model.n_states, u[: self.model.n_inputs]
        base, psi = x[:n], x[n + 2]
        later = self.model.step(base, v)
        v_x0, v_y0, r0 = self._motion(base, u)
        v_x1, v_y1, r1 = self._motion(later, u)
        h = self.dt
        psi_m, psi1 = psi + h * (3 * r0 + r1) / 8, psi + h * (r0 + r1) / 2
        places = ((v_x0, v_y0, psi, 1), ((v_x0 + v_x1) / 2, (v_y0 + v_y1) / 2, psi_m, 4), (v_x1, v_y1, psi1, 1))
        X = x[n] + h / 6 * sum(w * (v_x * cos(a) - v_y * sin(a)) for v_x, v_y, a, w in places)
        Y = x[n + 1] + h / 6 * sum(w * (v_x * sin(a) + v_y * cos(a)) for v_x, v_y, a, w in places)
        return concatenate([later, stack([X, Y, psi1])])

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the base model, then X, Y, psi."""
        n = self.model.n_states
        return concatenate([self.model.output(x[:n], u[: self.model.n_inputs]), x[n:]])

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The base model's correction, and the measured pose."""
        n, m = self.model.n_states, self.model.n_outputs
        return concatenate([self.model.correct(x[:n], u[: self.model.n_inputs], y[:m]), y[m:]])

    def _motion(self, base: Vector, u: Vector) -> tuple[Scalar, Scalar, Scalar]:
        """v_x, v_y and r from the base model's state and the inputs."""
        model = self.model
        values: dict[str, Scalar] = {}
        if not {"r", "v_x", "v_y"} <= {*model.states, *self.inputs}:
            y = model.output(base, u[: model.n_inputs])
            values.update({name: y[i] for i, name in enumerate(model.outputs)})
        values.update({name: u[i] for i, name in enumerate(self.inputs)})
        values.update({name: base[i] for i, name in enumerate(model.states)})
        v_x, r = values["v_x"], values["r"]
        if self.v_y == "zero":
            return v_x, 0.0, r
        if self.v_y is not None:
            return v_x, self.v_y * r, r
        return v_x, values["v_y"] if "v_y" in values else v_x * tan(values["beta"]), r
