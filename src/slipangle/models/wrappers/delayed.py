"""`Delayed`: an ODE whose inputs arrive late, by a delay that need not be a whole number of samples."""

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any, Self

import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError, nearest
from slipangle.models.model import FitInfo, derived, taken
from slipangle.models.ode import OdeModel, Parametrised
from slipangle.models.parameters import require_few_lags
from slipangle.models.wrappers.wrapper import Wrapper
from slipangle.ops import Scalar, Vector, concatenate, fabs, is_symbolic, is_traced, stack, where
from slipangle.units import SI

_PREFIX = "delay_"


def interpolation(position: Scalar, count: int) -> list[Scalar]:
    """Weights of samples 0, 1, ..., ``count - 1`` back in time for the value ``position`` samples back.

    Cubic convolution: exact at the samples and for straight lines, once differentiable in ``position`` everywhere. The
    sample after the newest, which is not known yet, is extrapolated from the last two. ``position`` is from 0 to
    ``count - 2`` [samples], with at least 3 samples kept.

    Source: R. G. Keys, "Cubic convolution interpolation for digital image processing", IEEE Trans. Acoustics, Speech,
    and Signal Processing 29(6), 1981, 1153-1160, with a = -1/2.

    >>> [float(w) for w in interpolation(1.0, 4)]
    [0.0, 1.0, 0.0, 0.0]
    """

    def kernel(z: Scalar) -> Scalar:
        z = fabs(z)
        near = (1.5 * z - 2.5) * z * z + 1.0
        far = ((-0.5 * z + 2.5) * z - 4.0) * z + 2.0
        return where(z < 1.0, near, where(z < 2.0, far, 0.0))

    weights = [kernel(position - j) for j in range(count)]
    ahead = kernel(position + 1.0)
    weights[0], weights[1] = weights[0] + 2.0 * ahead, weights[1] - ahead
    return weights


