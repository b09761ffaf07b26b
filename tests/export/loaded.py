"""Exported C loaded into this process and called as a program in C would call it."""

import ctypes
import re

import numpy as np

from slipangle.codegen import compiler
from slipangle.optimal.realtime.backend import FLAGS
from slipangle.optimal.solution import Status

STATUSES = [
    Status[name]
    for name in "SOLVED REAL_TIME ITERATION_LIMIT STALLED TIME_OUT INFEASIBLE NOT_FINITE FAILED IMPLAUSIBLE".split()
]


def defines(header, prefix="CAR"):
    """Whole numbers that a header defines."""
    return {k: int(v) for k, v in re.findall(rf"^#define {prefix}_(\w+) (\d+)\b", header, re.MULTILINE)}


def as_one(files, name="car"):
    """The project's C as one source without headers of its own."""
    return files[f"{name}.c"].replace(f'#include "{name}.h"\n', files[f"{name}.h"])


def array(*lengths, kind=ctypes.c_double):
    """Type of an array of numbers."""
    for length in reversed(lengths):
        kind = kind * length
    return kind


of_kind = array
HEALTH = [
    (k, ctypes.c_int64) for k in ("plans", "fallbacks", "in_a_row", "overruns", "overruns_in_a_row", "begun_anew")
]
Health = type("Health", (ctypes.Structure,), {"_fields_": HEALTH})


def given_and_made(n, kind=ctypes.c_double):
    """The structs ``car_input`` and ``car_output`` of a controller with these sizes, of this type of numbers."""

    def array(*lengths):
        return of_kind(*lengths, kind=kind)

    given = [("x", array(n["STATES"]))]
    if n["REFERENCES"]:
        given.append(("tracked", array(n["NODES"], n["REFERENCES"])))
    if n["EXOGENOUS"]:
        given.append(("exogenous", array(n["EXOGENOUS_ROWS"], n["EXOGENOUS"])))
    if n["CORRIDOR"]:
        given.append(("corridor", array(n["NODES"], 2)))
    given += [("inputs", array(n["HORIZON"], n["CONTROLS"])), ("applied", array(n["CONTROLS"]))]
    made = [("command", array(n["CONTROLS"])), ("u", array(n["HORIZON"], n["CONTROLS"]))]
    made += [("x", array(n["NODES"], n["STATES"]))]
    if n.get("DECIDED"):
        made.append(("decided", array(n["DECIDED"])))
    made += [(k, kind) for k in ("cost", "residual", "violation", "seconds")]
    made += [(k, ctypes.c_int) for k in ("status", "age", "stopping", "iterations", "begun_anew")]
    if n.get("SWITCHES"):
        made += [("demand", kind), ("active", ctypes.c_int)]
    if n.get("LEARNS"):
        made += [("lesson", ctypes.c_int), ("samples", ctypes.c_int64)]
    given, made = [*given, ("applied_known", ctypes.c_int)], [*made, ("health", Health)]
    return [type(n, (ctypes.Structure,), {"_fields_": f}) for n, f in (("Input", given), ("Output", made))]


class Loaded:
    """A controller exported under the name ``car``."""

    def __init__(self, files, flags=FLAGS, kind=ctypes.c_double):
        self.size = n = defines(files["car.h"])
        self.Input, self.Output = given_and_made(n, kind)
        self.library = self.compiled(files, flags)
        self.library.car_plan.argtypes = [ctypes.c_void_p] * 3
        self.library.car_start.argtypes = [ctypes.c_void_p, ctypes.c_size_t]
        self.library.car_deadline.argtypes = [
            ctypes.c_void_p,
            ctypes.c_int,
            ctypes.c_double,
            ctypes.c_void_p,
            ctypes.c_void_p,
        ]
        self.bytes = max(int(b) for b in re.findall(r"#define CAR_BYTES (\d+)", files["car.h"])) + self.more(files)
        raw = np.zeros(self.bytes + 64, dtype=np.uint8)
        self.memory = raw[-raw.ctypes.data % 64 :]
        assert self.start() == 0

    @staticmethod
    def more(files):
        """Bytes of memory beside the controller's own."""
        return 0

    def compiled(self, files, flags):
        """The library of the files."""
        return compiler.library(as_one(files), name="exported", flags=flags)

    def start(self, bytes_=None, offset=0):
        return self.library.car_start(self.memory.ctypes.data + offset, self.bytes if bytes_ is None else bytes_)

    def limit(self, iterations, seconds=0.0, clock=None):
        self.library.car_deadline(self.memory.ctypes.data, iterations, seconds, clock, None)

    def plan(self, x, reference, applied=None):
        given, out = self.Input(), self.Output()
        pairs = {"x": x, "tracked": reference.tracked, "corridor": reference.corridor, "inputs": reference.inputs}
        w = reference.exogenous
        pairs["exogenous"] = w if len(w) >= self.size["EXOGENOUS_ROWS"] else np.vstack([w, w[-1:]])
        pairs["applied"] = applied
        given.applied_known = applied is not None
        for key, value in pairs.items():
            if value is not None and hasattr(given, key):
                np.ctypeslib.as_array(getattr(given, key))[...] = value[: len(getattr(given, key))]
        code = self.library.car_plan(self.memory.ctypes.data, ctypes.byref(given), ctypes.byref(out))
        assert code == out.status
        return out


def same(out, plan):
    """Whether what C decided is the plan, to the last bit."""
    return (
        STATUSES[out.status] is plan.status
        and (out.age, bool(out.stopping), out.iterations) == (plan.age, plan.stopping, plan.iterations)
        and np.array_equal(np.array(out.command), plan.command)
        and np.array_equal(np.array(out.u), plan.u)
        and np.array_equal(np.array(out.x), plan.x)
        and tuple(getattr(out.health, name) for name, _ in out.health._fields_) == tuple(plan.health)
        and np.array_equal(
            [out.cost, out.residual, out.violation], [plan.cost, plan.residual, plan.violation], equal_nan=True
        )
    )
