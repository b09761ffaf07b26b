"""Vehicle parameters and unmeasured states one sample at a time: an extended Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Generic, TypeVar

import casadi as ca
import numpy as np

from slipangle.data.dataset import Dataset
from slipangle.errors import NotFiniteError, ParameterError, SimulationError, nearest
from slipangle.fields import Checked, Within
from slipangle.identify.excitation import require_identifiable
from slipangle.models.fast import bind
from slipangle.models.model import FitInfo
from slipangle.models.ode import OdeModel
from slipangle.models.provenance import provenance
from slipangle.numerics.integrate import discretise
from slipangle.optimal.terms import require_names

M = TypeVar("M", bound=OdeModel)
Std = Annotated[float, Within(0, open="both")]
Size = Annotated[float, Within(0, open="high")]


@dataclass(frozen=True, kw_only=True)
class EKF(Checked, Generic[M]):
    """Extended Kalman filter for the states and some parameters of an ODE model. [1]_ sec. 8.3, [2]_ ch. 8.

    The parameters join the state as random walks: a positive one by its logarithm, another as it is; both stay inside
    the range that its parameter set gives. With no free parameter it is a state observer, such as of side slip.
    `start_at` gives a `RecursiveVehicle` that takes one sample at a time; `fit` runs through a whole record.

    Raises ParameterError if a name is unknown, a measured output has no noise, or a number is not positive.

    Parameters
    ----------
    start : OdeModel
        Model with the start values; its outputs are what is measured.
    free : tuple of str
        Names of the parameters to estimate; none for a pure observer.
    noise_std : mapping of str to float
        Standard deviation of each output's measurement noise, in the output's unit.
    process_std, walk_std : mapping of str to float
        Standard deviation, per root of a second, by which a state wanders off the model, and by which a parameter
        wanders (relative for a positive one, else in its unit); 0 for the others.
    prior_std, state_std : mapping of str to float
        Standard deviation at the start: of a parameter, relative for a positive one (0.3 unless given), else in its
        unit (a sixth of its range unless given); of a state at the start of an experiment, in its unit (the noise of
        the output of that name, else 1, unless given).

    References
    ----------
    .. [1] B. D. O. Anderson, J. B. Moore, Optimal Filtering, 1979.
    .. [2] D. Simon, Optimal State Estimation, 2006: the update of one output at a time.
    """

    start: M
    free: tuple[str, ...]
    noise_std: Mapping[str, Std]
    process_std: Mapping[str, Size] = field(default_factory=dict)
    walk_std: Mapping[str, Size] = field(default_factory=dict)
    prior_std: Mapping[str, Std] = field(default_factory=dict)
    state_std: Mapping[str, Size] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.free:
            self.start.params.si(name)
        states, outputs = self.start.states, self.start.outputs
        for key, known in (("noise_std", outputs), ("walk_std", self.free), ("prior_std", self.free)):
            require_names(getattr(self, key), known, key)
        for key in ("process_std", "state_std"):
            require_names(getattr(self, key), states, key)
        for name in outputs:
            if name not in self.noise_std:
                raise ParameterError(
                    f"noise_std lacks the measured output '{name}'; expected its noise: give noise_std['{name}'] in "
                    "the output's unit"
                )

    def start_at(self, x0: np.ndarray | None = None) -> RecursiveVehicle:
        """A filter before its first sample; ``x0``, shape (n_states,), is the state expected there, by default zero."""
        tracker = RecursiveVehicle(self)
        tracker.restart(x0)
        return tracker

    def fit(self, data: Dataset) -> M:
        """The model with the parameters after the last sample of ``data``, their covariance in its ``fit_info``.

        Errors are those of `slipangle.identify.physics.grey_box.GreyBox`; SimulationError if the filter diverged.
        """
        chosen = data.select(inputs=self.start.inputs, outputs=self.start.outputs)
        require_identifiable(chosen, max(1, len(self.free)), scheduling=("v_x",))
        estimate = self.start_at()
        estimate.run(data)
        model = estimate.model(train_name=data.name)
        return replace(model, fit_info=replace(model.fit_info, **provenance(chosen)))


@dataclass(frozen=True)
class FilterRun:
    """How a filter went over a record: time [s], shape (n_samples,), and a row per sample, a column per name.

    States and parameters (SI units) are those after each sample, with their standard deviations. The error is the
    measured minus predicted output before the sample was taken in, with its standard deviation; NaN where the output
    was not measured.
    """

    t: np.ndarray
    state_names: tuple[str, ...]
    states: np.ndarray
    states_std: np.ndarray
    free: tuple[str, ...]
    parameters: np.ndarray
    parameters_std: np.ndarray
    outputs: tuple[str, ...]
    error: np.ndarray
    error_std: np.ndarray

    def parameter(self, name: str) -> np.ndarray:
        """One parameter over time.

        Raises ParameterError if it was not free.
        """
        if name not in self.free:
            raise ParameterError(f"'{name}' was not free; {nearest(name, self.free)}: use one of these")
        return self.parameters[:, self.free.index(name)]


class RecursiveVehicle:
    """A vehicle whose states and parameters are estimated one sample at a time; made by `EKF.start_at`.

    `update` allocates nothing: prediction, derivatives and correction are one CasADi function on arrays made here.
    """

    def __init__(self, settings: EKF) -> None:
        model, nx, nq = settings.start, settings.start.n_states, len(settings.free)
        self.settings, self._nx, self._n = settings, nx, nx + nq
        self._scales = _Scales(settings)
        n, ny, nu = self._n, model.n_outputs, model.n_inputs
        self._z, self._P = np.zeros(n), np.zeros((n, n))
        self._z_new, self._P_new = np.zeros(n), np.zeros((n, n))
        self._u, self._before, self._y, self._seen = np.zeros(nu), np.zeros(nu), np.zeros(ny), np.zeros(ny)
        self._dt, self._error, self._variance = np.zeros(1), np.zeros(ny), np.zeros(ny)
        self._finite_y, self._finite_u = np.zeros(ny, dtype=bool), np.zeros(nu, dtype=bool)
        self._finite_z = np.zeros(n, dtype=bool)
        arguments = [self._z, self._P, self._before, self._u, self._y, self._seen, self._dt]
        results = self._z_new, self._P_new, self._error, self._variance
        self._run = bind(_filter(settings, self._scales), arguments, *results)
        self._P[nx:, nx:] = np.diag(self._scales.prior**2)
        self.n_samples = 0
        self.restart()

    def restart(self, x0: np.ndarray | None = None) -> None:
        """Forget the state but not the parameters: for a new experiment or after a gap.

        ``x0``, shape (n_states,), is the state expected at the next sample; by default zero.
        """
        nx, s = self._nx, self.settings
        x0 = np.zeros(nx) if x0 is None else np.asarray(x0, dtype=float)
        if x0.shape != (nx,) or not np.isfinite(x0).all():
            raise ParameterError(f"x0 is {x0.tolist()}; expected {nx} finite numbers: {', '.join(s.start.states)}")
        self._z[:nx] = x0
        self._P[:nx], self._P[:, :nx] = 0.0, 0.0
        std = [s.state_std.get(name, s.noise_std.get(name, 1.0)) for name in s.start.states]
        self._P[np.arange(nx), np.arange(nx)] = np.square(std)
        self._dt[0] = 0.0  # the first sample corrects only

    def update(self, y: float | np.ndarray, u: float | np.ndarray) -> np.ndarray:
        """Take in what was measured at one sample.

        Raises ParameterError if there are not as many numbers as channels, NotFiniteError if an input is not finite,
        and SimulationError if the estimate left the finite numbers. After the last two the filter is as before.

        Parameters
        ----------
        y : float or array, shape (n_outputs,)
            In the order of the model's outputs; NaN for what was not measured at this sample.
        u : float or array, shape (n_inputs,)
            Inputs at the same sample, in the order of the model's inputs.

        Returns
        -------
        array, shape (n_outputs,)
            Measured minus predicted output, before this sample was taken in; 0 where not measured. The same array at
            every call: copy what is to be kept.
        """
        self._take(y, self._y, "outputs")
        self._take(u, self._u, "inputs")
        if not np.isfinite(self._u, out=self._finite_u).all():
            raise NotFiniteError(
                f"the sample holds u = {self._u.tolist()}; expected finite numbers: leave the sample out and call "
                "restart() with the state expected next"
            )
        np.isfinite(self._y, out=self._finite_y)
        self._seen[:] = self._finite_y
        if not self._finite_y.all():
            self._y[~self._finite_y] = 0.0
        self._run()
        if not np.isfinite(self._z_new, out=self._finite_z).all():
            raise SimulationError(
                f"the filter leaves the finite numbers at its sample {self.n_samples}; expected a model that follows "
                "the data: check units and signs, or give smaller prior_std"
            )
        self._z[:] = self._z_new
        self._P[:] = self._P_new
        self._before[:] = self._u
        self._dt[0] = self.settings.start.dt
        self.n_samples += 1
        return self._error

    def _take(self, value: float | np.ndarray, into: np.ndarray, what: str) -> None:
        if np.size(value) != len(into):
            names = self.settings.start.outputs if what == "outputs" else self.settings.start.inputs
            raise ParameterError(f"a sample has {np.size(value)} {what}; expected {len(into)}: {', '.join(names)}")
        into[:] = value

    def run(self, data: Dataset) -> FilterRun:
        """Take in all samples of a record, one experiment after the other, each from its own initial state.

        Raises SampleTimeError or MissingColumnError if the data have another sample time or lack a channel, and
        SimulationError if the filter diverged.
        """
        model = self.settings.start
        data.require_dt(model.dt)
        for name in (*model.inputs, *model.outputs):
            data.index(name)
        n, nx, nq, ny = data.n_samples, self._nx, len(self.settings.free), model.n_outputs
        states, parameters, errors = np.empty((2, n, nx)), np.empty((2, n, nq)), np.empty((2, n, ny))
        for part, start in zip(data.experiments, data.starts, strict=True):
            chosen = part.select(inputs=model.inputs, outputs=model.outputs)
            y, u = chosen.y, chosen.u
            self.restart(model.initial_state(part.head(model.memory)))
            for k in range(part.n_samples):
                errors[0, start + k] = self.update(y[k], u[k])
                errors[1, start + k] = np.sqrt(self._variance)
                states[0, start + k], states[1, start + k] = self.state, self.state_std
                parameters[0, start + k], parameters[1, start + k] = self.parameters, self.parameters_std
        (x, x_std), (p, p_std), (e, e_std) = states, parameters, errors
        free, outputs = self.settings.free, model.outputs
        return FilterRun(data.t, model.states, x, x_std, free, p, p_std, outputs, e, e_std)

    # ---- what is known now -------------------------------------------------------------------------------------

    @property
    def state(self) -> np.ndarray:
        """Estimated states, in the order of the model's."""
        return self._z[: self._nx].copy()

    @property
    def state_std(self) -> np.ndarray:
        """Their standard deviations."""
        return np.sqrt(np.diag(self._P)[: self._nx])

    @property
    def parameters(self) -> np.ndarray:
        """Estimated parameters, SI units, in the order of ``free``."""
        return np.asarray(self._scales.values(self._z[self._nx :]), dtype=float)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of the parameters, to first order."""
        slope = self._scales.slopes(self._z[self._nx :])
        return self._P[self._nx :, self._nx :] * np.outer(slope, slope)

    @property
    def parameters_std(self) -> np.ndarray:
        """Standard deviations of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    def model(self, *, train_name: str = "") -> Any:
        """The vehicle with the present estimates, their covariance in its ``fit_info``."""
        s = self.settings
        values = self.parameters
        info = FitInfo(
            names=s.free,
            values=values,
            covariance=self.covariance,
            noise_std=np.array([s.noise_std[name] for name in s.start.outputs]),
            n_samples=self.n_samples,
            units=tuple(s.start.params.si(name).unit for name in s.free),
            method="extended Kalman filter; covariance for the noise that it was given",
            train_name=train_name,
        )
        params = s.start.params.with_values(**dict(zip(s.free, map(float, values), strict=True)))
        return replace(s.start, params=params, fit_info=info)


