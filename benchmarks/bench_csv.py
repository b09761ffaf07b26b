"""Reading a large CSV: megabytes per second and peak memory, beside pandas.

A log of 21 columns at 100 Hz with empty cells; four of them and the time are asked for. Each reader has a process of
its own; peak memory is what it takes beyond its imports and a small file, over that of the columns chosen (8 bytes a
number). Processor seconds are those of all threads, so that a busy machine says the same.

Another size of file: ``python benchmarks/bench_csv.py MEGABYTES``.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

CHOSEN = ("c0", "c1", "c2", "c3")
_OURS = "read = lambda: sa.read(PATH, CHOSEN, nan='gap')"
_READERS = {
    "slipangle, pyarrow": f"import slipangle as sa, pyarrow.csv; sa.read\n{_OURS}",
    "slipangle, NumPy alone": "import sys; sys.modules['pyarrow'] = sys.modules['pyarrow.csv'] = None\n"
    f"import slipangle as sa; sa.read\n{_OURS}",
    "pandas": "import pandas\nread = lambda: pandas.read_csv(PATH, usecols=['t', *CHOSEN])",
}
_MEASURE = """
import resource, sys, time
PATH, CHOSEN = sys.argv[1], {chosen!r}
{how}
def peak():  # of this program's own; what a process reports of itself includes what its parent had when it began
    try:
        return 1024 * next(int(line.split()[1]) for line in open('/proc/self/status') if line.startswith('VmHWM'))
    except (OSError, StopIteration):
        return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
small = PATH + '.small.csv'
large, PATH = PATH, small
read()
PATH = large
before = peak()
wall, cpu = time.perf_counter(), time.process_time()
data = read()
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
print(wall, cpu, peak() - before, len(data))
"""


def write_log(path: Path, rows: int) -> Path:
    """A log of this many rows. Seed 0."""
    rng = np.random.default_rng(0)
    with path.open("w") as file:
        file.write(",".join(["t", *(f"c{k}" for k in range(20))]) + "\n")
        for start in range(0, rows, 50_000):
            count = min(50_000, rows - start)
            t = 0.01 * np.arange(start, start + count)
            waves = np.sin(t[:, None] * (0.1 + 0.05 * np.arange(20))) + 0.01 * rng.normal(size=(count, 20))
            block = np.column_stack([t, waves])
            lines = [("%.2f" + ",%.6f" * 20) % tuple(row) for row in block.tolist()]
            cells = lines[count // 2].split(",")
            lines[count // 2] = ",".join([*cells[:3], "", *cells[4:]])  # an empty cell
            file.write("\n".join(lines) + "\n")
    return path


def measured(path: Path, how: str) -> tuple[float, float, float]:
    """Megabytes per second by the clock and per processor second, and peak memory over the columns."""
    call = [sys.executable, "-c", _MEASURE.format(chosen=list(CHOSEN), how=how), str(path)]
    wall, cpu, peak, rows = map(float, subprocess.check_output(call, text=True).split())
    size = path.stat().st_size / 1e6
    return size / wall, size / cpu, peak / (8 * rows * (len(CHOSEN) + 1))


def bench(progress: Progress, megabytes: float = 200.0) -> Reproduction:
    """Every reader on one file; see the module."""
    records = []
    with tempfile.TemporaryDirectory() as folder:
        path = write_log(Path(folder) / "log.csv", int(megabytes * 1e6 / 195))
        write_log(Path(f"{path}.small.csv"), 30_000)
        for k, (name, how) in enumerate(_READERS.items()):
            progress((k + 1) / (len(_READERS) + 1), name)
            if name == "pandas" and find_spec("pandas") is None:
                records.append(Record(name, "speed [MB/s]", None, "not run", note="pandas is not installed"))
                continue
            fast = {"at_least": 200.0} if name == "slipangle, pyarrow" else {}
            lean = {"at_most": 2.5} if name != "pandas" else {}
            by_clock, by_work, peak = measured(path, how)
            records += [
                Record.judged(name, "speed [MB/s]", None, by_clock, **fast),
                Record.judged(name, "work [MB per processor second]", None, by_work),
                Record.judged(name, "peak memory over the columns", None, peak, **lean),
            ]
    return Reproduction.told(__doc__, records)


if __name__ == "__main__":
    from slipangle.report.records import record_table

    size = float(sys.argv[1]) if len(sys.argv) > 1 else 200.0
    outcome = bench(lambda share, what: print(f"{share:5.1%} {what}", file=sys.stderr), size)
    print(record_table(outcome.records, title=outcome.title).to_text())
