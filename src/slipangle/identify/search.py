"""Search for lags, layers, neurons and other settings, on local processes or a Ray cluster.

Every trial draws its settings from a sampler that knows all finished trials, and is kept in a journal on disk: a
study that was killed, on either side, goes on where it stopped, and a trial that failed stays with its reason. The
sampler, pruner and journal are Optuna's; it and Ray are extras (``pip install "slipangle[cluster]"``).
"""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from slipangle.errors import ConfigError, ParameterError
from slipangle.identify.training import Progress

Value = int | float | str
Objective = Callable[[Mapping[str, Value], int], float]  # settings, seed -> score, smaller is better


@dataclass(frozen=True, kw_only=True)
class Range:
    """Numbers from ``low`` to ``high``, both included.

    Parameters
    ----------
    low, high : int or float
        Ends; whole numbers give whole numbers.
    log : bool
        Draw evenly on a logarithmic scale.

    Raises
    ------
    ParameterError
        If the ends are not in order, or not positive on a logarithmic scale.
    """

    low: int | float
    high: int | float
    log: bool = False

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
    """One trial of a search.

    Parameters
    ----------
    number : int
        In the order of drawing; also the trial's seed, on top of the study's.
    settings : dict of str to value
        What was tried.
    score : float
        Value of the objective; infinite if the trial failed.
    seconds : float
        How long it took. [s]
    failure : str
        Why it has no score.
    """

    number: int
    settings: dict[str, Value]
    score: float
    seconds: float
    failure: str = ""


@dataclass(frozen=True, kw_only=True)
class SearchResult:
    """Every trial of a study, in the order of drawing."""

    trials: tuple[TrialResult, ...]

    @property
    def best(self) -> TrialResult:
        """The trial with the smallest score.

        Raises
        ------
        ParameterError
            If no trial succeeded; the first reason is given.
        """
        good = [trial for trial in self.trials if not trial.failure]
        if not good:
            why = self.trials[0].failure if self.trials else "there is none"
            raise ParameterError(f"no trial succeeded ({why}); expected at least one: widen the space or run more")
        return min(good, key=lambda trial: (trial.score, trial.number))

    @property
    def failed(self) -> tuple[TrialResult, ...]:
        """Trials without a score."""
        return tuple(trial for trial in self.trials if trial.failure)