@dataclass(frozen=True)
class Delayed(Parametrised, Wrapper):
    """An `OdeModel` some of whose inputs act a while after they are logged: actuator, bus and filter delay.

    The delay is any time from 0 to ``longest``, also a part of a sample: the late input is interpolated between the
    samples (see `interpolation`) and, like every input, held for a sample. Its past values are states, so this is a
    model like any other: free run, MPC, C code. A fit varies ``delay_delta`` (for the input ``delta``) like any
    parameter. A delay that comes with logged, moving inputs: use `Dataset.hold_mean` first, or half a sample of it is
    the hold. Raises ParameterError if no input is named, one is unknown, or a delay is outside 0 to ``longest``.

    Parameters
    ----------
    model : OdeModel
        What the inputs drive.
    delays : mapping
        Delay by input. [s]
    longest : float
        Largest delay; its samples are kept as states. [s]

    For example ``Delayed(bicycle, delays={"delta": 0.05})``, then ``GreyBox(start=..., free=("C_f", "delay_delta"))``.
    """

    model: OdeModel
    _: KW_ONLY
    delays: Mapping[str, float]
    longest: float = 0.25
    fit_info: FitInfo | None = field(default=None, repr=False, compare=False)

    params = taken("model.params")
    ode = taken("model")
    n_past = derived(lambda self: math.ceil(self.longest / self.dt - 1e-9) + 1)  # samples kept of each delayed input
    memory = derived(lambda self: self.n_past + 1)

    def __post_init__(self) -> None:
        object.__setattr__(self, "delays", dict(self.delays))
        if not self.delays:
            raise ParameterError("no input is delayed; expected at least one, such as delays={'delta': 0.05}")
        if not (self.longest > 0 and math.isfinite(self.longest)):
            raise ParameterError(f"longest is {self.longest} s; expected a positive time")
        require_few_lags(self.longest / self.model.dt, f"a delay of up to {self.longest:g} s")
        for name, value in self.delays.items():
            if name not in self.model.inputs:
                raise ParameterError(f"the model has no input '{name}'; {nearest(name, self.model.inputs)}")
            if not (is_symbolic(value) or is_traced(value)) and not 0 <= value <= self.longest * (1 + 1e-9):
                raise ParameterError(
                    f"the delay of '{name}' is {value:g} s; expected 0 to longest = {self.longest:g} s: raise longest"
                )

    def __hash__(self) -> int:
        return hash((self.model, tuple(self.delays.items()), self.longest))

    @derived
    def states(self) -> tuple[str, ...]:
        """States of the ODE, then the past of each delayed input, newest first."""
        past = [f"{name}(k-{j})" for name in self.delays for j in range(1, self.n_past + 1)]
        return (*self.model.states, *past)

    def initial_state(self, data: Dataset) -> np.ndarray:
        """The ODE's state from the last of the first `memory` samples, and the inputs before it."""
        last = self.memory - 1
        past = [data[name][:last][::-1] for name in self.delays]
        return np.concatenate([np.asarray(self.model.initial_state(data.rows(last, last + 1)), dtype=float), *past])

    def step(self, x: Vector, u: Vector) -> Vector:
        """State one sample later."""
        n, k = self.model.n_states, self.n_past
        later = [self.model.step(x[:n], self._late(u, x[n:]))]
        for i, name in enumerate(self.delays):
            past = x[n + i * k : n + (i + 1) * k]
            later += [stack([u[self.inputs.index(name)]]), past[: k - 1]]
        return concatenate(later)

    def output(self, x: Vector, u: Vector) -> Vector:
        """Outputs of the ODE at the late inputs."""
        n = self.model.n_states
        return self.model.output(x[:n], self._late(u, x[n:]))

    def correct(self, x: Vector, u: Vector, y: Vector) -> Vector:
        """The ODE's correction."""
        n = self.model.n_states
        return concatenate([self.model.correct(x[:n], self._late(u, x[n:]), y), x[n:]])

    def _late(self, u: Vector, past: Vector) -> Vector:
        """Inputs as they act, from the newest and the past of each delayed one, one after the other."""
        pieces, k = [u[i] for i in range(self.n_inputs)], self.n_past
        for i, name in enumerate(self.delays):
            j = self.inputs.index(name)
            samples = [u[j], *(past[i * k + m] for m in range(k))]
            weights = interpolation(self.delays[name] / self.dt, len(samples))
            pieces[j] = sum(w * s for w, s in zip(weights, samples, strict=True))
        return stack(pieces)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Parameters of the ODE, then the delays."""
        return (*self.model.parameter_names, *(f"{_PREFIX}{name}" for name in self.delays))

    def si(self, name: str) -> SI:
        """Unit, meaning and range of one parameter; a delay ranges from 0 to ``longest``."""
        if name.removeprefix(_PREFIX) in self.delays and name.startswith(_PREFIX):
            return SI("s", f"time from logging {name.removeprefix(_PREFIX)} to its effect", 0.0, self.longest)
        if name in self.model.parameter_names:
            return self.model.si(name)
        raise ParameterError(
            f"the delayed {type(self.model).__name__} has no parameter '{name}'; {nearest(name, self.parameter_names)}:"
            " use one of these names"
        )

    def value(self, name: str) -> float:
        """Value of one parameter, SI units."""
        self.si(name)
        late = name.removeprefix(_PREFIX)
        return float(self.delays[late]) if name.startswith(_PREFIX) and late in self.delays else self.model.value(name)

    def with_values(self, **values: Any) -> Self:
        """A copy with some parameters or delays replaced (numbers or symbols)."""
        inside = {*self.model.parameter_names}
        for name in (n for n in values if n not in inside):
            self.si(name)
        late = {n: values.get(f"{_PREFIX}{n}", v) for n, v in self.delays.items()}
        own = {n: v for n, v in values.items() if n in inside}
        return replace(self, model=self.model.with_values(**own), delays=late, fit_info=None)

    def resampled(self, dt: float, *, substeps: int = 0, outputs: tuple[str, ...] = ()) -> Self:
        """The same at another sample time [s]; no longer past is kept than the delays need."""
        model = self.model.resampled(dt, substeps=substeps, outputs=outputs)
        return replace(self, model=model, longest=max(dt, *self.delays.values()))

    def drive_rows(self, data: Dataset) -> np.ndarray:
        """Inputs of each sample from ``memory - 1`` on, then the past of each delayed input."""
        k, n = self.n_past, data.n_samples
        past = [data[name][k - j : n - j] for name in self.delays for j in range(1, k + 1)]
        return np.column_stack([data.select(inputs=self.inputs).u[k:], *past])

    def drive(self, row: Vector) -> Vector:
        """Late inputs from one row of `drive_rows`."""
        return self._late(row[: self.n_inputs], row[self.n_inputs :])