class _Scales:
    """Between parameters p and what the filter estimates: ``log(p / p0)`` of positive ones, ``p - p0`` of others."""

    def __init__(self, settings: EKF) -> None:
        metadata = [settings.start.params.si(name) for name in settings.free]
        self.start = np.array([float(getattr(settings.start.params, name)) for name in settings.free])
        low, high = (np.array([getattr(m, end) for m in metadata]) for end in ("lower", "upper"))
        self.positive = (low >= 0) & (self.start > 0)
        with np.errstate(divide="ignore"):
            ratio = [np.log(np.maximum(end, 0) / np.where(self.positive, self.start, 1.0)) for end in (low, high)]
        self.lower = np.where(self.positive, ratio[0], low - self.start)
        self.upper = np.where(self.positive, ratio[1], high - self.start)
        usual = np.where(self.positive, 0.3, (high - low) / 6)
        self.prior = np.array([settings.prior_std.get(n, usual[i]) for i, n in enumerate(settings.free)])
        for name, std in zip(settings.free, self.prior, strict=True):
            if not np.isfinite(std):
                raise ParameterError(f"'{name}' has no finite range; expected prior_std['{name}'] in its unit")

    def values(self, q: Any) -> list[Any]:
        """Parameters, from numbers or symbols."""
        exp = ca.exp if isinstance(q, (ca.SX, ca.MX)) else np.exp
        pairs = zip(self.start, self.positive, strict=True)
        return [p * exp(q[i]) if positive else p + q[i] for i, (p, positive) in enumerate(pairs)]

    def slopes(self, q: np.ndarray) -> np.ndarray:
        """Derivative of each parameter by its q."""
        return np.where(self.positive, self.values(q), 1.0)


