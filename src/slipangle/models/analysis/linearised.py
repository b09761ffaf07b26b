"""`LinearisedModel`: a linear state space around an operating point, its poles, zeros and responses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from scipy import linalg, optimize

from slipangle.errors import ConfigError, ParameterError, nearest
from slipangle.models.analysis import delays
from slipangle.models.analysis.delays import moved
from slipangle.models.analysis.responses import Estimate, FrequencyResponse, TimeResponse
from slipangle.models.analysis.trim import Trim
from slipangle.numerics.held import held

SHARE = 1e-3  # of a standard deviation, by which parameters are moved to see what follows
_POINTS = 1001
_AT_ONCE = 20_000  # numbers in the matrices that are solved together
_UNITS = {"delta": "rad", "delta_sw": "rad", "v_x": "m/s", "v_y": "m/s", "r": "rad/s", "a_y": "m/s2", "beta": "rad"}
_UNITS |= {"a_x": "m/s2", "T_f": "N m", "T_r": "N m", "psi": "rad", "r_dot": "rad/s2", "delta_w": "rad"}


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearisedModel:
    """A linear state space around an operating point: ``x' = A x + B u``, ``y = C x + D u``, all beside that point.

    Raises ParameterError if the delays are not one time of 0 s or more per input, or a sampled system has any.

    Parameters
    ----------
    A, B, C, D : array, shapes (n, n), (n, n_inputs), (n_outputs, n), (n_outputs, n_inputs)
        Matrices, SI units.
    dt : float
        Sample time; 0 where x' is a rate, else x' is the state one sample later. [s]
    states, inputs, outputs : tuple of str
        Names of their entries.
    trim : Trim
        The steady state they are beside.
    delay : array, shape (n_inputs,), optional
        By which each input acts late, in continuous time; by default not at all. In samples past inputs are states. [s]
    variants : tuple of pairs of LinearisedModel
        Neighbours along each direction in which the fit is unsure, which the bands come from.
    uncertainty : str
        Where the bands come from, or why there are none.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    trim: Trim
    delay: np.ndarray = field(default=None)  # type: ignore[assignment]
    name: str = "model"
    variants: tuple[tuple[LinearisedModel, LinearisedModel], ...] = field(default=(), repr=False)
    uncertainty: str = ""

    def __post_init__(self) -> None:
        late = np.zeros(len(self.inputs)) if self.delay is None else np.array(self.delay, dtype=float)
        if late.shape != (len(self.inputs),) or not (late >= 0).all() or (self.dt and late.any()):
            raise ParameterError(
                f"delay is {late}; expected {len(self.inputs)} times of 0 s or more, one per input, and none of a "
                "sampled system, whose past inputs are states"
            )
        object.__setattr__(self, "delay", late)

    # ---- poles and zeros ---------------------------------------------------------------------------------------

    @cached_property
    def poles(self) -> Any:
        """Eigenvalues of A, shape (n,), the slowest first; [rad/s], or [-] where ``dt`` is not 0."""
        found = np.linalg.eigvals(self.A).astype(complex)
        rates = self.rates_of(found)
        order = np.lexsort((-np.round(found.imag, 9), np.round(np.abs(rates), 9)))
        return found[order]

    @property
    def rates(self) -> Any:
        """Poles as those of continuous time, shape (n,); minus infinity for a pure delay. [rad/s]"""
        return self.rates_of(self.poles)

    def rates_of(self, poles: np.ndarray) -> Any:
        """``poles`` of this model's time, shape (n,), as those of continuous time. [rad/s]"""
        if not self.dt:
            return poles
        fast = np.abs(poles) < 1e-8
        return np.where(fast, -np.inf + 0j, np.log(np.where(fast, 1.0, poles)) / self.dt)

    @property
    def natural_frequency(self) -> np.ndarray:
        """Undamped natural frequency of each pole, shape (n,). [rad/s]"""
        return np.abs(self.rates)

    @property
    def damping(self) -> np.ndarray:
        """Damping ratio of each pole, shape (n,); below zero where it grows. [-]"""
        rates = self.rates
        size = np.abs(rates)
        with np.errstate(invalid="ignore"):
            return np.where(np.isinf(size), 1.0, -rates.real / np.where(size > 0, size, 1.0))

    @property
    def stable(self) -> bool:
        """Whether every pole decays."""
        return bool((self.rates.real < 0).all())

    def zeros(self, output: str | None = None, input: str | None = None) -> np.ndarray:
        """Transmission zeros from an input to an output (the first ones by default), in the unit of the poles."""
        i, j = self._pair(output, input)
        n = len(self.A)
        pencil = np.block([[self.A, self.B[:, [j]]], [self.C[[i]], self.D[[i]][:, [j]]]])
        mass = np.zeros_like(pencil)
        mass[:n, :n] = np.eye(n)
        pairs: Any = linalg.eigvals(pencil, mass, homogeneous_eigvals=True)
        alpha, beta = pairs
        size = np.abs(beta) * max(1.0, float(np.abs(pencil).max()))
        finite = size > 1e-9 * np.abs(alpha)
        found = (alpha[finite] / beta[finite]).astype(complex)
        return found[np.argsort(np.abs(found))]

    # ---- responses ---------------------------------------------------------------------------------------------

    def gain(self, output: str | None = None, input: str | None = None) -> Estimate:
        """Steady-state output per input, with its standard deviation.

        Raises ParameterError where a pole at rest leaves none.
        """
        i, j = self._pair(output, input)

        def steady(model: LinearisedModel) -> np.ndarray:
            return np.array([model._steady(i, j)])

        return self.estimate(steady, self._unit(i, j))[0]

    def _steady(self, i: int, j: int) -> float:
        left = np.eye(len(self.A)) - self.A if self.dt else -self.A
        if not len(left) or np.linalg.cond(left) < 1e12:
            return float(self.C[i] @ np.linalg.solve(left, self.B[:, j]) + self.D[i, j])
        slow = 1e-6 * np.abs(self._motions()).min()  # a state that nothing moves, such as a disturbance, does no harm
        near, nearer = self.frequency_response(np.array([slow, slow / 10]))[:, i, j]
        if abs(nearer) > 3 * abs(near):
            raise ParameterError(
                f"a constant '{self.inputs[j]}' moves '{self.outputs[i]}' of '{self.name}' without end; expected a "
                "steady state: look at another output or at bode()"
            )
        return float(near.real)

    def frequency_response(self, omega: np.ndarray) -> np.ndarray:
        """Outputs over inputs at angular frequencies [rad/s], shape (n_frequencies, n_outputs, n_inputs), complex."""
        s = 1j * np.asarray(omega, dtype=float)
        z = np.exp(s * self.dt) if self.dt else s
        eye, many = np.eye(len(self.A)), max(1, _AT_ONCE // max(1, self.A.size))
        parts = [z[k : k + many, None, None] for k in range(0, max(1, len(z)), many)]
        found = np.concatenate([self.C @ np.linalg.solve(p * eye - self.A, self.B) + self.D for p in parts])
        return found * np.exp(-s[:, None, None] * self.delay)

    def bode(
        self, output: str | None = None, input: str | None = None, *, frequency: np.ndarray | None = None
    ) -> FrequencyResponse:
        """Magnitude and phase from an input to an output (the first ones by default) with their bands.

        ``frequency`` [Hz], shape (n,), by default two decades around the motion; ``.plot()`` draws it. Raises
        ParameterError if a sampled system is asked beyond half its sampling frequency.
        """
        i, j = self._pair(output, input)
        f = self._usual_frequencies() if frequency is None else np.asarray(frequency, dtype=float)
        if self.dt and (f > 0.5 / self.dt * (1 + 1e-9)).any():
            raise ParameterError(
                f"the largest frequency is {f.max():g} Hz; expected at most {0.5 / self.dt:g} Hz, half the sampling "
                "rate of the model"
            )
        value = self.frequency_response(2 * np.pi * f)[:, i, j]

        def relative(model: LinearisedModel) -> np.ndarray:
            ratio = model.frequency_response(2 * np.pi * f)[:, i, j] / value
            return np.concatenate([np.log(np.abs(ratio)), np.angle(ratio)])

        magnitude, phase = np.split(self._std(relative, 2 * len(f)), 2)
        names: dict[str, Any] = {
            "output": self.outputs[i],
            "input": self.inputs[j],
            "unit": self._unit(i, j),
            "name": self.name,
        }
        return FrequencyResponse(frequency=f, value=value, magnitude_std=magnitude, phase_std=phase, **names)

    def step(
        self, output: str | None = None, input: str | None = None, *, duration: float | None = None
    ) -> TimeResponse:
        """Response to a unit step with its band; by default long enough to settle. [s]"""
        return self._response("step", output, input, duration)

    def impulse(
        self, output: str | None = None, input: str | None = None, *, duration: float | None = None
    ) -> TimeResponse:
        """Response to an impulse of area 1, without its direct part, with its band; long enough to settle. [s]"""
        return self._response("impulse", output, input, duration)

    def _response(self, kind: Any, output: str | None, input: str | None, duration: float | None) -> TimeResponse:
        i, j = self._pair(output, input)
        if duration is not None and not (np.isfinite(duration) and duration > 0):
            raise ParameterError(f"duration is {duration:g} s; expected a positive time")
        end = self._usual_duration() if duration is None else duration
        h = self.dt or end / (_POINTS - 1)
        t = np.arange(max(2, round(end / h) + 1)) * h

        def respond(model: LinearisedModel) -> np.ndarray:
            A, B = (model.A, model.B) if model.dt else held(model.A, model.B, h)
            x, push = (model.B[:, j], 0.0) if kind == "impulse" else (np.zeros(len(A)), B[:, j])
            if kind == "impulse" and model.dt:
                x = x / model.dt
            y = np.zeros(len(t))
            direct = model.D[i, j] if kind == "step" else 0.0
            first = int(np.ceil(model.delay[j] / h - 1e-9))
            if first:
                x = moved(model.A, model.B[:, j], max(first * h - float(model.delay[j]), 0.0), kind == "impulse")
            for k in range(first, len(t)):
                if kind == "impulse" and model.dt:  # it acts on the state one sample later
                    y[k] = model.C[i] @ x if k else 0.0
                    x = A @ x if k else x
                else:
                    y[k] = model.C[i] @ x + direct
                    x = A @ x + push
            return y

        grows = bool((self.rates.real > 1e-9).any())
        steady = float("inf") if grows else self._steady(i, j) if kind == "step" else 0.0
        unit = self._unit(i, j) if kind == "step" else f"{_bracketed(self._unit(i, j))}/s".replace("-/", "1/")
        names: dict[str, Any] = {"output": self.outputs[i], "input": self.inputs[j], "unit": unit, "name": self.name}
        found = respond(self)
        return TimeResponse(t=t, y=found, std=self._std(respond, len(t)), kind=kind, final=steady, **names)

    # ---- uncertainty -------------------------------------------------------------------------------------------

    def estimate(self, get: Callable[[LinearisedModel], np.ndarray], unit: str = "-") -> list[Estimate]:
        """Numbers that follow from the matrices, each with the standard deviation that the fit gives it.

        ``get`` makes an array, shape (n,), of a linearised model; the deviations are first-order (delta method).
        """
        value = np.asarray(get(self), dtype=float)
        return [Estimate(float(v), float(s), unit) for v, s in zip(value, self._std(get, len(value)), strict=True)]

    def _std(self, get: Callable[[LinearisedModel], np.ndarray], n: int) -> np.ndarray:
        if not self.variants:
            return np.full(n, np.nan)
        slopes = [(np.asarray(get(a)) - np.asarray(get(b))) / (2 * SHARE) for a, b in self.variants]
        return np.sqrt(np.sum(np.square(slopes), axis=0))

    def pole_std(self) -> tuple[np.ndarray, np.ndarray]:
        """Standard deviations of natural frequency [rad/s] and damping [-] of each pole, shapes (n,); NaN: not known.

        A double pole has none: it moves with the root of a change.
        """

        def matched(model: LinearisedModel) -> np.ndarray:
            far = np.abs(self.poles[:, None] - model.poles)
            order = optimize.linear_sum_assignment(far)[1]
            with np.errstate(invalid="ignore"):
                return np.concatenate([model.natural_frequency[order], model.damping[order]])

        with np.errstate(invalid="ignore"):
            frequency, damping = np.split(self._std(matched, 2 * len(self.A)), 2)
        return frequency, damping

    # ---- other forms -------------------------------------------------------------------------------------------

    def sampled(self, dt: float) -> LinearisedModel:
        """The same in discrete time, inputs held over each sample of ``dt`` [s].

        Raises ParameterError where it is sampled already, or dt is no positive time.
        """
        if self.dt:
            raise ParameterError(f"'{self.name}' is sampled at {self.dt:g} s already; expected continuous time")
        if not (np.isfinite(dt) and dt > 0):
            raise ParameterError(f"dt is {dt:g} s; expected a positive time")
        made = delays.sampled(self._late, self.inputs, dt)
        pairs = tuple((a.sampled(dt), b.sampled(dt)) for a, b in self.variants)
        return replace(self, **made._asdict() | {"delay": None}, dt=dt, variants=pairs)

    @property
    def _late(self) -> delays.LateInputs:
        return delays.LateInputs(self.A, self.B, self.C, self.D, self.delay, self.states)

    def continuous(self) -> LinearisedModel:
        """The same in continuous time, taking the inputs as held over each sample.

        Past inputs among the states become a `delay`, of any part of a sample; where a `Delayed` model interpolates its
        late inputs, the result is the system and the delay that it interpolates. Raises ParameterError where no
        continuous model does the same: another pole at zero or below, or past inputs that are no delay.
        """
        if not self.dt:
            return self
        made = delays.continuous(self._late, self.dt)
        if made is None:
            raise ParameterError(
                f"'{self.name}' has a pole at or below zero, or past inputs that are no delay; no continuous model of "
                "its order is the same at the samples: keep it discrete"
            )
        pairs = tuple((a.continuous(), b.continuous()) for a, b in self.variants)
        return replace(self, **made._asdict(), dt=0.0, variants=pairs)

    def to_scipy(self) -> Any:
        """A ``scipy.signal.StateSpace``, with ``dt`` where it is sampled.

        Raises ParameterError where an input acts late in continuous time, which SciPy has no place for.
        """
        self._without_delay()
        from scipy.signal import StateSpace

        matrices = self.A, self.B, self.C, self.D
        return StateSpace(*matrices, dt=self.dt) if self.dt else StateSpace(*matrices)

    def to_control(self) -> Any:
        """A ``control.StateSpace`` of python-control, with the names of states, inputs and outputs.

        Raises ConfigError if python-control is not installed, and ParameterError where an input acts late in continuous
        time, which a state space has no place for.
        """
        self._without_delay()
        try:
            control = import_module("control")
        except ImportError:
            raise ConfigError(
                "to_control needs python-control, which is not installed; expected it: pip install control"
            ) from None
        names = {"states": list(self.states), "inputs": list(self.inputs), "outputs": list(self.outputs)}
        return control.ss(self.A, self.B, self.C, self.D, *([self.dt] if self.dt else []), **names)

    def _without_delay(self) -> None:
        if self.delay.any():
            late = ", ".join(f"'{n}' {d:g} s" for n, d in zip(self.inputs, self.delay, strict=True) if d)
            raise ParameterError(
                f"inputs of '{self.name}' act late ({late}); expected none: take sampled(dt) of it first"
            )

    # ---- showing -----------------------------------------------------------------------------------------------

    def plot(self, output: str | None = None, input: str | None = None) -> Any:
        """Bode diagram from an input to an output; a Plotly figure that shows in a notebook."""
        return self.bode(output, input).plot()

    def __repr__(self) -> str:
        kind = f"sampled at {self.dt:g} s" if self.dt else "continuous"
        kind += "".join(f", {n} late by {d:.3g} s" for n, d in zip(self.inputs, self.delay, strict=True) if d)
        place = "" if self.trim.v_x is None else f" at {self.trim.v_x:g} m/s, a_y {self.trim.a_y:g} m/s2"
        return f"<linear {self.name}{place}: {len(self.A)} states, {', '.join(self.inputs)} to " + (
            f"{', '.join(self.outputs)}, {kind}; {self.uncertainty}>"
        )

    def _repr_html_(self) -> str:
        return import_module("slipangle.report.linear").modes_table(self)._repr_html_()  # a room above this one

    # ---- details -----------------------------------------------------------------------------------------------

    def _pair(self, output: str | None, input: str | None) -> tuple[int, int]:
        for what, name, known in (("output", output, self.outputs), ("input", input, self.inputs)):
            if name is not None and name not in known:
                raise ParameterError(f"'{self.name}' has no {what} '{name}'; {nearest(name, known)}")
        return 0 if output is None else self.outputs.index(output), 0 if input is None else self.inputs.index(input)

    def _unit(self, i: int, j: int) -> str:
        above, below = (_UNITS.get(n, "-") for n in (self.outputs[i], self.inputs[j]))
        if above == below or below == "-":
            return "-" if above == below else above
        return f"{_bracketed('1' if above == '-' else above)}/{_bracketed(below)}"

    def _motions(self) -> Any:
        """Finite rates other than zero, else one a second. [rad/s]"""
        rates = self.rates[np.isfinite(self.rates)]
        rates = rates[np.abs(rates) > 1e-6]
        return rates if len(rates) else np.array([-1.0 + 0j])

    def _usual_frequencies(self) -> np.ndarray:
        size = np.abs(self._motions()) / (2 * np.pi)
        top = float(np.clip(10 * np.median(size), 5.0, 1e3))
        return np.geomspace(min(0.05, top / 1e3), min(top, 0.5 / self.dt) if self.dt else top, 300)

    def _usual_duration(self) -> float:
        decay = np.abs(self._motions().real)
        settled = float(np.clip(8.0 / max(decay.min(), 1e-6), 1.0, 30.0)) if self._motions().real.max() < 0 else 3.0
        return settled + float(self.delay.max(initial=0.0))


def _bracketed(unit: str) -> str:
    return f"({unit})" if "/" in unit or " " in unit else unit