@dataclass(frozen=True, kw_only=True)
class Search:
    """A study: what is searched, how long, where it is kept, who computes.

    Trials are drawn in rounds of ``round_size``, so what is drawn depends on the seed and on finished rounds alone:
    any number of workers, here or on a cluster, gives the same trials and the same best score.

    Parameters
    ----------
    space : mapping of str to Range or Choice
        Settings by name.
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

    Raises
    ------
    ParameterError
        If a number is below 1 or the space is empty.
    """

    space: Mapping[str, Range | Choice]
    trials: int = 32
    journal: str | Path | None = None
    seed: int = 0
    workers: int = 2
    cluster: str | None = None
    round_size: int = 8
    sampler: str = "tpe"

    def __post_init__(self) -> None:
        if not self.space:
            raise ParameterError("the search space is empty; expected at least one setting, such as na=Range(...)")
        for name in ("trials", "workers", "round_size"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} is {getattr(self, name)}; expected a whole number of at least 1")
        if self.sampler not in ("tpe", "random"):
            raise ParameterError(f"the sampler is '{self.sampler}'; expected 'tpe' or 'random'")

    def run(self, objective: Objective, *, progress: Progress | None = None) -> SearchResult:
        """Work through the trials that are missing.

        Parameters
        ----------
        objective : callable
            From settings and a seed to a score, smaller being better; at module level, so that other processes can
            import it. What it raises becomes the trial's reason.
        progress : callable, optional
            Told the share done and the best so far.

        Raises
        ------
        ConfigError
            If Optuna, or Ray for a cluster, is not installed, or the journal holds another search.
        """
        optuna = _extra("optuna")
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = self._study(optuna)
        pool: Any = _Cluster(self.cluster) if self.cluster else _Local(self.workers)
        try:
            while (first := len(self._told(study))) < self.trials:
                self._round(optuna, study, pool, objective, first, progress)
        finally:
            pool.close()
        return SearchResult(trials=tuple(self._told(study)[: self.trials]))

    # ---- the study ---------------------------------------------------------------------------------------------

    def _study(self, optuna: Any) -> Any:
        storage = None
        if self.journal is not None:
            journal = importlib.import_module("optuna.storages.journal")
            path = Path(self.journal)
            lock = journal.JournalFileOpenLock(str(path))
            backend = journal.JournalFileBackend(str(path), lock_obj=lock)
            storage = optuna.storages.JournalStorage(backend)
        study = optuna.create_study(study_name="slipangle", storage=storage, direction="minimize", load_if_exists=True)
        signature = repr(
            (sorted((k, repr(v)) for k, v in self.space.items()), self.seed, self.round_size, self.sampler)
        )
        kept = study.user_attrs.get("search")
        if kept is None:
            study.set_user_attr("search", signature)
        elif kept != signature:
            raise ConfigError(
                f"'{self.journal}' keeps another search (its space, seed, round size or sampler differ); expected the "
                "same: name another journal"
            )
        return study

    def _round(
        self, optuna: Any, study: Any, pool: Any, objective: Objective, first: int, progress: Progress | None
    ) -> None:
        """Draw the round that ``first`` belongs to, or its missing rest, and work it off."""
        begin = first - first % self.round_size
        stop = min(begin + self.round_size, self.trials)
        drawn = self._drawn(optuna, study, begin, begin + self.round_size)
        done = {trial.number for trial in self._told(study)}
        missing = {number: drawn[number - begin] for number in range(begin, stop) if number not in done}
        for number, score, seconds, failure in pool.work(objective, missing, self.seed):
            self._tell(optuna, study, TrialResult(
                number=number, settings=missing[number], score=score, seconds=seconds, failure=failure
            ))  # fmt: skip
            if progress is not None:
                told = self._told(study)
                good = [trial.score for trial in told if not trial.failure]
                best = f"best {min(good):.4g}" if good else "none succeeded yet"
                progress(len(told) / self.trials, f"trial {len(told)} of {self.trials}, {best}")

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
        found = {}
        for name, what in self.space.items():
            if isinstance(what, Choice):
                found[name] = optuna.distributions.CategoricalDistribution(what.values)
            elif isinstance(what.low, int) and isinstance(what.high, int):
                found[name] = optuna.distributions.IntDistribution(what.low, what.high, log=what.log)
            else:
                found[name] = optuna.distributions.FloatDistribution(what.low, what.high, log=what.log)
        return found

    def _tell(self, optuna: Any, study: Any, trial: TrialResult) -> None:
        state = optuna.trial.TrialState.FAIL if trial.failure else optuna.trial.TrialState.COMPLETE
        study.add_trial(
            optuna.trial.create_trial(
                state=state,
                params=trial.settings,
                distributions=self._distributions(optuna),
                value=None if trial.failure else trial.score,
                user_attrs={"number": trial.number, "seconds": trial.seconds, "failure": trial.failure},
            )
        )

    def _told(self, study: Any) -> list[TrialResult]:
        """Trials of the journal in the order of drawing, each number once."""
        found = {}
        for trial in study.get_trials(deepcopy=False):
            a = trial.user_attrs
            if "number" in a and a["number"] not in found:
                found[a["number"]] = TrialResult(
                    number=a["number"],
                    settings=dict(trial.params),
                    score=math.inf if a["failure"] else float(trial.value),
                    seconds=a["seconds"],
                    failure=a["failure"],
                )
        return [found[number] for number in sorted(found)]


