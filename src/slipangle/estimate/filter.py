"""One step of an extended Kalman filter over states, parameters and sensor offsets, as a CasADi function."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen.derivatives import jacobians
from slipangle.codegen.expression import scalar_code
from slipangle.errors import ParameterError
from slipangle.models.model import FitInfo, Model
from slipangle.models.ode import OdeModel, Parametrised
from slipangle.models.repeated import Repeated, S, followed, repeated
from slipangle.numerics.integrate import discretise

_ASKED = 5_000  # instructions of all steps, beyond which it takes too long to ask whether written out they are fewer


def parametrised(model: Model) -> Any:
    """The part of a model whose named parameters can be varied: itself, or what is on the ground.

    Raises ParameterError if it has none.
    """
    inner = model.off_ground
    if not isinstance(inner, Parametrised):
        raise ParameterError(
            f"a {type(inner).__name__} has no named parameters to estimate; expected a model from an ODE: leave free "
            "empty for its states alone"
        )
    return inner


def varied(model: Any, values: dict[str, Any]) -> Any:
    """The model with some parameters replaced, numbers or symbols."""
    if not values:
        return model
    if isinstance(model, Parametrised):
        return model.with_values(**values)
    return replace(model, model=varied(model.model, values))


def fitted(model: Any, info: FitInfo) -> Any:
    """The model with how it was fitted, which belongs to the part that has parameters; as it is without one."""
    if isinstance(model, Parametrised):
        return replace(model, fit_info=info)  # type: ignore[type-var]
    return model if model.off_ground is model else replace(model, model=fitted(model.off_ground, info))


def _exp(v: Any) -> float:
    """As the C library has it, to the last bit; infinite where it overflows."""
    return math.exp(v) if v < 709.0 else math.inf


class Scales:
    """Between parameters p and what the filter estimates: ``log(p / p0)`` of positive ones, ``p - p0`` of others."""

    def __init__(self, settings: Any) -> None:
        inner = parametrised(settings.start) if settings.free else None
        metadata = [] if inner is None else [inner.si(name) for name in settings.free]
        self.start = np.array([] if inner is None else [float(inner.value(name)) for name in settings.free])
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
        exp = ca.exp if isinstance(q, (ca.SX, ca.MX)) else _exp
        pairs = zip(self.start, self.positive, strict=True)
        return [p * exp(q[i]) if positive else p + q[i] for i, (p, positive) in enumerate(pairs)]

    def slopes(self, q: np.ndarray) -> np.ndarray:
        """Derivative of each parameter by its q."""
        return np.where(self.positive, self.values(q), 1.0)


def moving(model: Model, free: tuple[str, ...], scales: Scales) -> tuple[Any, Any, Any]:
    """Kind of symbols, ``step(x, q, u)`` and ``output(x, q, u)``."""
    if not free:
        step, output, _ = model.functions
        kind = ca.SX if step.is_a("SXFunction") and output.is_a("SXFunction") else ca.MX
        return kind, lambda x, q, u: step(x, u), lambda x, q, u: output(x, u)

    def at(q: Any) -> Any:
        return varied(model, dict(zip(free, scales.values(q), strict=True)))

    nu = model.n_inputs
    kind = ca.MX if getattr(parametrised(model).ode, "method", "") == "radau" else ca.SX
    if not isinstance(model, OdeModel) or model.own_step:
        return kind, lambda x, q, u: at(q).step(x, u), lambda x, q, u: at(q).output(x, u)
    plain = discretise(
        lambda x, drive: at(drive[nu:]).derivative(x, drive[:nu]),
        model.dt,
        n_states=model.n_states,
        n_inputs=nu + len(free),
        method=model.method,
        substeps=model.substeps,
    )
    return kind, lambda x, q, u: plain(x, ca.vertcat(u, q)), lambda x, q, u: at(q).output(x, u)


def repeated_steps(settings: Any, scales: Scales, *, derivatives: bool = True) -> Repeated | None:
    """``(z, u) -> z later``, and its derivative by z, of whose steps one is repeated; None where none can be."""
    model, free = settings.start, settings.free
    kind, _, _ = moving(model, free, scales)
    if kind is not ca.SX:
        return None
    x, q, u = given = _symbols(settings, kind)
    at = varied(model, dict(zip(free, scales.values(q), strict=True)))
    steps = repeated(at, x, u, given=given, by=[x, q] if derivatives else [], parameters=q)
    return None if steps is None else _with_others(steps, settings, kind)


def moved(settings: Any, scales: Scales) -> Repeated | ca.Function:
    """``(z, u) -> z later`` and its derivative by z; z as that of `filter_step`."""
    steps = repeated_steps(settings, scales)
    if steps is not None and steps.apart > _ASKED:
        return steps
    kind, step, _ = moving(settings.start, settings.free, scales)
    x, q, u = given = _symbols(settings, kind)
    later = step(x, q, u)
    written_out = ca.Function("later", given, [later, *jacobians([later], [x, q])])
    whole = _with_others(written_out, settings, kind)
    return steps if steps is not None and steps.shorter(scalar_code(whole)) else whole


def _symbols(settings: Any, kind: Any) -> list[Any]:
    """Of the states, of what stands for the parameters, and of the inputs."""
    sizes = settings.start.n_states, len(settings.free), settings.start.n_inputs
    return [kind.sym(name, size) for name, size in zip("xqu", sizes, strict=True)]


def _with_others(step: S, settings: Any, kind: Any) -> S:
    """A step of x and q, with derivatives by both if it has some, as one of z: what is not x stays."""
    nx, nq, others = settings.start.n_states, len(settings.free), len(settings.bias_std)
    z, u = kind.sym("z", nx + nq + others), kind.sym("u", settings.start.n_inputs)

    # z[nx:] of a single number is a row without columns, which vertcat makes a zero of; z[nx:, 0] is no row
    def joined(later: Any, *by: Any) -> list[Any]:
        same = ca.horzcat(kind(nq + others, nx), kind.eye(nq + others))
        return [ca.vertcat(later, z[nx:, 0]), *([ca.vertcat(ca.horzcat(*by, kind(nx, others)), same)] if by else [])]

    return followed(step, [z, u], [z[:nx, 0], z[nx : nx + nq, 0], u], joined)


def told(settings: Any, scales: Scales) -> ca.Function:
    """``(z, u) -> outputs``, with the sensors' offsets, and their derivative by z."""
    model, nq, biased = settings.start, len(settings.free), tuple(settings.bias_std)
    nx = model.n_states
    kind, _, output = moving(model, settings.free, scales)
    z, u = kind.sym("z", nx + nq + len(biased)), kind.sym("u", model.n_inputs)
    offsets = [z[nx + nq + biased.index(name)] if name in biased else 0.0 for name in model.outputs]
    y = output(z[:nx, 0], z[nx : nx + nq, 0], u) + ca.vertcat(*offsets)
    return ca.Function("told", [z, u], [ca.densify(y), *jacobians([y], [z])])


