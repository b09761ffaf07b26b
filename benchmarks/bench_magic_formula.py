"""Speed of the Magic Formula 6.1, combined slip, all five outputs: NumPy beside C compiled from the same symbols.

    python benchmarks/bench_magic_formula.py [FILE.tir]

Without a file a tire with every coefficient of 6.1 set is used. One thread throughout; each number is the median
over repeated batches, with the 99th percentile of the batch times beside it. No peer stands
beside it: none that evaluates Magic Formula 6.1 files was found on PyPI (MFeval and the Magic Formula Tyre Library
are for MATLAB).
"""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import casadi as ca
import numpy as np

from slipangle.models.magic_formula import MagicFormulaTire
from slipangle.models.mf_coefficients import MF61Coefficients

BATCH = 100_000
REPEATS = 40
OPTIONS = {
    "C, scalar": ["-O3", "-march=native", "-fno-math-errno"],
    "C, vector math": ["-O3", "-march=native", "-ffast-math", "-fopenmp-simd"],
}


def full_tire() -> MagicFormulaTire:
    """A tire with no coefficient at zero, so that no branch of the equations is left out."""
    known = dict(
        FNOMIN=5000.0, UNLOADED_RADIUS=0.32, INFLPRES=230e3, NOMPRES=220e3, PCX1=1.6, PDX1=1.15, PKX1=24.0, PCY1=1.45,
        PDY1=1.05, PKY1=-25.0, PKY2=2.2, PKY4=2.1, PKY5=1.0, QCZ1=1.2, QBZ1=11.0, QDZ1=0.09, QEZ1=-2.0, RBX1=13.0,
        RBY1=12.0, RCX1=1.0, RCY1=1.0, QSY1=0.01, QSY7=0.9,
    )  # fmt: skip
    small = {
        f.name: 0.01
        for f in fields(MF61Coefficients)
        if re.fullmatch(r"[PQRS][A-Z]{2}[XYZ]?\d+|[PQRS][A-Z]+\d+", f.name) and f.name not in known
    }
    return MagicFormulaTire(coefficients=MF61Coefficients(**{**small, **known}))


def inputs(tire: MagicFormulaTire, n: int) -> list[np.ndarray]:
    """Random slip, load and camber inside the range of the tire."""
    rng = np.random.default_rng(0)
    low, high = tire.limits.load
    load = (max(low, 300.0), min(high, 2 * tire.coefficients.FNOMIN))
    return [
        rng.uniform(-0.25, 0.25, n),
        rng.uniform(-0.25, 0.25, n),
        rng.uniform(*load, n),
        rng.uniform(-0.08, 0.08, n),
    ]


def compiled(tire: MagicFormulaTire, flags: list[str], folder: Path) -> Callable[..., None]:
    """The forces of the tire as a C loop over samples, generated from the CasADi expression."""
    symbols = [ca.SX.sym(name) for name in ("s", "alpha", "load", "camber")]
    forces = tire.forces(*symbols[:3], camber=symbols[3])
    expression = ca.cse(ca.vertcat(*forces))
    generator = ca.CodeGenerator("forces.c")
    generator.add(ca.Function("forces", symbols, ca.vertsplit(expression)))
    source = generator.dump()
    start = source.index("static int casadi_f0(")
    body = source[source.index("{", start) + 1 : source.index("return 0;", start)]
    body = re.sub(r"arg\[(\d)\]\? arg\[\d\]\[0\] : 0", r"in\1[i]", body)
    body = re.sub(r"if \(res\[(\d)\]!=0\) res\[\d\]\[0\]=", r"out\1[i]=", body)
    names = [f"const double* restrict in{i}" for i in range(4)] + [f"double* restrict out{i}" for i in range(5)]
    loop = f"""#include <math.h>
#define casadi_real double
static inline double casadi_sq(double x) {{ return x * x; }}
static inline double casadi_fabs(double x) {{ return fabs(x); }}
static inline double casadi_fmin(double x, double y) {{ return x < y ? x : y; }}
static inline double casadi_fmax(double x, double y) {{ return x > y ? x : y; }}
static inline double casadi_sign(double x) {{ return (double)(x > 0) - (double)(x < 0); }}
void run(long n, {", ".join(names)}) {{
#pragma omp simd
  for (long i = 0; i < n; ++i) {{ {body} }}
}}
"""
    code, library = folder / "forces.c", folder / f"forces{abs(hash(tuple(flags)))}.so"
    code.write_text(loop)
    compiler = shutil.which("cc") or sys.exit("no C compiler (cc) found")
    subprocess.run([compiler, *flags, "-shared", "-fPIC", str(code), "-o", str(library), "-lm"], check=True)
    run = ctypes.CDLL(str(library)).run

    def call(args: list[np.ndarray], out: list[np.ndarray]) -> None:
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*args, *out)]
        run(ctypes.c_long(len(args[0])), *pointers)

    return call


def timed(call: Callable[[], object]) -> tuple[float, float]:
    """Median and 99th percentile of the time of a batch. [s]"""
    for _ in range(3):
        call()
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds)), float(np.percentile(seconds, 99))


def main() -> None:
    file = sys.argv[1] if len(sys.argv) > 1 else ""
    tire = MagicFormulaTire.from_tir(file) if file else full_tire()
    args = inputs(tire, BATCH)
    reference = tire.forces(*args[:3], camber=args[3])
    print(
        f"Magic Formula 6.1, combined slip, F_x F_y M_x M_y M_z, {BATCH} samples a batch, {REPEATS} batches, 1 thread"
    )
    print(f"{'':16}{'M/s (median)':>14}{'ms median':>12}{'ms p99':>10}   largest difference from NumPy")
    median, p99 = timed(lambda: tire.forces(*args[:3], camber=args[3]))
    print(f"{'NumPy':16}{BATCH / median / 1e6:14.2f}{median * 1e3:12.2f}{p99 * 1e3:10.2f}")
    with tempfile.TemporaryDirectory() as folder:
        for label, flags in OPTIONS.items():
            out = [np.empty(BATCH) for _ in range(5)]
            call = compiled(tire, flags, Path(folder))
            median, p99 = timed(lambda call=call, out=out: call(args, out))
            error = max(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in zip(out, reference, strict=True))
            print(f"{label:16}{BATCH / median / 1e6:14.2f}{median * 1e3:12.2f}{p99 * 1e3:10.2f}   {error:.1e}")


if __name__ == "__main__":
    main()
