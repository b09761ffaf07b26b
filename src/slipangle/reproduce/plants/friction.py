"""A learned friction curve on top of the physics of a drive, from its free run."""

import time
import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from slipangle import Dataset, FitInfo
from slipangle.errors import IdentifiabilityWarning, ParameterError
from slipangle.fields import Checked, Count, Positive
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.physics.free_run import FreeRun
from slipangle.models.provenance import provenance
from slipangle.numerics.blas import one_blas_thread
from slipangle.numerics.integrate import discretise
from slipangle.reproduce.plants.emps import Emps, FrictionCurve, carriage, smooth_steps


@dataclass(frozen=True, kw_only=True)
class FrictionFit(Checked):
    """Inertia, friction and a smooth curve over the speed, all from the error of one long free run.

    The curve is a sum of smooth steps at evenly spaced speeds, with a normal prior on their heights: with a small
    ``weight_std`` little is left of it. Nothing is random.

    Source: L. C. Sousa, PhD thesis, PUC-Rio, 2023, appendix A.4: the drive.

    Parameters
    ----------
    start, free
        Start values, whose outputs are fitted; physical parameters to estimate along with the curve.
    spacing, v_max : float
        Distance of the steps, whose width is half of it, and largest speed with one, both ways. [m/s]
    weight_std : float
        Standard deviation of the steps' heights before anything is measured. [N]
    error : tuple of float
        Typical free-run error of each output, in its unit.
    correlation_time : float
        Time after which free-run errors are taken as independent; sets how much the data weigh against the prior. [s]
    max_iterations : int
        Limit on steps.
    """

    start: Emps
    free: tuple[str, ...] = ("mass", "viscous", "coulomb", "offset")
    spacing: Positive = 0.014
    v_max: Positive = 0.15
    weight_std: Positive = 10.0
    error: tuple[float, ...] = (1e-3,)
    correlation_time: Positive = 0.25
    max_iterations: Count = 40

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.free:
            self.start.params.si(name)
        if len(self.error) != self.start.n_outputs:
            raise ParameterError(
                f"{len(self.error)} typical errors for the outputs {', '.join(self.start.outputs)}; expected one each"
            )

    @property
    def centres(self) -> np.ndarray:
        """Speeds of the steps, none at zero, where Coulomb's is. [m/s]"""
        positive = np.arange(self.spacing, self.v_max + 1e-12, self.spacing)
        return np.concatenate([-positive[::-1], positive])

    def fit(self, data: Dataset) -> Emps:
        """The model with estimated parameters and its `FrictionCurve`.

        Warns
        -----
        IdentifiabilityWarning
            If the fit stopped at its limit of steps.
        """
        began = time.perf_counter()
        self.start.check(data)
        chosen = data.select(inputs=self.start.inputs, outputs=self.start.outputs)
        centres = self.centres
        require_identifiable(chosen, len(self.free) + len(centres))
        values = np.array([float(getattr(self.start.params, name)) for name in self.free])
        known = 1e3 * np.maximum(np.abs(values), 1.0)  # as good as no prior
        mean = np.concatenate([values, np.zeros(len(centres))])
        std = np.concatenate([known, np.full(len(centres), self.weight_std)])
        with one_blas_thread():
            problem = FreeRun(
                self._step(centres),
                lambda x, u, p: self.start.output(x, u),
                n_states=2,
                n_parameters=len(mean),
                records=[(part.u, part.y) for part in chosen.experiments],
                error=np.array(self.error) * np.sqrt(self.correlation_time / data.dt),
                prior=(mean, std),
            )
            x0 = [self.start.initial_state(part.head(1)) for part in chosen.experiments]
            optimum = problem.fit(mean, np.array(x0), max_iterations=self.max_iterations)
        notes: tuple[str, ...] = ()
        if not optimum.converged:
            notes = (
                f"the fit stopped at its limit of {self.max_iterations} steps; expected convergence: raise "
                "max_iterations",
            )
            warnings.warn(notes[0], IdentifiabilityWarning, stacklevel=2)
        k = len(self.free)
        info = FitInfo(
            names=(*self.free, *(f"weight at {1e3 * c:.0f} mm/s" for c in centres)),
            values=optimum.p,
            covariance=optimum.covariance,
            noise_std=optimum.rmse,
            n_samples=data.n_samples,
            units=(*(self.start.params.si(n).unit for n in self.free), *("N" for _ in centres)),
            seconds=time.perf_counter() - began,
            method=f"free-run error, Levenberg-Marquardt with forward sensitivities, heights of the steps N(0, "
            f"{self.weight_std:g} N) beforehand; covariance for errors independent after {self.correlation_time:g} s",
            warnings=notes,
            **provenance(data),
        )
        return replace(
            self.start,
            params=self.start.params.with_values(**dict(zip(self.free, map(float, optimum.p[:k]), strict=True))),
            friction=FrictionCurve(centres=centres, width=self.spacing / 2, weights=optimum.p[k:]),
            fit_info=info,
        )

    def _step(self, centres: np.ndarray) -> Any:
        k = len(self.free)

        def step(x: Any, u: Any, p: Any) -> Any:
            named = {name: p[i] for i, name in enumerate(self.free)}
            params = self.start.params.with_values(**named)

            def derivative(x: Any, u: Any) -> Any:
                return carriage(x[1], u[0], params, smooth_steps(x[1], centres, self.spacing / 2, p[k:]))

            start = self.start
            return discretise(
                derivative, start.dt, n_states=2, n_inputs=1, method=start.method, substeps=start.substeps
            )(x, u)

        return step