def _filter(settings: EKF, scales: _Scales) -> ca.Function:
    """``(z, P, u before, u, y, seen, dt) -> (z, P, error, its variance)``; dt = 0 leaves out the prediction.

    The covariance is corrected one output at a time in Joseph's form, so it stays positive.
    """
    model, free = settings.start, settings.free
    nx, n, nu, ny = model.n_states, model.n_states + len(free), model.n_inputs, model.n_outputs
    kind: Any = ca.MX if model.method == "radau" else ca.SX
    z, P = kind.sym("z", n), kind.sym("P", n, n)
    before, u, y, seen, dt = (kind.sym(*a) for a in (("v", nu), ("u", nu), ("y", ny), ("seen", ny), ("dt", 1)))

    def at(q: Any) -> OdeModel:
        named = dict(zip(free, scales.values(q), strict=True))
        return replace(model, params=model.params.with_values(**named), fit_info=None)

    nq = n - nx
    if model.own_step:
        step: Any = lambda x, drive: at(drive[nu:]).step(x, drive[:nu])  # noqa: E731
    else:
        step = discretise(
            lambda x, drive: at(drive[nu:]).derivative(x, drive[:nu]),
            model.dt,
            n_states=nx,
            n_inputs=nu + nq,
            method=model.method,
            substeps=model.substeps,
        )
    moved = ca.vertcat(step(z[:nx], ca.vertcat(before, z[nx:])), z[nx:])
    F = ca.jacobian(moved, z)
    process = [settings.process_std.get(name, 0.0) for name in model.states]
    Q = ca.diag(ca.DM([v**2 for v in (*process, *(settings.walk_std.get(name, 0.0) for name in free))]))
    first = dt == 0
    ahead = ca.if_else(first, z, moved)
    covariance = ca.if_else(first, P, ca.mtimes(F, ca.mtimes(P, F.T)) + Q * dt)
    now = kind.sym("now", n)
    seen_y = at(now[nx:]).output(now[:nx], u)
    look = ca.Function("look", [now, u], [ca.densify(seen_y), ca.densify(ca.jacobian(seen_y, now))])
    expected, H = look(ahead, u)
    error, shift, spread = seen * (y - expected), kind.zeros(n), []
    for i in range(ny):
        h, noise = H[i, :], settings.noise_std[model.outputs[i]] ** 2
        spread.append(ca.mtimes(h, ca.mtimes(covariance, h.T)) + noise)
        gain = seen[i] * ca.mtimes(covariance, h.T) / spread[-1]
        shift += gain * (error[i] - seen[i] * ca.mtimes(h, shift))
        keep = kind.eye(n) - ca.mtimes(gain, h)
        covariance = ca.mtimes(keep, ca.mtimes(covariance, keep.T)) + noise * ca.mtimes(gain, gain.T)
    new = ahead + shift
    q = ca.fmin(ca.fmax(new[nx:], ca.DM(scales.lower)), ca.DM(scales.upper)) if nq else new[nx:]
    covariance = (covariance + covariance.T) / 2
    results = [ca.vertcat(new[:nx], q), covariance, error, ca.vertcat(*spread)]
    return ca.Function("filter", [z, P, before, u, y, seen, dt], [ca.densify(r) for r in results])