# ---- who computes --------------------------------------------------------------------------------------------------

Done = tuple[int, float, float, str]  # number, score, seconds, failure


def attempt(objective: Objective, settings: Mapping[str, Value], seed: int) -> tuple[float, float, str]:
    """Score, seconds and reason of failure of one trial; never raises."""
    began = time.perf_counter()
    try:
        score, failure = float(objective(settings, seed)), ""
    except Exception as error:  # whatever a trial raises is its result
        score, failure = math.inf, f"{type(error).__name__}: {error}"
    if not failure and not math.isfinite(score):
        score, failure = math.inf, f"the score is {score}"
    return score, time.perf_counter() - began, failure


class _Local:
    """A pool of local processes; a process that dies takes the trials in hand with it once, not the study."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.workers, mp_context=get_context("spawn"))

    def work(self, objective: Objective, missing: Mapping[int, Mapping[str, Value]], seed: int) -> Any:
        """Yield results as they come; trials in flight when a process died are tried once more, one at a time."""
        waiting = self._submit(objective, missing, seed)
        lost: list[int] = []
        while waiting:
            ready, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                number = waiting.pop(future)
                try:
                    yield (number, *future.result())
                except BrokenProcessPool:
                    lost.append(number)
        for number in sorted(lost):
            self.pool.shutdown(wait=False, cancel_futures=True)
            self.pool = self._new()
            try:
                yield (number, *self.pool.submit(attempt, objective, missing[number], seed + number).result())
            except BrokenProcessPool:
                yield number, math.inf, 0.0, "its process died twice"

    def _submit(self, objective: Objective, missing: Mapping[int, Mapping[str, Value]], seed: int) -> dict[Future, int]:
        return {self.pool.submit(attempt, objective, s, seed + n): n for n, s in missing.items()}

    def close(self) -> None:
        """End the processes."""
        self.pool.shutdown(wait=False, cancel_futures=True)


class _Cluster:
    """Workers of a Ray cluster; Ray restarts a task whose worker died."""

    def __init__(self, address: str) -> None:
        self.ray = _extra("ray")
        self.mine = not self.ray.is_initialized()
        if self.mine:
            try:
                self.ray.init(address=address, log_to_driver=False, logging_level="error")
            except Exception as error:
                raise ConfigError(
                    f"the Ray cluster at '{address}' cannot be reached ({error}); expected a running one: start it "
                    "with ray start --head"
                ) from None
        self.remote = self.ray.remote(max_retries=3, num_cpus=1)(attempt)

    def work(self, objective: Objective, missing: Mapping[int, Mapping[str, Value]], seed: int) -> Any:
        """Yield results as they come."""
        waiting = {self.remote.remote(objective, dict(s), seed + n): n for n, s in missing.items()}
        while waiting:
            ready, _ = self.ray.wait(list(waiting), num_returns=1)
            number = waiting.pop(ready[0])
            try:
                yield (number, *self.ray.get(ready[0]))
            except self.ray.exceptions.RayError as error:
                yield number, math.inf, 0.0, f"its worker died: {str(error).splitlines()[0]}"

    def close(self) -> None:
        """Leave the cluster, if this search joined it."""
        if self.mine:
            self.ray.shutdown()


def _extra(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError:
        raise ConfigError(
            f"searching needs {name}, which is not installed; expected the extra: pip install 'slipangle[cluster]'"
        ) from None


def columns(result: SearchResult) -> tuple[tuple[str, ...], Sequence[Sequence[Value]]]:
    """Names and rows of the result table: number, settings, score, seconds, failure; the best first."""
    names = tuple(result.trials[0].settings) if result.trials else ()
    ordered = sorted(result.trials, key=lambda trial: (trial.score, trial.number))
    rows = [[t.number, *(t.settings[n] for n in names), t.score, t.seconds, t.failure] for t in ordered]
    return ("trial", *names, "score", "seconds", "failure"), rows
