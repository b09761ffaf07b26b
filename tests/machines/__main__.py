"""Run the matrix; see `tests.machines`."""

from __future__ import annotations

import argparse
import fnmatch
import json
import math
import os
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from slipangle.errors import MissingFileError
from tests.machines.combinations import Combination, design
from tests.machines.registry import Errors, Fit, load

MOST = {"train": 1.0, "validation": 3.0}  # percent
_MARK, _ABSENT = "machines:", "absent:"
_SHARES = 3  # of the tests, of which a hash chooses one: without a compiler all take longer than the rest of CI


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 if every number is the same everywhere."""
    parser = argparse.ArgumentParser(prog="python -m tests.machines", description=__doc__)
    parser.add_argument("--only", default="*", help="fits whose name matches, such as '*NARX*'")
    parser.add_argument("--combos", type=int, help="only the first N combinations")
    parser.add_argument("--one", metavar="HASH", help="one combination, and a third of the tests, by these digits")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at a time")
    parser.add_argument("--tests", action="store_true", help="also the fast tests of everything that fits")
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds for one process")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    fits = load()
    if given.worker:
        return _work(fits[given.worker])
    names = [n for n in fits if fnmatch.fnmatch(n.lower(), _pattern(given.only))]
    if not names:
        parser.error(f"no fit matches {given.only!r}; there are {', '.join(fits)}")
    combinations, left_out = chosen(given.one, given.combos)
    for combination in left_out:
        print(f"not on this processor: {combination}")
    wrong = _matrix({n: fits[n] for n in names}, [Combination(), *combinations], given.jobs, given.limit)
    if given.tests:
        files = share(given.one)
        wrong += [f"tests under {c}" for c in combinations if _tests(c, given.jobs, given.limit, files)]
    print("\n".join(["", *(f"FAILED: {line}" for line in wrong)]) if wrong else "\nthe same on every machine")
    return int(bool(wrong))


def chosen(one: str | None, count: int | None) -> tuple[list[Combination], list[Combination]]:
    """Combinations to run, and those that this processor cannot."""
    everything = design()
    here = [c for c in everything if c.possible()]
    if one is not None:
        return [here[int(one[:12], 16) % len(here)]], []
    return here[:count], [c for c in everything if not c.possible()]


def share(one: str | None) -> list[str]:
    """Test files of everything that fits, of which ``one``, the hexadecimal digits of a commit, chooses every third."""
    folders = (Path(name) for name in ("tests/identify", "tests/reproduce"))
    files = sorted(str(path) for folder in folders for path in folder.rglob("test_*.py"))
    return files if one is None else files[int(one[-12:], 16) % _SHARES :: _SHARES]


def _pattern(text: str) -> str:
    return text.lower() if "*" in text else f"*{text.lower()}*"


def _work(fit: Fit) -> int:
    """In a process of its own: print the errors of one fit."""
    warnings.simplefilter("ignore")
    began = time.process_time()
    try:
        errors = {key: float(value) for key, value in fit.run().items()}
    except MissingFileError as error:
        print(_ABSENT + str(error))
        return 0
    print(_MARK + json.dumps({**errors, "seconds": time.process_time() - began}))
    return 0


def _matrix(fits: dict[str, Fit], combinations: list[Combination], jobs: int, limit: float) -> list[str]:
    """Run and print, fit by fit; sentences about what is wrong."""
    wrong = []
    with ThreadPoolExecutor(jobs) as pool:
        tasks = {n: [pool.submit(partial(_run, n, c, limit)) for c in combinations] for n in fits}
        for name, fit in fits.items():
            print(f"\n{name}")
            found: list[Errors] = []
            for combination, task in zip(combinations, tasks[name], strict=True):
                result = task.result()
                if result is None:
                    print(f"  {combination!s:<42} skipped, its data are not here")
                    continue
                if isinstance(result, str):
                    wrong.append(f"{name} under {combination}: {result}")
                    print(f"  {combination!s:<42} {result}", flush=True)
                    continue
                broken = fit.broken(result)
                wrong += [f"{name} under {combination}: {line}" for line in broken]
                found.append(result)
                numbers = "  ".join(f"{key} {value:.6g}" for key, value in result.items() if key != "seconds")
                print(f"  {combination!s:<42} {numbers}  ({result['seconds']:.1f} s) {'; '.join(broken)}", flush=True)
            for kind, most in MOST.items():
                keys = [key for key in (found[0] if found else {}) if key.split()[0] == kind]
                apart = {key: spread([errors[key] for errors in found], fit.noise) for key in keys}
                worst = max(apart, key=lambda key: apart[key], default="")
                if worst:
                    print(f"  spread of {worst}: {apart[worst]:.3g} % (at most {most:g} %)", flush=True)
                wrong += [
                    f"{name}: {key} differs by {value:.3g} %, at most {most:g} %"
                    for key, value in apart.items()
                    if not value <= most
                ]
    return wrong


def spread(values: list[float], noise: float = 0.0) -> float:
    """Largest difference relative to the smallest value, or to the noise where that is larger. [%]

    >>> round(spread([2.0, 2.02]), 6), spread([1e-9, 3e-9], noise=1e-6) < 1
    (1.0, True)
    """
    if not values:
        return 0.0
    if not all(math.isfinite(v) for v in values):
        return math.inf
    return 100 * (max(values) - min(values)) / max(min(abs(v) for v in values), noise, 1e-300)


def _run(name: str, combination: Combination, limit: float) -> Errors | str | None:
    """Errors of one fit on one machine, or what went wrong; None if its public data are absent."""
    command = [sys.executable, "-m", "tests.machines", "--worker", name]
    try:
        done = subprocess.run(
            command, env=combination.environment(), capture_output=True, text=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return f"not done after {limit:g} s"
    if any(line.startswith(_ABSENT) for line in done.stdout.splitlines()):
        return None
    lines = [line for line in done.stdout.splitlines() if line.startswith(_MARK)]
    if done.returncode or not lines:
        said = (done.stderr.strip().splitlines() or ["nothing said"])[-1]
        return f"exit code {done.returncode}: {said[:200]}"
    return json.loads(lines[-1].removeprefix(_MARK))


def _tests(combination: Combination, jobs: int, limit: float, files: list[str]) -> int:
    """The fast tests in these files on one machine, so many at a time; pytest's exit code, or 1 after ``limit`` s."""
    command = [sys.executable, "-m", "pytest", "-q", "-m", "not slow", "-p", "no:cacheprovider", "-n", str(jobs)]
    command += [*files, "--durations=10"]
    pipe: Any = {"stdout": subprocess.PIPE, "text": True, "start_new_session": True}
    with subprocess.Popen(command, env=combination.environment(), **pipe) as process:
        try:
            said, code = process.communicate(timeout=limit)[0], process.returncode
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # pytest and its workers
            said, code = f"{process.communicate()[0]}\nnot done after {limit:g} s", 1
    lines = said.strip().splitlines()
    told = [line for line in lines if line.startswith(("FAILED", "ERROR")) or " call " in line or " setup " in line]
    print(f"\ntests under {combination}: {lines[-1] if lines else 'nothing said'}", *told, sep="\n  ", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
