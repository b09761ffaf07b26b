"""Train a network: stages that look one step, then several steps ahead; early stopping; several seeds.

What is trained is a `TrainingProblem`; how long and how far ahead, a sequence of `Stage`. The gradient steps themselves
are in `slipangle.identify.networks.adam`, which needs JAX and is imported when training starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from slipangle.errors import ParameterError, TooShortError
from slipangle.extras import extra
from slipangle.fields import Within
from slipangle.identify.networks.problem import Precision, Stage, TrainingProblem
from slipangle.models.model import Trial

Progress = Callable[[float, str], None]  # share done (0 to 1), what is being done
Holdout = Annotated[float, Within(0, 0.5, example="0.15")]  # share of the training data
IDLE = "training never improved on the random start"
CHECK_EVERY = 50  # epochs between two free runs on the held-out part, fewer in short stages


def require_jax(job: str) -> None:
    """Raise `ConfigError` with what to install unless JAX and Optax are there."""
    for module in ("jax", "optax"):
        extra(module, "neural", job)


@dataclass(frozen=True, kw_only=True)
class Trained:
    """The best parameters as NumPy arrays, every trial, and sentences about what went wrong."""

    params: Any
    trials: tuple[Trial, ...]
    warnings: tuple[str, ...]

    @property
    def best(self) -> Trial:
        """The trial whose parameters these are."""
        return min(self.trials, key=lambda trial: trial.score)


def train(
    problem: TrainingProblem,
    initial: Callable[[int], Any],
    arrays: Any,
    starts: Callable[[int], np.ndarray],
    *,
    stages: Sequence[Stage],
    seeds: Sequence[int],
    precision: Precision = "single",
    guarded: bool = False,
    idle: str = IDLE,
    progress: Progress | None = None,
) -> Trained:
    """Train from every seed; keep the parameters with the smallest free-run error on the held-out part.

    ``initial`` gives the start parameters of a seed, ``starts`` the rows at which windows of a horizon may begin. Each
    stage goes on from the best parameters so far. Where it is ``guarded``, a seed's start is only left for parameters
    whose free run over the training data is no worse than its own. JAX's global precision stays as it is. ``idle`` says
    that nothing improved.

    Raises ParameterError if there is no stage or no seed, and TooShortError if no experiment is long enough for a
    window.
    """
    if not stages or not seeds:
        raise ParameterError(f"{len(stages)} stages and {len(seeds)} seeds; expected at least one of each")
    from slipangle.identify.networks import adam

    windows = [np.asarray(starts(stage.horizon)) for stage in stages]
    for stage, rows in zip(stages, windows, strict=True):
        if not len(rows):
            raise TooShortError(
                f"no experiment is long enough for a window of {stage.horizon} steps after its lags; expected longer "
                "experiments: choose a smaller horizon or record without gaps"
            )
    trained: list[tuple[Trial, Any]] = []
    with adam.precision(precision):
        for i, seed in enumerate(seeds):
            run = _Run(problem, initial(seed), arrays, seed, guarded=guarded)
            for j, (stage, rows) in enumerate(zip(stages, windows, strict=True)):
                run.stage(stage, rows, lambda share, i=i, j=j: _tell(progress, (i, j, share), len(seeds), len(stages)))
            trained.append((run.trial(idle), adam.to_numpy(run.best)))
    trials = tuple(trial for trial, _ in trained)
    winner = min(range(len(trained)), key=lambda i: trials[i].score)
    notes = [f"seed {trial.seed}: {trial.note}" for trial in trials if trial.note]
    return Trained(params=trained[winner][1], trials=trials, warnings=tuple(notes))


def _tell(progress: Progress | None, at: tuple[int, int, float], seeds: int, stages: int) -> None:
    if progress is not None:
        i, j, share = at
        progress((i + (j + share) / stages) / seeds, f"training, seed {i + 1} of {seeds}, stage {j + 1} of {stages}")


class _Run:
    """One training run: knows the best parameters so far and how it got there."""

    def __init__(self, problem: TrainingProblem, start: Any, arrays: Any, seed: int, *, guarded: bool) -> None:
        from slipangle.identify.networks import adam

        self.adam, self.problem, self.seed = adam, problem, seed
        self.began = time.perf_counter()
        self.arrays = adam.to_device(arrays)
        self.best = adam.to_device(start)
        self.score = self._score(self.best)
        self.most = self._own(self.best) if guarded else None
        self.epoch = self.best_epoch = 0
        self.curve = [(0, self.score)]
        self.notes: list[str] = []

    def _score(self, params: Any) -> float:
        value = float(self.adam.score(self.problem, params, self.arrays))
        return value if np.isfinite(value) else np.inf

    def _own(self, params: Any) -> float:
        value = float(self.adam.own(self.problem, params, self.arrays))
        return value if np.isfinite(value) else np.inf

    def _astray(self, params: Any) -> bool:
        """Whether a free run over what it was trained on is worse than the start's: then luck made its score."""
        return self.most is not None and self._own(params) > self.most

    def stage(self, stage: Stage, rows: np.ndarray, told: Callable[[float], None]) -> None:
        """Train until the stage is over, nothing improves any more, or the loss is no number."""
        steps = self.adam.AdamSteps(self.problem, stage, self.best, self.arrays, rows, seed=(self.seed, self.epoch))
        began, improved = self.epoch, self.epoch
        every = min(CHECK_EVERY, max(1, stage.epochs // 40))
        while self.epoch - began < stage.epochs and self.epoch - improved < stage.patience:
            count = min(every, stage.epochs - (self.epoch - began))
            loss = steps.advance(count)
            self.epoch += count
            score = self._score(steps.params) if np.isfinite(loss) else np.inf
            if score < self.score and self._astray(steps.params):
                score = np.inf
            self.curve.append((self.epoch, score))
            if score < self.score:
                self.best, self.score = steps.snapshot(), score
                self.best_epoch = improved = self.epoch
            if not np.isfinite(loss):
                self.notes.append(
                    f"training diverged before epoch {self.epoch} (the loss at horizon {stage.horizon} is {loss}); the "
                    f"weights of epoch {self.best_epoch} are kept: lower the learning rate of {stage.learning_rate:g}"
                )
                break
            told((self.epoch - began) / stage.epochs)

    def trial(self, idle: str) -> Trial:
        if not np.isfinite(self.score):
            self.notes.append("no free run on the held-out part stayed finite")
        elif self.best_epoch == 0:
            self.notes.append(idle)
        return Trial(
            seed=self.seed,
            score=self.score,
            epoch=self.best_epoch,
            epochs=self.epoch,
            seconds=time.perf_counter() - self.began,
            curve=np.array(self.curve, dtype=float),
            note="; ".join(self.notes),
        )
