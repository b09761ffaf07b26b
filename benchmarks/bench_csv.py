"""Reading a large CSV: megabytes per second and peak memory, beside pandas.

A log of 21 columns at 100 Hz with empty cells; four of them and the time are asked for. Each reader has a process of
its own; peak memory is what it takes beyond its imports and a small file, over that of the columns chosen (8 bytes a
number). Processor seconds are those of all threads, so that a busy machine says the same.

Run with ``python benchmarks/bench_csv.py [MEGABYTES]`` (default 200).
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

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
small = PATH + '.small.csv'
large, PATH = PATH, small
read()
PATH = large
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
wall, cpu = time.perf_counter(), time.process_time()
data = read()
wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
print(wall, cpu, 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before), len(data))
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


def main(megabytes: float) -> None:
    """Print a line for each reader."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_log(Path(folder) / "log.csv", int(megabytes * 1e6 / 195))
        write_log(Path(f"{path}.small.csv"), 30_000)
        size = path.stat().st_size
        print(f"{size / 1e6:.0f} MB, {len(CHOSEN) + 1} of 21 columns")
        for name, how in _READERS.items():
            call = [sys.executable, "-c", _MEASURE.format(chosen=list(CHOSEN), how=how), str(path)]
            wall, cpu, peak, rows = map(float, subprocess.check_output(call, text=True).split())
            chosen = 8 * rows * (len(CHOSEN) + 1)
            print(
                f"{name:24} {size / 1e6 / wall:7.0f} MB/s   {size / 1e6 / cpu:7.0f} MB per processor second   "
                f"peak {peak / 1e6:6.0f} MB, {peak / chosen:5.2f} x the columns"
            )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 200.0)
