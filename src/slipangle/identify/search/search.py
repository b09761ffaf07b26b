"""Search for lags, layers, neurons and other settings, on local processes or a Ray cluster.

Every trial draws its settings from a sampler that knows all trials of finished rounds, and is kept in a journal on
disk: a study that was killed, on either side, goes on where it stopped, and a trial that failed stays with its
reason. The sampler, pruner and journal are Optuna's; it and Ray are extras (``pip install "slipangle[cluster]"``).
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from slipangle.errors import ConfigError, ParameterError
from slipangle.extras import extra
from slipangle.fields import Checked, Count, Seed
from slipangle.identify.networks.training import Progress
from slipangle.identify.search.pool import PRUNED, Cluster, Local, Objective, Task, Value
from slipangle.shown import Shown


@dataclass(frozen=True, kw_only=True)
class Range:
    """Numbers from ``low`` to ``high``, both included.

    Raises ParameterError if the ends are not in order, or not positive on a logarithmic scale.
    """

    low: int | float  # whole ends give whole numbers
    high: int | float
    log: bool = False  # draw evenly on a logarithmic scale

    def __post_init__(self) -> None:
        if not self.low < self.high or (self.log and self.low <= 0):
            raise ParameterError(
                f"the range is {self.low} to {self.high}{' on a logarithmic scale' if self.log else ''}; expected "
                "rising ends, positive ones for a logarithmic scale"
            )


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One of several values."""

    values: tuple[Value, ...]

    def __post_init__(self) -> None:
        if not self.values:
            raise ParameterError("the choice has no value; expected at least one")


@dataclass(frozen=True, kw_only=True)
class TrialResult:
    """One trial of a search."""

    number: int  # in the order of drawing; also the trial's seed, on top of the study's
    settings: dict[str, Value]
    score: float  # value of the objective; infinite if the trial failed
    seconds: float  # how long it took [s]
    failure: str = ""  # why it has no score
    steps: tuple[float, ...] = ()  # what the objective reported on the way

    @property
    def pruned(self) -> bool:
        """Whether it was given up because earlier trials had been better at the same step."""
        return self.failure.startswith(PRUNED)


@dataclass(frozen=True, kw_only=True)
class SearchResult(Shown):
    """Every trial of a study, in the order of drawing."""

    trials: tuple[TrialResult, ...]

    def _words(self) -> str:
        broken = f", {len(self.failed)} failed" if self.failed else ""
        return f"{len(self.trials)} trials, the best score {self.best.score:.4g}{broken}"

    @property
    def best(self) -> TrialResult:
        """The trial with the smallest score.

        Raises ParameterError if no trial succeeded; the first reason is given.
        """
        good = [trial for trial in self.trials if not trial.failure]
        if not good:
            why = self.trials[0].failure if self.trials else "there is none"
            raise ParameterError(f"no trial succeeded ({why}); expected at least one: widen the space or run more")
        return min(good, key=lambda trial: (trial.score, trial.number))

    @property
    def failed(self) -> tuple[TrialResult, ...]:
        """Trials that broke, with their reasons; pruned ones did not."""
        return tuple(trial for trial in self.trials if trial.failure and not trial.pruned)

    @property
    def pruned(self) -> tuple[TrialResult, ...]:
        """Trials that were given up on the way."""
        return tuple(trial for trial in self.trials if trial.pruned)


