"""Physics and a network on its state derivative, fitted together to the whole free run."""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import IdentifiabilityWarning, ModelWarning, ParameterError, SimulationError
from slipangle.fields import Count, NotNegative, Positive, Seed, Whole, Within
from slipangle.identify.excitation import require_identifiable
from slipangle.identify.judge.initial import restarted
from slipangle.identify.networks.joint_problem import JointProblem
from slipangle.identify.networks.training import Holdout, Progress, require_jax
from slipangle.identify.networks.unlike import proved
from slipangle.identify.physics.at_the_limit import FREE as OF_A_CAR
from slipangle.identify.physics.at_the_limit import KnownCar, require_channels
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.black_box.networks import Activation
from slipangle.models.provenance import provenance
from slipangle.models.vehicles.neural_bicycle import NeuralBicycle
from slipangle.models.vehicles.nonlinear_bicycle import NonlinearBicycle, NonlinearBicycleParams
from slipangle.models.wrappers.ensemble import EnsembleModel

FREE = (
    *("C_f", "C_r", "inertia_z", "mu_f", "mu_r", "steering_lag", "steering_offset", "bias_r", "l_f"),
    *("transfer_x", "friction_load", "stiffness_load", "E_f", "E_r", "brake_rear", "compliance"),
    *("transfer_f", "transfer_r"),
)
_WRONG = 0.7  # of its error, to which a start that nobody fitted has to come down by a fit


