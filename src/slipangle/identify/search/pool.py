"""Who computes the trials of a search: processes here, or workers of a Ray cluster."""

from __future__ import annotations

import math
import signal
import socket
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from slipangle.errors import ConfigError
from slipangle.extras import extra

Value = int | float | str
Report = Callable[[float], None]  # what is known of the score so far; does not return where the trial is given up
Objective = Callable[[Mapping[str, Value], int, Report], float]  # settings, seed, report -> score, smaller is better
Done = dict[str, Any]  # score, seconds, failure and steps of a `slipangle.identify.search.search.TrialResult`
PRUNED = "given up"
FEWEST = 4  # finished trials before one is given up


@dataclass(frozen=True, kw_only=True)
class Task:
    """One trial to compute."""

    number: int
    settings: Mapping[str, Value]
    seed: int
    # what the finished trials of earlier rounds reported; empty gives up none
    earlier: tuple[tuple[float, ...], ...] = ()


class GivenUp(Exception):
    """The trial is worse than earlier ones were at this step."""


def attempt(objective: Objective, task: Task) -> Done:
    """Score, seconds, reason of failure and reports of one trial; never raises."""
    began, steps, failure, score = time.perf_counter(), [], "", math.inf
    report = _report(task, steps)
    try:
        score = float(objective(task.settings, task.seed, report))
        if not math.isfinite(score):
            score, failure = math.inf, f"the score is {score}"
    except GivenUp as told:
        failure = str(told)
    except Exception as error:  # whatever a trial raises is its result
        failure = f"{type(error).__name__}: {error}"
    return {"score": score, "seconds": time.perf_counter() - began, "failure": failure, "steps": tuple(steps)}


def _report(task: Task, steps: list[float]) -> Report:
    """Keeps what is reported and asks Optuna's median pruner, which knows the earlier trials."""
    trial: Any = None
    if len(task.earlier) >= FEWEST:
        optuna = extra("optuna", "cluster", "searching")
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        study = optuna.create_study(pruner=optuna.pruners.MedianPruner(n_startup_trials=FEWEST))
        for values in task.earlier:
            study.add_trial(optuna.trial.create_trial(value=values[-1], intermediate_values=dict(enumerate(values))))
        trial = study.ask()

    def report(value: float) -> None:
        steps.append(float(value))
        k = len(steps) - 1
        if trial is None:
            return
        trial.report(float(value), k)
        if trial.should_prune():
            there = statistics.median(values[k] for values in task.earlier if len(values) > k)
            raise GivenUp(f"{PRUNED} at step {k + 1}: {value:.4g}, where the median of earlier trials was {there:.4g}")

    return report


def lost(why: str) -> Done:
    """Result of a trial whose process died."""
    return {"score": math.inf, "seconds": 0.0, "failure": why, "steps": ()}


class Local:
    """A pool of local processes; a process that dies takes the trials in hand with it once, not the study."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.pool = self._new()

    def _new(self) -> ProcessPoolExecutor:
        """Workers that the interrupt from a terminal, which all of its processes get, ends without a word."""
        quiet: dict[str, Any] = {"initializer": signal.signal, "initargs": (signal.SIGINT, signal.SIG_DFL)}
        return ProcessPoolExecutor(self.workers, mp_context=get_context("spawn"), **quiet)

    def work(self, objective: Objective, tasks: Sequence[Task]) -> Iterator[tuple[int, Done]]:
        """Yield results as they come; trials in flight when a process died are tried once more, one at a time."""
        waiting = {self.pool.submit(attempt, objective, task): task for task in tasks}
        again: list[Task] = []
        while waiting:
            ready, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                task = waiting.pop(future)
                try:
                    yield task.number, future.result()
                except BrokenProcessPool:
                    again.append(task)
        broken = bool(again)
        for task in sorted(again, key=lambda task: task.number):
            if broken:
                self.close()
                self.pool = self._new()
            try:
                broken = False
                yield task.number, self.pool.submit(attempt, objective, task).result()
            except BrokenProcessPool:
                broken = True
                yield task.number, lost("its process died twice")
        if broken:
            self.close()
            self.pool = self._new()

    def close(self) -> None:
        """End the processes."""
        self.pool.shutdown(wait=False, cancel_futures=True)


class Cluster:
    """Workers of a Ray cluster, one trial per processor; Ray restarts a trial whose worker died, three times."""

    def __init__(self, address: str) -> None:
        self.ray = extra("ray", "cluster", "searching")
        self.mine = not self.ray.is_initialized()
        if self.mine:
            try:
                _knock(address)
                self.ray.init(address=address, log_to_driver=False, logging_level="error")
            except Exception as error:
                raise ConfigError(
                    f"the Ray cluster at '{address}' cannot be reached ({error}); expected a running one: start it "
                    "with ray start --head"
                ) from None
        there = self.ray.cluster_resources()
        share = there.get("GPU", 0.0) / max(there.get("CPU", 1.0), 1.0)  # Ray hides GPUs that a task does not ask for
        self.remote = self.ray.remote(max_retries=3, num_cpus=1, num_gpus=min(share, 1.0))(attempt)

    def work(self, objective: Objective, tasks: Sequence[Task]) -> Iterator[tuple[int, Done]]:
        """Yield results as they come.

        Raises ConfigError if the cluster is gone; finished trials are in the journal.
        """
        errors = self.ray.exceptions
        try:
            shared = self.ray.put(objective)
            waiting = {self.remote.remote(shared, task): task for task in tasks}
            while waiting:
                ready, _ = self.ray.wait(list(waiting), num_returns=1)
                task = waiting.pop(ready[0])
                try:
                    yield task.number, self.ray.get(ready[0])
                except (errors.WorkerCrashedError, errors.OutOfMemoryError, errors.RayTaskError) as error:
                    yield task.number, lost(f"its worker died: {str(error).strip().splitlines()[-1]}")
        except (errors.RayError, ConnectionError) as error:
            raise ConfigError(
                f"the Ray cluster went away ({str(error).splitlines()[0]}); expected it to run until the search ends: "
                "start it again and repeat the command, finished trials are in the journal"
            ) from None

    def close(self) -> None:
        """Leave the cluster, if this search joined it."""
        if self.mine:
            self.ray.shutdown()


def _knock(address: str) -> None:
    """Raise where nobody listens at ``host:port``: Ray itself would go on trying for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if host and port.isdigit():
        socket.create_connection((host, int(port)), timeout=10.0).close()
