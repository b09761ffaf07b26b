"""Combinations of machines: every pair of settings of different kinds occurs in one of them."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

KERNELS = ("Haswell", "Nehalem", "SkylakeX", "Sandybridge", "Zen")
_NEEDS = {  # what a processor must know for a kernel of OpenBLAS or XLA
    "Nehalem": "sse4_2",
    "Sandybridge": "avx",
    "Haswell": "avx2",
    "Zen": "avx2",
    "SkylakeX": "avx512vl",
    "SSE4_2": "sse4_2",
    "AVX2": "avx2",
}


@dataclass(frozen=True)
class Combination:
    """One machine; the one without a kernel is this machine as it is."""

    kernel: str = ""
    threads: int = 1
    xla: str = ""
    c: str = "native"

    def __str__(self) -> str:
        if not self.kernel:
            return "this machine"
        return f"{self.kernel}, {self.threads} thread{'s' * (self.threads > 1)}, XLA {self.xla}, C {self.c}"

    def environment(self) -> dict[str, str]:
        """Environment of a process on it."""
        env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            env[name] = str(self.threads)
        if not self.kernel:
            return env
        env["OPENBLAS_CORETYPE"] = self.kernel
        flags = [f"--xla_cpu_max_isa={self.xla}"]
        flags += ["--xla_cpu_multi_thread_eigen=false"] if self.threads == 1 else []
        env["XLA_FLAGS"] = " ".join([env.get("XLA_FLAGS", ""), *flags]).strip()
        if self.c == "none":
            env["SLIPANGLE_CC"] = "none"
        if self.c == "portable":
            env["SLIPANGLE_CFLAGS"] = "-O3"
        return env

    def possible(self) -> bool:
        """Whether this processor has the instructions."""
        known = _flags()
        return not known or all(_NEEDS[name] in known for name in (self.kernel, self.xla) if name)


def design() -> list[Combination]:
    """All pairs of settings of two kinds in fifteen combinations; every single setting in the first five."""
    code = ("portable", "none", "native")
    found = []
    for turn in range(3):
        for i, kernel in enumerate(KERNELS):
            threads = 1 + (i + turn) % 2
            xla = ("SSE4_2", "AVX2")[(i // 2 + turn + (turn == 2) * i) % 2]
            found.append(Combination(kernel, threads, xla, code[(i + turn) % 3]))
    return found


def _flags() -> set[str]:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(errors="replace").splitlines() if info.is_file() else []
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())