@dataclass(frozen=True, kw_only=True)
class Joint(KnownCar):
    """Levenberg-Marquardt on free runs of physics with a network inside: both move together.

    The network starts at zero correction, so every run starts at the fitted physics; ridge priors hold weights near
    zero and parameters near their start values. Channels named in ``also`` that the training data hold are fitted
    too, with a weight and an offset each: they steady the state and are no part of the model's output. What
    is fitted are free runs that start anew every ``restart`` seconds, ``settle`` seconds before, from a state thrown
    off at random: so the model learns to find its way back, where a car driven at the limit would spin without its
    driver. Its state is bounded to a little more than the training data show.

    ``Joint(mass=982, wheelbase=2.4, l_f=1.35).fit(data)`` is all it takes: the defaults are the settings that table 8.2
    is reproduced with. Data need delta, v_x, its derivative v_x_dot and r; v_y is fitted along where they have it.

    Parameters
    ----------
    start : NonlinearBicycle, optional
        The physics; by default fitted to the same data from mass, wheelbase and l_f (see `KnownCar.bicycle`). One that
        was not fitted is fitted to them first, where that takes three tenths off its error: what is ``free`` of the
        parameters that are fitted by default.
    free : tuple of str
        Parameters that move with the network.
    corrects : {"derivative", "tires"}
        What the network does: adds to the state derivative (`NeuralBicycle`), or moves the tire coefficients within
        bounds (`TireNetworkBicycle`).
    hidden : tuple of int
        Neurons of each hidden layer.
    activation : {"sigmoid", "tanh", "elu"}
        Of the neurons.
    weight_prior, parameter_prior : float
        Precision of the priors, per sample and per unit of scaled weight or relative parameter.
    also : tuple of str
        Of ``"v_y"`` and ``"a_y"``: measured channels that are fitted along.
    also_weight : float
        Weight of a channel fitted along; an output has 1. [-]
    restart : float, optional
        Length of each free run that is fitted; None for one over each experiment. [s]
    settle : float
        How long before its fitted part each run starts; the state is thrown off only where this is positive. [s]
    thrown_off : float
        How far, as a share of the largest v_y and r of the training data.
    max_iterations : int
        Steps at most.
    holdout : float
        Share at the end of the training data that only chooses the step to stop at; 0 works all steps on all data.
    seeds : tuple of int
        One run each.
    folds : int
        Parts of the training data on which each seed's network has to prove itself; 0 trusts it unseen, in half the
        time.
    worth : float
        Smallest relative reduction of the RMSE over all these parts. [-]

    Source: L. Ljung, System Identification, 2nd ed., 1999, sec. 10.2: Gauss-Newton with sensitivities.
    """

    start: NonlinearBicycle | None = None
    free: tuple[str, ...] = FREE
    corrects: Literal["derivative", "tires"] = "derivative"
    hidden: tuple[Count, ...] = (24,)
    activation: Activation = "tanh"
    weight_prior: Positive = 1e-5
    parameter_prior: Positive = 1e-4
    also: tuple[Literal["v_y", "a_y"], ...] = ("v_y",)
    also_weight: float = 0.15
    restart: Positive | None = 5.0
    settle: NotNegative = 1.0
    thrown_off: NotNegative = 1.0
    max_iterations: Count = 80
    holdout: Holdout = 0.0
    seeds: tuple[Seed, ...] = (0,)
    folds: Whole = 1
    worth: Annotated[float, Within(0, 1, open="high", example="0.02")] = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_known(self.start, "start")
        for name in self.free:
            NonlinearBicycleParams.si(name)
        if not (self.hidden and self.seeds):
            raise ParameterError(
                f"hidden is {self.hidden} and seeds {self.seeds}; expected at least one hidden layer and one seed"
            )

    def fit(self, data: Dataset, *, progress: Progress | None = None) -> NeuralBicycle:
        """The model of the seed with the smallest error (on the held-out part, if there is one).

        Of those whose network is on, if there are any.
        """
        return min(_on(self.fit_all(data, progress=progress)), key=_score)

    def fit_ensemble(self, data: Dataset, *, progress: Progress | None = None) -> EnsembleModel:
        """The models of all seeds whose network is on as one; the physics alone if there is none."""
        models = self.fit_all(data, progress=progress)
        infos = [m.fit_info for m in models if m.fit_info is not None]
        shown: Any = _on(models)[0].fit_info
        info = replace(
            shown,
            seconds=sum(i.seconds for i in infos),
            trials=tuple(t for i in infos for t in i.trials),
            warnings=tuple(dict.fromkeys(said for i in infos for said in i.warnings)),
        )
        return EnsembleModel(members=_on(models), fit_info=info)

    def fit_all(self, data: Dataset, *, progress: Progress | None = None) -> tuple[NeuralBicycle, ...]:
        """One model per seed.

        Raises MissingColumnError, ExcitationError or TooShortError if the data cannot identify the physics.

        Warns with ModelWarning if a run never improved on the physics it started from.
        """
        require_dataset(data, "fit() got")
        require_jax("fitting physics with a network")
        began = time.perf_counter()
        start = self.start
        if start is None:
            start = self.bicycle(data)
        else:
            require_channels(data)
            start = start if start.fit_info is not None else self._fitted(start, data)
        names = tuple(n for n in self.also if n in data and n not in start.outputs)
        chosen = data.select(inputs=start.inputs, outputs=(*start.outputs, *names))
        start.check(chosen)
        require_identifiable(chosen, len(self.free), scheduling=("v_x", "v_x_dot"))
        from slipangle.identify.networks import adam

        models, told = [], _Told(progress, len(self.seeds) * (1 + self.folds))
        with adam.precision("double"):
            judged = self._judged(start, chosen, np.column_stack([data["v_x"], data["v_x"] * data["r"]]), told)
            problem = None
            for seed, alone in zip(self.seeds, judged, strict=True):
                spent, told.what = time.perf_counter() - began, f"seed {seed}"
                if alone is None:
                    problem = self._problem(start, chosen) if problem is None else problem
                    models.append(problem.run(seed, data, spent, told))
                else:
                    info: Any = alone.fit_info
                    models.append(replace(alone, fit_info=replace(info, seconds=spent, **provenance(data))))
                told.part += 1
                began = time.perf_counter()
        return tuple(models)

    def _fitted(self, start: NonlinearBicycle, data: Dataset) -> NonlinearBicycle:
        """Physics that nobody fitted, with those of its parameters that are free fitted, where they are plainly wrong.

        A network that is judged beside wrong parameters is either better for that, or they come back as the better.
        Where less is gained, parameters that are right would only follow what the network is there for.
        """
        free = tuple(name for name in OF_A_CAR if name in self.free)
        if not free or self.corrects == "tires":  # whose coefficients the network is to find
            return start
        with warnings.catch_warnings(action="ignore", category=IdentifiabilityWarning):
            fitted = GreyBox(start=start, free=free).fit(data.select(inputs=start.inputs, outputs=start.outputs))
        size = np.std(data.columns(start.outputs), axis=0)
        now, then = (float(np.sqrt(np.mean((_errors(model, data) / size) ** 2))) for model in (start, fitted))
        return fitted if then < _WRONG * now else start

    def _problem(self, start: NonlinearBicycle, data: Dataset) -> JointProblem:
        """What is solved over data."""
        inner, held = (data, None) if self.holdout == 0 else data.split(1 - self.holdout)
        if self.restart is not None:
            inner = restarted(inner, self.restart, start.memory + self._lead(data))
        return JointProblem(self, start, inner, held, lead=0 if self.restart is None else self._lead(data))

    def _lead(self, data: Dataset) -> int:
        """Samples after which a run counts."""
        return round(self.settle / data.dt)

    # ---- whether the network helps -------------------------------------------------------------------------------

    def _judged(
        self, start: NonlinearBicycle, data: Dataset, signals: np.ndarray, told: _Told
    ) -> list[NeuralBicycle | None]:
        """For each seed, the physics alone where its network does not prove itself."""
        if not self.folds:
            return [None for _ in self.seeds]
        size, problems = np.std(data.columns(start.outputs), axis=0), []
        shortest = start.memory + self._lead(data) + round((self.restart or 0.0) / data.dt)

        def judged(seed: int) -> NeuralBicycle | None:
            tried: list[NeuralBicycle] = []

            def errors(seen: Dataset, unseen: Dataset) -> tuple[np.ndarray, np.ndarray]:
                if len(tried) == len(problems):  # compiled once for all seeds
                    problems.append(self._problem(start, seen))
                told.what = f"seed {seed}, without what it is judged on"
                tried.append(problems[len(tried)].run(seed, seen, 0.0, told))
                told.part += 1
                before, after = (_errors(model, unseen) / size for model in (start, tried[-1]))
                return before, after

            doubt = proved(data, signals, shortest, self.folds, errors).doubt(self.worth)
            if not doubt:
                return None
            return problems[0].alone(tried[0], f"the network is off: {doubt}: the physics is better alone")

        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)  # of models that are not given back
            return [judged(seed) for seed in self.seeds]


def _errors(model: NonlinearBicycle, data: Dataset) -> np.ndarray:
    """Of the free run over data, shape (n, n_outputs); infinite where it leaves the finite numbers."""
    try:
        run = model.simulate(data)
    except SimulationError:
        return np.full((1, len(model.outputs)), np.inf)
    return run.error[run.predicted]


def _on(models: Sequence[NeuralBicycle]) -> tuple[NeuralBicycle, ...]:
    """Those whose network is on; one of the others if there is none."""
    return tuple(m for m in models if np.any(m.network.parameters)) or tuple(models[:1])


def _score(model: NeuralBicycle) -> float:
    return model.fit_info.trials[0].score if model.fit_info else np.inf


@dataclass
class _Told:
    """Progress over parts of equal length: which one, of how many, and what it does."""

    progress: Progress | None
    parts: int
    part: int = 0
    what: str = ""

    def __call__(self, share: float, error: float) -> None:
        if self.progress is not None:
            self.progress((self.part + share) / self.parts, f"joint fit, {self.what}, relative error {error:.4f}")
