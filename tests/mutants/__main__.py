"""``python -m tests.mutants``: break a copy of the source one mutant at a time and see that the tests notice.

Prints a line for each mutant that was not killed and the count at the end; exit code 0 if all were killed, 1 if one
survived, was not decided (time, tests that could not run) or no longer fits the source.
"""

from __future__ import annotations

import argparse
import fnmatch
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from slipangle.codegen import compiler as compiled
from tests.mutants import methods, orders, tires, vehicles
from tests.mutants.listed import ROOT, SOURCE, Mutant

ALL = (*vehicles.MUTANTS, *tires.MUTANTS, *methods.MUTANTS, *orders.MUTANTS)
KILLED, SURVIVED, LATE, UNCLEAR = "killed", "SURVIVED", "TOO LONG", "TESTS DO NOT RUN"


class Copy:
    """A copy of the source in a folder of its own, to be broken and mended; one process at a time uses it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
        cache = folder / "cache"
        cache.mkdir(mode=0o700)
        inside = {"PYTHONPATH": str(folder / "src"), "PYTHONPYCACHEPREFIX": str(folder / "pyc")}
        self.settings = os.environ | inside | {"XDG_CACHE_HOME": str(cache), "OMP_NUM_THREADS": "1"}
        self.settings.pop("PYTHONDONTWRITEBYTECODE", None)
        self._stamp = int(time.time())
        seen = self._python("-c", "import slipangle; print(slipangle.__file__)", limit=120).stdout.strip()
        if not seen.startswith(str(folder)):
            raise RuntimeError(f"Python imports {seen}; expected the copy in {folder}")

    def run(self, tests: Sequence[str], limit: float) -> str:
        """What the tests say of the copy as it is: `KILLED` if one fails."""
        files = [str(ROOT / "tests" / t) for t in tests]
        try:
            done = self._python("-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *files, limit=limit)
        except subprocess.TimeoutExpired:
            return LATE
        return {0: SURVIVED, 1: KILLED}.get(done.returncode, UNCLEAR)

    def judge(self, mutant: Mutant, limit: float) -> str:
        """What the mutant's tests say of it."""
        file = self.folder / SOURCE / mutant.file
        text = file.read_text(encoding="utf-8")
        self._write(file, mutant.broken(text))
        try:
            return self.run(mutant.tests, limit)
        finally:
            self._write(file, text)

    def _write(self, file: Path, text: str) -> None:
        file.write_text(text, encoding="utf-8")
        self._stamp += 2  # byte code is known by whole seconds
        os.utime(file, (self._stamp, self._stamp))

    def _python(self, *arguments: str, limit: float) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *arguments],
            cwd=ROOT,
            env=self.settings,
            timeout=limit,
            capture_output=True,
            text=True,
            check=False,
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge all mutants, or those whose name or file matches a pattern."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--jobs", type=int, default=2, help="mutants at a time")
    parser.add_argument("--only", nargs="+", default=["*"], metavar="PATTERN", help="shell patterns of names or files")
    parser.add_argument("--limit", type=float, default=120.0, metavar="SECONDS", help="time for one mutant")
    given = parser.parse_args(arguments)
    chosen = [m for m in ALL if any(fnmatch.fnmatch(t, p) for t in (m.name, m.file) for p in given.only)]
    if not chosen:
        print(f"no mutant is named {' or '.join(given.only)}; expected a pattern of a name or file, such as 'models/*'")
        return 1
    if not compiled.compiler():
        print(f"{compiled.sentence()}: some mutants are in C")
        return 1
    for mutant in chosen:
        mutant.broken((ROOT / SOURCE / mutant.file).read_text(encoding="utf-8"))
    began = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copies: queue.SimpleQueue[Copy] = queue.SimpleQueue()
        for k in range(given.jobs):
            copies.put(Copy(Path(folder) / str(k)))

        def with_copy(what: Mutant | tuple[str, ...]) -> tuple[str, float]:
            copy, start = copies.get(), time.perf_counter()
            try:
                found = copy.judge(what, given.limit) if isinstance(what, Mutant) else copy.run(what, 4 * given.limit)
            finally:
                copies.put(copy)
            return found, time.perf_counter() - start

        with ThreadPoolExecutor(given.jobs) as pool:
            files = sorted({(test,) for m in chosen for test in m.tests})
            for (file,), (found, _) in zip(files, pool.map(with_copy, files), strict=True):
                if found != SURVIVED:  # a test that fails anyway would kill every mutant
                    print(
                        f"{file} does not pass on the source as it is ({found.lower()}); expected it to: mend it first"
                    )
                    return 1
            print(
                f"{len(files)} test files pass on the source as it is, {time.perf_counter() - began:.0f} s", flush=True
            )
            results = []
            for mutant, (found, seconds) in zip(chosen, pool.map(with_copy, chosen), strict=True):
                results.append(found)
                print(f"{found:9} {seconds:5.1f} s  {mutant.file}: {mutant.name}", flush=True)
    killed = results.count(KILLED)
    print(f"{killed} of {len(results)} mutants killed, {time.perf_counter() - began:.0f} s")
    return 0 if killed == len(results) else 1


if __name__ == "__main__":
    sys.exit(main())
