"""Tries inputs in a process of its own, with limits on memory and on processor time per input, and keeps what fails."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tests.fuzz.targets import TARGETS

MEMORY = 4 << 30  # bytes beyond what the program itself takes
_LONGEST = 2000  # letters of a message
_ENOUGH = 20  # kinds of failure, then a run ends


def make(target: str, seed: int, index: int) -> tuple[str, bytes, dict]:
    """One input: file name, content, options of the reader."""
    rng = np.random.default_rng([seed, sorted(TARGETS).index(target), index])
    return TARGETS[target].make(rng)


def try_one(target: str, seed: int, index: int, folder: Path) -> str:
    """Give one input to its reader; what is wrong with how it ends, empty if nothing is."""
    from slipangle.errors import SlipangleError

    name, raw, options = make(target, seed, index)
    path = folder / name
    path.write_bytes(raw)
    said = ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            warnings.simplefilter("ignore", UserWarning)
            TARGETS[target].read(path, **options)
    except SlipangleError as error:
        said = str(error)
    except Exception as error:
        frames = [
            f for f in traceback.extract_tb(error.__traceback__) if "slipangle" in f.filename or "fuzz" in f.filename
        ]
        return f"{type(error).__name__} at {Path(frames[-1].filename).name}:{frames[-1].lineno}: {str(error)[:200]}"
    if "\n" in said or len(said) > _LONGEST:
        return f"a message of {said.count(chr(10)) + 1} lines and {len(said)} letters: {said[:100]!r}"
    return ""


def child(target: str, seed: int, first: int, count: int, seconds: float, folder: Path) -> None:
    """Try inputs until there are enough of them or the time is over; progress and failures go to files."""
    make(target, seed, first)
    began, seen = time.monotonic(), set()
    report = (folder / "failures").open("a", encoding="utf-8")
    for index in range(first, first + count):
        if time.monotonic() - began > seconds or len(seen) >= _ENOUGH:
            break
        (folder / "index").write_text(str(index))
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, TARGETS[target].seconds)  # its signal ends the process, come what may
        wrong = try_one(target, seed, index, folder)
        if wrong and wrong.split(": ")[0] not in seen:
            seen.add(wrong.split(": ")[0])
            report.write(json.dumps([index, wrong]) + "\n")
            report.flush()
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, 0)
    (folder / "done").write_text(str(index + 1 - first))


def _limit_memory() -> None:
    """Room for what the readers need to be loaded, and `MEMORY` more."""
    if sys.platform != "linux":
        return
    import resource

    import slipangle.models.storage
    import slipangle.paths.path
    import slipangle.workflow.settings  # noqa: F401

    now = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY, now + MEMORY))


def run(target: str, seed: int, count: int, seconds: float = float("inf")) -> tuple[int, list[str]]:
    """How many inputs were tried, and a sentence on each kind of failure, with the file kept and how to repeat it."""
    kept: list[str] = []
    first, tried = 0, 0
    began = time.monotonic()
    while tried < count and time.monotonic() - began < seconds and len(kept) < _ENOUGH:
        with tempfile.TemporaryDirectory(prefix="slipangle-fuzz-") as name:
            folder = Path(name)
            left = min(seconds - (time.monotonic() - began), 1e9)
            call = [
                sys.executable,
                "-m",
                "tests.fuzz.runner",
                target,
                *map(str, (seed, first, count - tried, left)),
                name,
            ]
            done = subprocess.run(call, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2])
            failures = folder / "failures"
            lines = failures.read_text(encoding="utf-8").splitlines() if failures.exists() else []
            kept += [_kept(target, seed, *json.loads(line)) for line in lines]
            if (folder / "done").exists():
                tried += int((folder / "done").read_text())
                if tried < count and left < 1e9:
                    break
                continue
            if not (folder / "index").exists():
                raise RuntimeError(f"the fuzzer of '{target}' did not start: {done.stderr[-2000:]}")
            index = int((folder / "index").read_text())
            how = (
                "took too long"
                if done.returncode == -getattr(signal, "SIGPROF", 0)
                else f"ended it ({done.returncode})"
            )
            kept.append(_kept(target, seed, index, f"{how}: {done.stderr[-200:]!r}"))
            tried += index + 1 - first
            first = index + 1
    return tried, kept


def end_well(counts: Mapping[str, int], seed: int) -> set[str]:
    """The targets of which so many inputs each end well, tried one after another by one process."""
    with tempfile.TemporaryDirectory(prefix="slipangle-fuzz-") as name:
        folder = Path(name)
        for target, count in counts.items():
            (folder / f"{target}.count").write_text(str(count))
        call = [sys.executable, "-m", "tests.fuzz.runner", "together", name, str(seed), *counts]
        subprocess.run(call, capture_output=True, check=False, cwd=Path(__file__).parents[2])

        def well(target: str) -> bool:
            done, failures = folder / target / "done", folder / target / "failures"
            return done.exists() and done.read_text() == str(counts[target]) and not failures.read_text()

        return {target for target in counts if well(target)}


def _kept(target: str, seed: int, index: int, wrong: str) -> str:
    name, raw, options = make(target, seed, index)
    path = Path(tempfile.gettempdir()) / f"fuzz-{target}-{seed}-{index}-{name}"
    path.write_bytes(raw)
    repeat = f"python -m tests.fuzz --target {target} --seed {seed} --index {index}"
    return f"{wrong}\n    {path} {options}\n    {repeat}"


if __name__ == "__main__":
    _limit_memory()
    if sys.argv[1] == "together":
        for each in sys.argv[4:]:
            (to := Path(sys.argv[2]) / each).mkdir()
            child(each, int(sys.argv[3]), 0, int((Path(sys.argv[2]) / f"{each}.count").read_text()), float("inf"), to)
    else:
        child(sys.argv[1], *map(int, sys.argv[2:5]), float(sys.argv[5]), Path(sys.argv[6]))