def _symmetric(matrix: Any) -> Any:
    """The matrix by its lower half; the other is not computed."""
    return ca.tril2symm(ca.tril(matrix))


def filter_step(settings: Any, scales: Scales) -> Repeated | ca.Function:
    """``(z, P, u before, u, y, seen, gate, dt) -> (z, P, error, its variance, taken)``.

    z are the states, what stands for the parameters, and the sensors' offsets. dt = 0 leaves out the prediction. The
    covariance is corrected one output at a time in Joseph's form, so it stays positive; an output whose squared error
    is more than ``gate`` times its variance by then is not taken in.
    """
    model, nq = settings.start, len(settings.free)
    nx, nu, ny = model.n_states, model.n_inputs, model.n_outputs
    n = nx + nq + len(settings.bias_std)
    step, look = moved(settings, scales), told(settings, scales)
    kind, _, _ = moving(model, settings.free, scales)
    sizes = {"before": nu, "u": nu, "y": ny, "seen": ny, "gate": ny, "dt": 1}
    z, P = kind.sym("z", n), kind.sym("P", n, n)
    before, u, y, seen, gate, dt = (kind.sym(name, size) for name, size in sizes.items())
    wander = [settings.process_std.get(name, 0.0) for name in model.states]
    wander += [settings.walk_std.get(name, 0.0) for name in settings.free]
    wander += [settings.bias_walk.get(name, 0.0) for name in settings.bias_std]
    Q = ca.diag(ca.DM([v**2 for v in wander]))

    def corrected(later: Any, F: Any) -> list[Any]:
        ahead = ca.if_else(dt == 0, z, later)
        covariance = ca.if_else(dt == 0, P, _symmetric(ca.mtimes(F, ca.mtimes(P, F.T)) + Q * dt))
        expected, H = look(ahead, u)
        error, shift, spread, taken = seen * (y - expected), kind.zeros(n), [], []
        for i in range(ny):
            h, noise = H[i, :], settings.noise(model.outputs[i]) ** 2
            spread.append(ca.mtimes(h, ca.mtimes(covariance, h.T)) + noise)
            left = error[i] - seen[i] * ca.mtimes(h, shift)
            taken.append(ca.if_else(left**2 <= gate[i] * spread[-1], seen[i], 0.0))
            gain = taken[-1] * ca.mtimes(covariance, h.T) / spread[-1]
            shift += gain * left
            keep = kind.eye(n) - ca.mtimes(gain, h)
            covariance = _symmetric(ca.mtimes(keep, ca.mtimes(covariance, keep.T)) + noise * ca.mtimes(gain, gain.T))
        new = ahead + shift
        q = new[nx : nx + nq, 0]
        q = ca.fmin(ca.fmax(q, ca.DM(scales.lower)), ca.DM(scales.upper)) if nq else q
        new = ca.vertcat(new[:nx, 0], q, new[nx + nq :, 0])
        return [ca.densify(r) for r in (new, covariance, error, ca.vertcat(*spread), ca.vertcat(*taken))]

    return followed(step, [z, P, before, u, y, seen, gate, dt], [z, before], corrected)