@dataclass(frozen=True, kw_only=True)
class Search(Checked):
    """A study: what is searched, how long, where it is kept, who computes.

    Trials are drawn in rounds of ``round_size``, so what is drawn depends on the seed and on finished rounds alone:
    any number of workers, here or on a cluster, gives the same trials and the same best score.

    Parameters
    ----------
    trials : int
        How many, those of an interrupted study included.
    journal : str or Path, optional
        File that keeps the study; an existing one is continued. By default nothing is kept.
    seed : int
        Of the sampler; trial ``i`` gets the seed ``seed + i``.
    workers : int
        Processes of the local pool.
    cluster : str, optional
        Address of a Ray cluster, such as ``"auto"`` or ``"10.0.0.5:6379"``; by default the local pool.
    round_size : int
        Trials drawn at once, before their results are known.
    sampler : {"tpe", "random"}
        How settings are drawn.
    pruner : {"median", "none"}
        Whether a trial is given up when what it reports is worse than the median of finished rounds at that step.
    """

    space: Mapping[str, Range | Choice]
    trials: Count = 32
    journal: str | Path | None = None
    seed: Seed = 0
    workers: Count = 2
    cluster: str | None = None
    round_size: Count = 8
    sampler: Literal["tpe", "random"] = "tpe"
    pruner: Literal["median", "none"] = "median"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.space:
            raise ParameterError("the search space is empty; expected at least one setting, such as na=Range(...)")

    def run(
        self,
        objective: Objective,
        *,
        progress: Progress | None = None,
        watch: Callable[[SearchResult], None] | None = None,
    ) -> SearchResult:
        """Work through the trials that are missing.

        Raises ConfigError if Optuna, or Ray for a cluster, is not installed, or the journal holds another search.

        Parameters
        ----------
        objective : callable
            From settings, a seed and ``report(value)`` to a score, smaller being better; at module level, so that
            other processes can import it. What it raises becomes the trial's reason. Where it has a ``signature``, a
            journal of another one is refused. ``report`` takes what is known of
            the score on the way, and ends the trial where that is not worth going on.
        progress : callable, optional
            Told the share done and the best so far.
        watch : callable, optional
            Told all trials so far, after each.
        """
        optuna = extra("optuna", "cluster", "searching")
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = self._study(optuna, getattr(objective, "signature", ""))
        if len(self._told(study)) >= self.trials:  # all kept: no process is needed
            return SearchResult(trials=tuple(self._told(study)[: self.trials]))
        pool: Any = Cluster(self.cluster) if self.cluster else Local(self.workers)
        try:
            while (first := len(self._told(study))) < self.trials:
                self._round(optuna, study, pool, objective, first, progress, watch)
        finally:
            pool.close()
        return SearchResult(trials=tuple(self._told(study)[: self.trials]))

    # ---- the study ---------------------------------------------------------------------------------------------

    def _study(self, optuna: Any, scored: str) -> Any:
        storage = None
        if self.journal is not None:
            journal = importlib.import_module("optuna.storages.journal")
            path = Path(self.journal)
            lock = journal.JournalFileOpenLock(str(path))
            backend = journal.JournalFileBackend(str(path), lock_obj=lock)
            storage = optuna.storages.JournalStorage(backend)
        study = optuna.create_study(study_name="slipangle", storage=storage, direction="minimize", load_if_exists=True)
        space = sorted((k, repr(v)) for k, v in self.space.items())
        signature = repr((space, self.seed, self.round_size, self.sampler, self.pruner, scored))
        kept = study.user_attrs.get("search")
        if kept is None:
            study.set_user_attr("search", signature)
        elif kept != signature:
            raise ConfigError(
                f"'{self.journal}' keeps another search (log, training, space, seed, round size, sampler or pruner "
                "differ); expected the same: name another journal"
            )
        return study

    def _round(
        self,
        optuna: Any,
        study: Any,
        pool: Any,
        objective: Objective,
        first: int,
        progress: Progress | None,
        watch: Callable[[SearchResult], None] | None,
    ) -> None:
        """Draw the round that ``first`` belongs to, or its missing rest, and work it off."""
        begin = first - first % self.round_size
        stop = min(begin + self.round_size, self.trials)
        drawn = self._drawn(optuna, study, begin, begin + self.round_size)
        done = {trial.number for trial in self._told(study)}
        missing = {number: drawn[number - begin] for number in range(begin, stop) if number not in done}
        earlier = tuple(t.steps for t in self._told(study) if t.number < begin and not t.failure and t.steps)
        earlier = earlier if self.pruner == "median" else ()
        tasks = [Task(number=n, settings=s, seed=self.seed + n, earlier=earlier) for n, s in missing.items()]
        for number, done in pool.work(objective, tasks):
            self._tell(optuna, study, TrialResult(number=number, settings=missing[number], **done))
            if progress is not None:
                self._report(study, progress)
            if watch is not None:
                watch(SearchResult(trials=tuple(self._told(study))))

    def _report(self, study: Any, progress: Progress) -> None:
        result = SearchResult(trials=tuple(self._told(study)))
        good = [trial.score for trial in result.trials if not trial.failure]
        words = [
            f"trial {len(result.trials)} of {self.trials}",
            f"best {min(good):.4g}" if good else "none succeeded yet",
        ]
        words += [
            f"{len(group)} {name}" for name, group in (("pruned", result.pruned), ("failed", result.failed)) if group
        ]
        progress(min(1.0, len(result.trials) / self.trials), ", ".join(words))

    def _drawn(self, optuna: Any, study: Any, begin: int, stop: int) -> list[dict[str, Value]]:
        """Settings of a whole round, from finished earlier rounds and the seed alone."""
        kind = optuna.samplers.TPESampler if self.sampler == "tpe" else optuna.samplers.RandomSampler
        sampler = kind(seed=self.seed + begin)
        draft = optuna.create_study(direction="minimize", sampler=sampler)
        for trial in self._told(study):
            if trial.number < begin and not trial.failure:
                draft.add_trial(
                    optuna.trial.create_trial(
                        params=trial.settings, distributions=self._distributions(optuna), value=trial.score
                    )
                )
        return [dict(draft.ask(self._distributions(optuna)).params) for _ in range(begin, stop)]

    def _distributions(self, optuna: Any) -> dict[str, Any]:
        distributions = {}
        for name, what in self.space.items():
            if isinstance(what, Choice):
                distributions[name] = optuna.distributions.CategoricalDistribution(what.values)
            elif isinstance(what.low, int) and isinstance(what.high, int):
                distributions[name] = optuna.distributions.IntDistribution(what.low, what.high, log=what.log)
            else:
                distributions[name] = optuna.distributions.FloatDistribution(what.low, what.high, log=what.log)
        return distributions

    def _tell(self, optuna: Any, study: Any, trial: TrialResult) -> None:
        states = optuna.trial.TrialState
        state = states.PRUNED if trial.pruned else states.FAIL if trial.failure else states.COMPLETE
        study.add_trial(
            optuna.trial.create_trial(
                state=state,
                params=trial.settings,
                distributions=self._distributions(optuna),
                value=None if trial.failure else trial.score,
                intermediate_values=dict(enumerate(trial.steps)),
                user_attrs={"number": trial.number, "seconds": trial.seconds, "failure": trial.failure},
            )
        )

    def _told(self, study: Any) -> list[TrialResult]:
        """Trials of the journal in the order of drawing, each number once."""
        chosen = {}
        for trial in study.get_trials(deepcopy=False):
            a = trial.user_attrs
            if "number" in a and a["number"] not in chosen:
                chosen[a["number"]] = TrialResult(
                    number=a["number"],
                    settings=dict(trial.params),
                    score=math.inf if a["failure"] else float(trial.value),
                    seconds=a["seconds"],
                    failure=a["failure"],
                    steps=tuple(v for _, v in sorted(trial.intermediate_values.items())),
                )
        return [chosen[number] for number in sorted(chosen)]


def columns(result: SearchResult) -> tuple[tuple[str, ...], Sequence[Sequence[Value]]]:
    """Names and rows of the result table: number, settings, score, seconds, failure; the best first."""
    names = tuple(result.trials[0].settings) if result.trials else ()
    ordered = sorted(result.trials, key=lambda trial: (trial.score, trial.number))
    rows = [[t.number, *(t.settings[n] for n in names), t.score, t.seconds, t.failure] for t in ordered]
    return ("trial", *names, "score", "seconds", "failure"), rows
