"""Speed of the Magic Formula 6.1, combined slip, all five outputs: NumPy beside C compiled from the same symbols.

The tire has every coefficient of 6.1 set, so that no branch of the equations is left out. No peer stands beside it:
none that evaluates Magic Formula 6.1 files was found among Python packages (MFeval and the Magic Formula Tyre Library
are for MATLAB).
"""

from __future__ import annotations

import ctypes
import re
import time
from collections.abc import Callable
from dataclasses import fields

import casadi as ca
import numpy as np

from slipangle.codegen.compiler import library, sentence
from slipangle.models.tires.magic_formula.coefficients import MF61Coefficients
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.report.records import Record
from slipangle.reproduce import Progress, Reproduction

BATCH, ROUNDS = 100_000, 40
LEAST = {"NumPy": 0.5, "C, scalar": 2.0, "C, vector math": 2.0}  # million evaluations per second
FLAGS = {"C, scalar": ("-fno-math-errno",), "C, vector math": ("-ffast-math", "-fopenmp-simd")}


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


def source(tire: MagicFormulaTire) -> str:
    """C loop over samples, generated from the CasADi expression of the forces."""
    symbols = [ca.SX.sym(name) for name in ("s", "alpha", "load", "camber")]
    forces = tire.forces(*symbols[:3], camber=symbols[3])
    expression = ca.cse(ca.vertcat(*forces))
    generator = ca.CodeGenerator("forces.c")
    generator.add(ca.Function("forces", symbols, ca.vertsplit(expression)))
    text = generator.dump()
    start = text.index("static int casadi_f0(")
    body = text[text.index("{", start) + 1 : text.index("return 0;", start)]
    body = re.sub(r"arg\[(\d)\]\? arg\[\d\]\[0\] : 0", r"in\1[i]", body)
    body = re.sub(r"if \(res\[(\d)\]!=0\) res\[\d\]\[0\]=", r"out\1[i]=", body)
    names = [f"const double* restrict in{i}" for i in range(4)] + [f"double* restrict out{i}" for i in range(5)]
    return f"""#include <math.h>
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


def caller(run: Callable[..., None], args: list[np.ndarray], out: list[np.ndarray]) -> Callable[[], None]:
    """The compiled loop, bound to its arrays."""
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (*args, *out)]
    return lambda: run(ctypes.c_long(len(args[0])), *pointers)


def bench(progress: Progress) -> Reproduction:
    """Evaluations per second, in turn."""
    tire = full_tire()
    args = inputs(tire, BATCH)
    reference = tire.forces(*args[:3], camber=args[3])
    outputs = {name: [np.empty(BATCH) for _ in range(5)] for name in FLAGS}
    runs: dict[str, Callable[[], object]] = {"NumPy": lambda: tire.forces(*args[:3], camber=args[3])}
    for name, flags in FLAGS.items():
        loaded = library(source(tire), name="bench-magic-formula", flags=flags)
        if loaded is not None:
            runs[name] = caller(loaded.run, args, outputs[name])
    spent: dict[str, list[float]] = {name: [] for name in runs}
    for i in range(-2, ROUNDS):
        for name, run in runs.items():
            progress(max(i, 0) / ROUNDS, f"{name}, round {i + 1}")
            began = time.process_time()
            run()
            if i >= 0:
                spent[name].append((time.process_time() - began) / BATCH)
    records = []
    for name, least in LEAST.items():
        if name not in runs:
            records.append(Record(row=name, quantity="evaluations [M/s]", thesis=None, here="not run", note=sentence()))
            continue
        rate = 1e-6 / float(np.median(spent[name]))
        records.append(
            Record(
                row=name,
                quantity="evaluations [M/s], median",
                thesis=None,
                here=rate,
                bound=f">= {least:g}",
                holds=rate >= least,
                note=f"p99 {1e-6 / float(np.percentile(spent[name], 99)):.3g} M/s",
            )
        )
        if name in FLAGS:
            pairs = zip(outputs[name], reference, strict=True)
            gap = max(float(np.max(np.abs(a - b)) / np.max(np.abs(b))) for a, b in pairs)
            records.append(
                Record(
                    row=name,
                    quantity="largest difference from NumPy over the largest value",
                    thesis=None,
                    here=gap,
                    bound="<= 1e-12",
                    holds=gap <= 1e-12,
                )
            )
    return Reproduction(
        title="Magic Formula 6.1, combined slip, F_x F_y M_x M_y M_z",
        records=tuple(records),
        protocol=f"{BATCH} random samples of slip, load and camber a batch, {ROUNDS} batches in turn, process time, "
        "one thread.",
    )
