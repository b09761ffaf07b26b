"""Magic Formula 6.1 from tire-rig data: pure slip first, then combined slip, then moments, then all forces together.

References
----------
.. [1] H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed., 2012, sec. 4.3.2.
.. [2] J. van Oosten, E. Bakker, Determination of Magic Tyre Model parameters, Vehicle System Dynamics 21, 1992.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from slipangle.data.tire_data import TireData
from slipangle.errors import ExcitationError, IdentifiabilityWarning, ModelWarning, ParameterError, TooShortError
from slipangle.identify.tires.curve_data import limits_of, require_both_signs, varying
from slipangle.identify.tires.magic_formula_coefficients import COMBINED, LATERAL, LONGITUDINAL, MOMENTS, Free
from slipangle.identify.tires.shapes import SHAPE, alike, left_open, shaped
from slipangle.identify.tires.stages import (
    FittedStage,
    coefficients,
    criterion,
    expendable,
    noise,
    robust_covariance,
    scaled,
    undetermined,
    unscaled,
)
from slipangle.models.model import FitInfo
from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.magic_formula.validity import ValidRange
from slipangle.models.tires.simple import practical_slip
from slipangle.numerics.blas import one_blas_thread
from slipangle.numerics.multistart import Effort, Regression, draw, multistart

_ORDINARY = {"PCX1": 1.5, "PDX1": 1.2, "PKX1": 25.0, "PCY1": 1.4, "PDY1": 1.1, "PKY1": -25.0, "PKY2": 2.0}
_ORDINARY |= {"RCX1": 1.0, "RCY1": 1.0, "QCZ1": 1.1}  # coefficients of a tire, beside its size and pressure
_AGAIN = Effort(starts=1, screen=120, carried=1, polish=120, finish=120)  # from where it is
_SMALL_RATIO = 0.01  # slip ratio that counts as free rolling
_SMALL_ANGLE = np.deg2rad(0.6)  # slip angle that counts as straight


def typical(data: TireData, *, radius: float, nominal_load: float | None = None) -> MagicFormulaTire:
    """A tire to start from: nominal load, pressure and reference speed from the data, the rest of an ordinary tire.

    ``radius`` is the unloaded one, the length that moments are made dimensionless with [m]; ``nominal_load`` [N] is by
    default the median load.
    """
    pressure = 0.0 if data.pressure is None else float(np.median(data.pressure))
    size = {"FNOMIN": nominal_load or float(f"{np.median(data.load):.3g}"), "UNLOADED_RADIUS": radius}
    if data.speed is not None:
        size["LONGVL"] = float(f"{np.median(np.abs(data.speed)):.3g}")
    return MagicFormulaTire(coefficients=MF61Coefficients(**_ORDINARY, **size, NOMPRES=pressure, INFLPRES=pressure))


@dataclass(frozen=True, kw_only=True)
class MagicFormulaFit:
    """Fit of Magic Formula 6.1 to rig data by staged, then joint least squares.

    Coefficients that need a load, camber or pressure that did not vary stay those of ``start``; so does everything
    about a direction, combined slip or moment that the data do not hold.

    Shape and curvature factor come in twins: where a sweep ends soon after the peak, two pairs (C, E) give the same
    forces to within the noise. The one nearer to ``start`` is taken, its interval holds the others too, and a warning
    tells. Sweep to three times the slip of the peak when the coefficients themselves matter.

    Parameters
    ----------
    start : MagicFormulaTire
        Nominal load, radius, pressure, conventions and the coefficients that stay; `typical` makes one.
    effort : Effort
        For each of the pure-slip stages; later ones start from those.
    samples : int
        At most about so many samples are used, evenly spread.
    prune : bool
        Put coefficients back to their start that the data do not need, as Schwarz's criterion ([3]_) judges, and then
        those that they do not determine, where no residual grows by more than 1 %: fewer coefficients extrapolate
        better. Intervals of the others take those as given, and are narrower.

    References
    ----------
    .. [3] G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
    """

    start: MagicFormulaTire
    effort: Effort = field(default_factory=lambda: Effort(starts=8, screen=25, carried=3, polish=120, finish=150))
    samples: int = 6000
    seed: int = 0
    prune: bool = True

    def __post_init__(self) -> None:
        if self.start.coefficients.version != "6":
            raise ParameterError("the start tire is of version 5.2; expected version 6: take one from typical()")
        if self.start.axes != "ISO-W":
            raise ParameterError(f"the start tire is in {self.start.axes} axes; expected ISO-W, in which it is fitted")

    def fit(self, data: TireData) -> MagicFormulaTire:
        """The tire with fitted coefficients, limits of the data, and ``fit_info`` with every coefficient's interval.

        ``noise_std`` of the information holds F_x, F_y and, where measured, M_z and M_x.

        Raises ExcitationError if no slip moves, a sweep runs on one side of zero only, or a force is the same in all of
        it, and TooShortError if a stage has fewer samples than coefficients.

        A moment that some run contradicts, so that it is followed worse there than by its mean, keeps the coefficients
        of ``start``; so does one that is the same at every sample.

        Warns with ModelWarning, with what the data do not hold and is taken from ``start`` and which runs disagree with
        the fit, and IdentifiabilityWarning, with the coefficients that the data do not determine.
        """
        began = time.perf_counter()
        with one_blas_thread():
            job = _Job(self, data)
            tire = job.pure(self.start)
            tire, forces = job.joint(tire)
            tire, moments = job.moments(tire)
            info = job.info([forces, *moments])
        info = replace(info, seconds=time.perf_counter() - began)
        for note in job.notes:
            warnings.warn(note, ModelWarning, stacklevel=2)
        for note in info.warnings[len(job.notes) :]:
            warnings.warn(note, IdentifiabilityWarning, stacklevel=2)
        return replace(tire, limits=limits_of(job.data), fit_info=info, source=None)


Found = tuple[MagicFormulaTire, FittedStage]  # a tire and the last stage that made it


class _Job:
    """One fit: the data, what varies in them and what has been said."""

    def __init__(self, settings: MagicFormulaFit, data: TireData) -> None:
        self.settings = settings
        self.data = data.thinned(settings.samples)
        self.rng = np.random.default_rng(settings.seed)
        self.notes: list[str] = []
        self.shapes: dict[str, list[dict[str, float]]] = {}  # by force, coefficients that fit alike
        self.open: list[str] = []
        self.reach: dict[str, float] = {}  # of coefficients of shapes that fit alike
        d = self.data
        self.driving = np.abs(d.slip_ratio) > _SMALL_RATIO / 2
        self.straight = np.abs(d.slip_angle) < _SMALL_ANGLE
        self.rolling = np.abs(d.slip_ratio) < _SMALL_RATIO
        self.has_x = bool((self.driving & self.straight).sum() >= 30)
        self.has_y = bool((self.rolling & ~self.straight).sum() >= 30)
        self.has_both = bool((self.driving & ~self.straight).sum() >= 30)
        if not self.has_x and not self.has_y:
            raise ExcitationError(
                f"'{d.name}' holds neither 30 samples of pure longitudinal nor of pure lateral slip; expected a sweep "
                "of one with the other near zero: join such a run"
            )
        for name, swept in (("F_x", self.has_x), ("F_y", self.has_y)):
            if swept and np.ptp(getattr(d, name)) == 0:
                raise ExcitationError(
                    f"{name} of '{d.name}' is {getattr(d, name)[0]:g} N at every sample although its slip moves; "
                    "expected a force that was measured: leave that run out"
                )
        self.varies = varying(d, float(settings.start.coefficients.NOMPRES))
        reference = settings.start.coefficients
        kappa = practical_slip(np.minimum(d.slip_ratio, 0.99))
        pressure = np.full(d.n_samples, float(reference.INFLPRES)) if d.pressure is None else d.pressure
        self.samples = np.column_stack([kappa, -d.slip_angle, d.load, d.gamma, pressure])

    def free(self, table: tuple[Free, ...]) -> tuple[Free, ...]:
        """Coefficients of a table whose conditions vary."""
        return tuple(f for f in table if set(f.needs) <= set(self.varies))

    # ---- stages ------------------------------------------------------------------------------------------------

    def pure(self, tire: MagicFormulaTire) -> MagicFormulaTire:
        """Longitudinal and lateral slip, each alone."""
        if self.has_x:
            rows = self.straight & (self.driving if self.has_y else np.full(len(self.driving), True))
            require_both_signs(self.data.slip_ratio[rows], f"the slip ratio of '{self.data.name}'")
            tire = self.ordinary(*self.solve(tire, self.free(LONGITUDINAL), ("F_x",), rows, self.settings.effort))
        else:
            self.notes.append("the data hold no longitudinal sweep: F_x is that of the start tire")
        if self.has_y:
            require_both_signs(self.data.slip_angle[self.rolling], f"the slip angle of '{self.data.name}'")
            found = self.solve(tire, self.free(LATERAL), ("F_y",), self.rolling, self.settings.effort)
            tire = self.ordinary(*found)
        else:
            self.notes.append("the data hold no lateral sweep: F_y is that of the start tire")
        return tire

    def ordinary(self, tire: MagicFormulaTire, stage: FittedStage) -> MagicFormulaTire:
        """The tire with that of the shapes that fit alike which is nearest to the start tire's."""
        output = stage.outputs[0]
        self.shapes[output] = alike(stage, self.settings.start)
        return tire.with_coefficients(**self.shapes[output][0])

    def joint(self, tire: MagicFormulaTire) -> Found:
        """Combined slip, then all force coefficients on all samples."""
        free = (self.free(LONGITUDINAL) if self.has_x else ()) + (self.free(LATERAL) if self.has_y else ())
        outputs, rows = ("F_x",) * self.has_x + ("F_y",) * self.has_y, np.full(len(self.samples), True)
        if self.has_both and self.has_x and self.has_y:
            few = Effort(starts=6, screen=25, carried=2, polish=60, finish=60)
            tire = self.solve(tire, self.free(COMBINED), outputs, rows, few)[0]
            free += self.free(COMBINED)
        else:
            if self.has_x and self.has_y:
                self.notes.append("the data hold no combined slip: its coefficients are those of the start tire")
            rows = (self.straight & self.has_x) | (self.rolling & self.has_y)
        tire, _ = self.solve(tire, free, outputs, rows, _AGAIN)
        tire, stage = self.solve(tire, free, outputs, rows, _AGAIN)  # with each output weighed by its residuals
        tire, stage = self.settled(*self.pruned(tire, stage, rows), rows)
        self.notes += [said for output in outputs if (said := self.contradicted(tire, output))]
        for output, shapes in self.shapes.items():
            free = shaped(stage, output)
            if len(shapes) > 1 or len(free) > len(stage.free):
                starts = [tire.with_coefficients(**{name: s[name] for name in SHAPE[output]}) for s in shapes]
                trials = [self.solve(start, free, outputs, rows, _AGAIN)[1] for start in starts]
                said, reach = left_open(output, tire, stage, trials)
                self.open += [said] if said else []
                self.reach |= reach
        return tire, stage

    def moments(self, tire: MagicFormulaTire) -> tuple[MagicFormulaTire, list[FittedStage]]:
        """Aligning and overturning moment, the forces given."""
        stages = []
        few = replace(self.settings.effort, starts=self.settings.effort.starts + 2, screen=40)
        rows = np.full(len(self.samples), True)
        for output, tables in MOMENTS.items():
            measured = getattr(self.data, output)
            if measured is None or not self.has_y:
                continue
            if np.ptp(measured) == 0:
                self.notes.append(f"{output} is {measured[0]:g} N m at every sample: taken as not measured")
                continue
            fitted = [self.pruned(*self.solve(tire, self.free(table), (output,), rows, few), rows) for table in tables]
            found, stage = self.settled(*min(fitted, key=lambda pair: criterion(pair[1])), rows)
            if said := self.contradicted(found, output):
                self.notes.append(f"{said}; its coefficients stay those of the start tire")
                continue
            tire = found
            stages.append(stage)
        return tire, stages

    def pruned(self, tire: MagicFormulaTire, stage: FittedStage, rows: np.ndarray) -> Found:
        """The stage without coefficients that are not worth their place, fitted again."""
        reference = self.settings.start.coefficients

        def unworthy(stage: FittedStage) -> list[int]:
            return expendable(stage, np.array([scaled(f, getattr(reference, f.name)) for f in stage.free]))

        return self.without(tire, stage, rows, unworthy, lambda new, old: criterion(new) < criterion(old))

    def settled(self, tire: MagicFormulaTire, stage: FittedStage, rows: np.ndarray) -> Found:
        """The stage without coefficients that the data leave open, as far as no residual grows by more than 1 %."""

        def alike(new: FittedStage, old: FittedStage) -> bool:
            return all(a <= 1.01 * b for a, b in zip(noise(new), noise(old), strict=True))

        return self.without(tire, stage, rows, undetermined, alike)

    def without(
        self,
        tire: MagicFormulaTire,
        stage: FittedStage,
        rows: np.ndarray,
        named: Callable[[FittedStage], list[int]],
        accepted: Callable[[FittedStage, FittedStage], bool],
    ) -> Found:
        """The stage with named coefficients back at their start, or the first of them, as long as that is accepted."""
        reference = self.settings.start.coefficients
        while self.settings.prune and (order := named(stage)):
            for count in dict.fromkeys(max(1, round(share * len(order))) for share in (1.0, 0.5, 0.2)):
                back = {stage.free[k].name: getattr(reference, stage.free[k].name) for k in order[:count]}
                fewer = tuple(f for f in stage.free if f.name not in back)
                if not fewer:
                    continue
                found = self.solve(tire.with_coefficients(**back), fewer, stage.outputs, rows, _AGAIN)
                if accepted(found[1], stage):
                    tire, stage = found
                    break
            else:
                break
        return tire, stage

    def contradicted(self, tire: MagicFormulaTire, output: str) -> str:
        """Which run the tire follows worse than its mean would, as a sentence; empty where there is none."""
        measured, error = getattr(self.data, output), self._error(tire, output)
        counts = self.driving if output == "F_x" and self.has_y else np.full(len(error), True)
        spread = float(np.std(measured[counts])) if counts.any() else 0.0
        worst, number = 0.0, 0
        for k, rows in enumerate(self.data.runs):
            here = rows[counts[rows]]
            if len(here) >= 20 and len(self.data.runs) > 1:
                own = max(float(np.std(measured[here])), 0.5 * spread, 1e-9)
                miss = float(np.sqrt(np.mean(error[here] ** 2))) / own
                worst, number = max((worst, number), (miss, k + 1))
        if worst <= 1.0:
            return ""
        return (
            f"the fit of {output} misses run {number} of {len(self.data.runs)} by {worst:.2g} times its spread, worse "
            "than its mean: the runs disagree, remove their offsets or fit them apart"
        )

    def solve(
        self, tire: MagicFormulaTire, free: tuple[Free, ...], outputs: tuple[str, ...], rows: np.ndarray, effort: Effort
    ) -> Found:
        """One stage: the tire with the free coefficients that fit the outputs best on some rows."""
        n = int(rows.sum()) * len(outputs)
        if n <= len(free):
            raise TooShortError(
                f"{n} samples of {', '.join(outputs)} cannot determine {len(free)} coefficients; expected more samples"
            )
        problem = self._regression(tire, free, outputs, rows)
        low, high = np.full(len(free), -1.0), np.ones(len(free))
        now = np.array([scaled(f, getattr(tire.coefficients, f.name)) for f in free])
        box = np.array([[scaled(f, f.low), scaled(f, f.high)] for f in free])
        starts = np.vstack([now[None], draw(box[:, 0], box[:, 1], effort.starts - 1, self.rng, share=1.0)])
        stage = FittedStage(free, outputs, multistart(problem, low, high, np.clip(starts, -1, 1), effort), problem)
        return tire.with_coefficients(**coefficients(stage, stage.solution.theta)), stage

    def _regression(
        self, tire: MagicFormulaTire, free: tuple[Free, ...], outputs: tuple[str, ...], rows: np.ndarray
    ) -> Regression:
        x, z = ca.SX.sym("x", 5), ca.SX.sym("z", len(free))
        symbols: dict[str, Any] = {f.name: unscaled(f, z[k]) for k, f in enumerate(free)}
        camber: Any = x[3] if np.any(self.samples[:, 3] != 0) else 0.0
        loose = replace(tire, outside="extrapolate").with_coefficients(**symbols)
        forces = loose.evaluate(x[0], x[1], x[2], axes="ISO-W", camber=camber, pressure=x[4])
        y = ca.vertcat(*[getattr(forces, name) for name in outputs])
        samples = self.samples[rows]
        target = np.column_stack([getattr(self.data, name)[rows] for name in outputs])
        weight = np.column_stack([self._weight(tire, name, rows) for name in outputs])
        return Regression(y, x, z, samples=samples, target=target, weight=weight)

    def _weight(self, tire: MagicFormulaTire, name: str, rows: np.ndarray) -> np.ndarray:
        """One over the residual's standard deviation; free rolling says nothing about F_x."""
        error = self._error(tire, name)[rows]
        counts = self.driving[rows] if name == "F_x" and self.has_y else np.full(len(error), True)
        sigma = max(float(np.std(error[counts])), 1e-6 * float(np.std(getattr(self.data, name)[rows][counts])), 1e-9)
        return np.where(counts, 1.0 / sigma, 0.0)

    def _error(self, tire: MagicFormulaTire, name: str) -> np.ndarray:
        """What of an output the tire leaves, at every sample."""
        s = self.samples
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)
            loose = replace(tire, outside="extrapolate", limits=ValidRange())
            forces = loose.evaluate(s[:, 0], s[:, 1], s[:, 2], axes="ISO-W", camber=s[:, 3], pressure=s[:, 4])
        return getattr(self.data, name) - getattr(forces, name)

    # ---- what is reported --------------------------------------------------------------------------------------

    def info(self, stages: list[FittedStage]) -> FitInfo:
        """Estimates, covariance and warnings of all stages together."""
        names = tuple(f.name for stage in stages for f in stage.free)
        half = np.array([(f.upper - f.lower) / 2 for stage in stages for f in stage.free])
        values = np.concatenate([list(coefficients(s, s.solution.theta).values()) for s in stages])
        covariance = np.zeros((len(names), len(names)))
        at, sigmas, colours = 0, [], []
        for stage in stages:
            block, colour = robust_covariance(stage)
            covariance[at : at + len(block), at : at + len(block)] = block
            at += len(block)
            sigmas += noise(stage)
            colours.append(colour)
        covariance *= np.outer(half, half)
        ends = 1.96 * np.sqrt(np.maximum(np.diag(covariance), 0))
        wanted = np.maximum(ends, [self.reach.get(name, 0.0) for name in names])
        wider = np.divide(wanted, ends, out=np.ones(len(ends)), where=ends > 0)
        covariance, ends = covariance * np.outer(wider, wider), wanted
        metadata = self.settings.start.coefficients.metadata()
        vague = [n for n, v, e in zip(names, values, ends, strict=True) if not e <= max(abs(v), 1e-3)]
        edge = [f.name for s in stages for f, z in zip(s.free, s.solution.theta, strict=True) if abs(z) > 1 - 1e-4]
        said = [*self.notes, *self.open]
        if vague:
            said.append(
                f"the data do not determine {len(vague)} of {len(names)} coefficients ({', '.join(vague)}): their 95 % "
                "interval is wider than the value; expected narrower: sweep further, or leave them at their start"
            )
        if edge:
            said.append(
                f"at the edge of the usual range: {', '.join(edge)}; expected an optimum inside it: check the "
                "signs and units of the data"
            )
        if not all(s.solution.converged for s in stages):
            said.append("a stage stopped at its budget; expected convergence: raise effort")
        return FitInfo(
            names=names,
            values=values,
            covariance=covariance,
            noise_std=np.array(sigmas),
            n_samples=len(self.samples),
            units=tuple(metadata[n].unit for n in names),
            method=f"staged, then joint least squares of the forces; {colours[0]}",
            warnings=tuple(said),
            train_name=self.data.name,
        )
