"""Whole tires from rig data: friction curves in both directions, or the parameters of any tire model.

Magic Formula 6.1 has a fit of its own, `slipangle.identify.tires.magic_formula.MagicFormulaFit`.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, TypeVar

import casadi as ca
import numpy as np

from slipangle.data.tire_data import TireData
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ParameterError, TooShortError
from slipangle.fields import Checked
from slipangle.identify.tires.curve_data import require_both_signs
from slipangle.identify.tires.curves import CurveFit, MLPCurveFit
from slipangle.models.model import FitInfo
from slipangle.models.parameters import ParameterSet
from slipangle.models.tires.neural import NeuralCurve, NeuralTire
from slipangle.models.tires.simple import MagicCurve, SimpleMagicFormula, Tire
from slipangle.numerics.multistart import Effort, Regression, covariance, draw, multistart

T = TypeVar("T", bound=Tire)
Output = Literal["F_x", "F_y", "M_x", "M_z"]
_STRAIGHT = np.deg2rad(0.6)
_ROLLING = 0.01


@dataclass(frozen=True, kw_only=True)
class CurveTireFit(Checked):
    """Tire of two friction curves, each fitted to the pure slip in its direction.

    Parameters
    ----------
    longitudinal, lateral : CurveFit, MagicCurve or NeuralCurve
        How to fit each curve, or a curve that is known already. Both give a Magic Formula, or both a network.
    inputs : tuple of {"load", "camber"}
        What the networks depend on besides slip. Magic Formula curves depend on slip alone.
    combined : {"none", "ellipse"}
        How the tire shares friction between the directions.
    samples : int
        At most about so many samples per curve.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, secs. 6.2.1, 6.3.1.
    """

    longitudinal: CurveFit | MagicCurve | NeuralCurve = field(default_factory=lambda: MLPCurveFit(hidden=(2, 2)))
    lateral: CurveFit | MagicCurve | NeuralCurve = field(default_factory=lambda: MLPCurveFit(hidden=(2, 2)))
    inputs: tuple[Literal["load", "camber"], ...] = ()
    combined: Literal["none", "ellipse"] = "none"
    samples: int = 3000

    def __post_init__(self) -> None:
        super().__post_init__()
        magic = [c.slip_alone for c in (self.longitudinal, self.lateral)]
        if magic[0] != magic[1]:
            raise ParameterError(
                "one direction is a Magic Formula, the other a network; expected both alike: choose the same kind"
            )
        if magic[0] and self.inputs:
            raise ParameterError(
                "Magic Formula curves depend on slip alone; expected inputs=(): take networks, or MagicFormulaFit for "
                "version 6.1"
            )

    def fit(self, data: TireData) -> NeuralTire | SimpleMagicFormula:
        """Tire whose curves carry their ``fit_info``.

        Raises ExcitationError if the data lack a pure sweep that a curve needs, or hold one side of zero only.
        """
        curves: list[Any] = []
        for name, given in (("longitudinal", self.longitudinal), ("lateral", self.lateral)):
            curves.append(self._curve(name, given, data) if isinstance(given, CurveFit) else given)
        return curves[0].tire(curves[1], self.combined)

    def _curve(self, name: str, fit: CurveFit, data: TireData) -> Any:
        along = name == "longitudinal"
        part = _pure(data, along=along).thinned(self.samples)
        slip, friction = (part.slip_ratio, part.mu_x) if along else (part.slip_angle, part.mu_y)
        extra: dict[str, np.ndarray] = {}
        if not fit.slip_alone:
            extra = {key: part.load if key == "load" else part.gamma for key in self.inputs}
        return fit.fit(slip, friction, **extra)


@dataclass(frozen=True, kw_only=True)
class TireFit(Checked, Generic[T]):
    """Parameters of a physical tire model from forces: linear, brush, Dugoff, or any other `ParameterSet` tire.

    Parameters
    ----------
    start : Tire
        The model with its start values; parameters that are not free stay.
    free : tuple of str
        Names of the parameters to estimate, between the bounds of the record.
    outputs : tuple of {"F_x", "F_y", "M_x", "M_z"}
        What is fitted; by default the forces of the directions in which the data move.
    slip_limit : float, optional
        Leave out larger slips, such as those beyond the linear range [slip ratio, or rad].
    effort : Effort
        Starts and evaluations; the first start is ``start``.
    """

    start: T
    free: tuple[str, ...]
    outputs: tuple[Output, ...] = ()
    slip_limit: float | None = None
    effort: Effort = field(default_factory=lambda: Effort(starts=8, carried=2))
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.start, Tire) or not isinstance(self.start, ParameterSet):
            raise ParameterError(
                f"the start tire is a {type(self.start).__name__}; expected a tire that is a parameter set, such as "
                "BrushTire: use CurveTireFit for curves and MagicFormulaFit for version 6.1"
            )
        if not self.free:
            raise ParameterError("no parameter is free; expected at least one name, such as free=('C_alpha',)")
        for name in self.free:
            self._record.si(name)

    @property
    def _record(self) -> Any:
        """The start as the parameter set that it is too."""
        return self.start

    def fit(self, data: TireData) -> T:
        """Tire with estimated parameters, covariance and warnings in ``fit_info``.

        Raises ExcitationError, TooShortError or ParameterError if the data cannot determine the parameters.

        Warns with IdentifiabilityWarning, with the parameters that the data do not determine.
        """
        began = time.perf_counter()
        part = data
        if self.slip_limit is not None:
            near = (np.abs(data.slip_ratio) < self.slip_limit) & (np.abs(data.slip_angle) < self.slip_limit)
            if near.sum() <= len(self.free):
                raise TooShortError(
                    f"{int(near.sum())} samples of '{data.name}' lie within a slip of {self.slip_limit:g}; expected "
                    f"more than the {len(self.free)} free parameters: raise slip_limit"
                )
            part = data.rows(near)
        outputs = self._outputs(part)
        problem, lower, upper = self._regression(part, outputs)
        now = np.array([float(getattr(self.start, n)) for n in self.free])
        # ranges span decades: starts are spread around the given one, by up to a factor of ten
        spread = draw(
            np.full(len(now), -1.0), np.ones(len(now)), self.effort.starts - 1, np.random.default_rng(self.seed)
        )
        starts = np.vstack([now / np.abs(now), 10.0 ** (2 * spread)]) if now.all() else np.vstack([0 * now, spread])
        solution = multistart(problem, lower, upper, np.clip(starts, lower, upper), self.effort)
        scale = _scale(now)
        values = solution.theta * scale
        spread_of = covariance(solution) * np.outer(scale, scale)
        info = FitInfo(
            names=self.free,
            values=values,
            covariance=spread_of,
            noise_std=np.sqrt(np.mean((solution.residual.reshape(-1, len(outputs)) / problem.weight) ** 2, axis=0)),
            n_samples=problem.n,
            units=tuple(self._record.si(n).unit for n in self.free),
            method=f"bounded least squares of {', '.join(outputs)} from {len(starts)} starts; covariance for white "
            "residuals",
            train_name=data.name,
            seconds=time.perf_counter() - began,
        )
        notes = _warnings(info, self.start)
        for note in notes:
            warnings.warn(note, IdentifiabilityWarning, stacklevel=2)
        estimates = dict(zip(self.free, map(float, values), strict=True))
        return replace(self._record.with_values(**estimates), fit_info=replace(info, warnings=notes))

    def _outputs(self, data: TireData) -> tuple[Output, ...]:
        names: tuple[Output, ...] = self.outputs
        if not names:
            moves_x, moves_y = np.ptp(data.slip_ratio) > 0.02, np.ptp(data.slip_angle) > np.deg2rad(1.0)
            names = (("F_x",) if moves_x else ()) + (("F_y",) if moves_y else ())  # type: ignore[assignment]
        if not names:
            raise ExcitationError(
                f"neither slip ratio nor slip angle of '{data.name}' moves; expected a sweep: join such a run"
            )
        for name in names:
            if getattr(data, name) is None:
                raise ParameterError(
                    f"'{data.name}' holds no {name}; expected outputs that were measured: leave it out"
                )
        if "F_y" in names:
            require_both_signs(data.slip_angle, f"the slip angle of '{data.name}'")
        if "F_x" in names:
            require_both_signs(data.slip_ratio, f"the slip ratio of '{data.name}'")
        return names

    def _regression(self, data: TireData, outputs: tuple[Output, ...]) -> tuple[Regression, np.ndarray, np.ndarray]:
        x, z = ca.SX.sym("x", 4), ca.SX.sym("z", len(self.free))
        scale = _scale(np.array([float(getattr(self.start, n)) for n in self.free]))
        symbols: dict[str, Any] = {n: z[k] * scale[k] for k, n in enumerate(self.free)}
        forces = self._record.with_values(**symbols).forces(x[0], x[1], x[2], camber=x[3])
        y = ca.vertcat(*[getattr(forces, name) for name in outputs])
        target = np.column_stack([getattr(data, name) for name in outputs])
        samples = np.column_stack([data.slip_ratio, data.slip_angle, data.load, data.gamma])
        weight = 1 / np.maximum(np.std(target, axis=0), 1e-9)
        metadata = [self._record.si(n) for n in self.free]
        lower, upper = (np.array([getattr(m, e) for m in metadata]) / scale for e in ("lower", "upper"))
        return Regression(y, x, z, samples=samples, target=target, weight=weight), lower, upper


def _scale(values: np.ndarray) -> np.ndarray:
    return np.where(values != 0, np.abs(values), 1.0)


def _pure(data: TireData, *, along: bool) -> TireData:
    """Samples of slip in one direction, the other near zero."""
    moving, still = (data.slip_ratio, np.abs(data.slip_angle) < _STRAIGHT)
    if not along:
        moving, still = data.slip_angle, np.abs(data.slip_ratio) < _ROLLING
    name, other = ("slip ratio", "slip angle") if along else ("slip angle", "slip ratio")
    if still.sum() < 20 or np.ptp(moving[still]) < (0.02 if along else np.deg2rad(1.0)):
        raise ExcitationError(
            f"'{data.name}' holds no sweep of {name} with the {other} near zero; expected one: join such a run, or "
            "give the curve of that direction"
        )
    require_both_signs(moving[still], f"the {name} of '{data.name}'")
    return data.rows(still)


def _warnings(info: FitInfo, start: Any) -> tuple[str, ...]:
    said = []
    for name, value, std in zip(info.names, info.values, info.std, strict=True):
        meta = start.si(name)
        if not 1.96 * std <= abs(value):
            said.append(
                f"the data do not determine {name}: {value:.4g} +- {1.96 * std:.2g} {meta.unit} (95 %); expected a "
                "narrower interval: fix it, or sweep the slip that moves it"
            )
        elif min(value - meta.lower, meta.upper - value) < 1e-6 * abs(value):
            said.append(
                f"{name} ends at its bound, {value:.4g} {meta.unit}; expected an interior optimum: check units and "
                "signs"
            )
    return tuple(said)
