"""Fuzz by hand, for minutes or hours: ``python -m tests.fuzz --seconds 3600 --seed 7``."""

import argparse
import tempfile
from pathlib import Path

from tests.fuzz.runner import run, try_one
from tests.fuzz.targets import TARGETS


def main() -> int:
    """Run the targets one after another; exit code 1 if something failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--target", choices=sorted(TARGETS), action="append", help="by default all of them")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=60.0, help="for all targets together")
    parser.add_argument("--index", type=int, help="repeat one input of one target, in this process and without limits")
    options = parser.parse_args()
    chosen = options.target or sorted(TARGETS)
    if options.index is not None:
        with tempfile.TemporaryDirectory() as folder:
            wrong = try_one(chosen[0], options.seed, options.index, Path(folder))
        print(wrong or "clean")
        return bool(wrong)
    failed = False
    for target in chosen:
        tried, kept = run(target, options.seed, 10**9, options.seconds / len(chosen))
        print(f"{target}: {tried} inputs, {len(kept)} kinds of failure", *kept, sep="\n  ", flush=True)
        failed = failed or bool(kept)
    return int(failed)


if __name__ == "__main__":
    raise SystemExit(main())
