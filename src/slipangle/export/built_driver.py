"""A whole driver on a library that was compiled ahead of time."""

from __future__ import annotations

import ctypes
import hashlib
import math
from collections.abc import Mapping
from pathlib import Path as FilePath
from time import perf_counter
from typing import Any

import numpy as np

from slipangle.control.commands import HINDERED, STAY, UNSURE, Commands, CompiledDriver
from slipangle.control.watch import LOST
from slipangle.errors import ConfigError, ParameterError
from slipangle.export.built_controller import Counters, output_of, plan_of
from slipangle.export.built_folder import BuiltFolder, loaded, memory, numbers, view
from slipangle.files import write_atomic
from slipangle.optimal.solution import Plan
from slipangle.paths.path import Path

PATH = "path.csv"
COLUMNS = ("s", "X", "Y", "psi", "curvature", "v_x", "right", "left")


class BuiltDriver:
    """A `Driver` on a compiled library; see `slipangle.export.load`.

    It decides as the driver that was built, and `slipangle.simulate.drive.drive` takes it as it takes that one.

    Parameters
    ----------
    built : BuiltFolder
        Where the library is.

    Raises
    ------
    ConfigError
        If the library cannot be loaded, or decides otherwise than when it was built.
    FormatError
        If its drive is none of this driver.
    """

    def __init__(self, built: BuiltFolder) -> None:
        record, self.folder, self.built = built.record, built.path, built.made
        self._names, sizes, self.name, self.dt = record["interface"], record["sizes"], record["name"], record["dt"]
        self.controls = tuple(self._names["controls"])
        self._planned, self._times = tuple(self._names["planned"]), np.array(self._names["times"])
        self._decided = tuple(self._names.get("decided", ()))
        self.path = _read_path(built)
        self._library = library = built.library()
        self._start, self._step, self._plan = (getattr(library, f"{self.name}_{n}") for n in _FUNCTIONS)
        self._start.argtypes, self._step.argtypes = [ctypes.c_void_p, ctypes.c_size_t], [ctypes.c_void_p] * 3
        self._plan.argtypes, self._plan.restype = [ctypes.c_void_p], ctypes.POINTER(output_of(sizes["planner"]))
        self._told, self._out = _measurements(self._names)(), _commands(self._names)()
        self._values, self._memory = view(self._told, "value"), memory(sizes["BYTES"])
        self._test(built)

    def __reduce__(self) -> Any:
        return loaded, (type(self), self.folder)

    def _test(self, built: BuiltFolder) -> None:
        """Repeat the beginning of the recorded drive."""
        self.reset()
        n = len(self.controls)
        for row in built.drive(1 + len(self._values) + n):
            self._told.t, self._values[...] = row[0], row[1:-n]
            self._step(self._memory.ctypes.data, ctypes.byref(self._told), ctypes.byref(self._out))
            built.check_repeated(view(self._out, "value"), row[-n:])
        self.reset()

    def reset(self) -> None:
        """Forget the drive so far; the next call of `step` begins another.

        Raises ConfigError if the library refuses its memory.
        """
        self._begin(self._memory)
        self._said, self._last = b"", None

    def step(self, measurements: Mapping[str, float], t: float) -> Commands:
        """As `slipangle.control.driver.Driver.step`.

        Raises ParameterError if the time is not finite, beyond 1e10 s, or goes back; no measurement is an error.

        Parameters
        ----------
        measurements : mapping of str to float
            Channels that are new at this call, SI units.
        t : float
            Time of the call. [s]
        """
        begin = perf_counter()
        self._told.t = t
        self._values[...] = [measurements.get(n, math.nan) for n in self._names["channels"]]
        if self._step(self._memory.ctypes.data, ctypes.byref(self._told), ctypes.byref(self._out)):
            raise ParameterError(f"t is {t:g} s; expected finite times that do not go back")
        said = bytes(self._out)
        if self._last is None or said != self._said:
            self._said, self._last = said, self._commands(perf_counter() - begin)
        return self._last

    @property
    def compiled(self) -> CompiledDriver:
        """How a loop in C calls it."""
        kind, made = type(self._out), self._plan.restype._type_
        decide, last_plan = (ctypes.cast(f, ctypes.c_void_p).value or 0 for f in (self._step, self._plan))
        return CompiledDriver(
            decide=decide,
            last_plan=last_plan,
            memory=self._memory.ctypes.data,
            channels=tuple(self._names["channels"]),
            commands=np.dtype(kind),
            plan_bytes=ctypes.sizeof(made),
            plan=lambda told, seconds: self._said_plan(made.from_buffer_copy(told), seconds),
            begin=self._memories,
        )

    def _memories(self, n: int) -> np.ndarray:
        """Of so many drivers at their start, shape (n, n_bytes), each from a multiple of 64 on."""
        size = -(-self._memory.nbytes // 64) * 64
        many = memory(n * size)[: n * size].reshape(n, size)
        for one in many:
            self._begin(one)
        return many

    def _begin(self, one: np.ndarray) -> None:
        code = self._start(one.ctypes.data, one.nbytes)
        if code:
            raise ConfigError(f"the library of '{self.folder}' refuses its memory (code {code}): build it again")

    def _said_plan(self, said: ctypes.Structure, seconds: float) -> Plan:
        return plan_of(said, self._planned, self._times, seconds, None, self._decided)

    def _commands(self, seconds: float) -> Commands:
        out, names = self._out, self._names
        plan = None
        if out.planned:
            made = self._plan(self._memory.ctypes.data).contents
            plan = self._said_plan(made, seconds)
        if 0 < out.reason < LOST:
            message = f"{HINDERED[out.reason]}, {STAY}"
        else:
            message = UNSURE[out.reason - LOST] if out.reason or plan is None else plan.message
        age = zip(names["outputs"], view(out, "age").tolist(), strict=True)
        return Commands(
            values=dict(zip(self.controls, view(out, "value").tolist(), strict=True)),
            wanted_v_x=out.wanted_v_x,
            plan=plan,
            message=message,
            s=out.s,
            e_y=out.e_y,
            state=view(out, "state").copy(),
            state_std=view(out, "state_std").copy(),
            age={n: v for n, v in age if not math.isnan(v)},
            restarts=out.restarts,
        )


_FUNCTIONS = ("start", "step", "last_plan")


def _measurements(names: Mapping[str, Any]) -> type[ctypes.Structure]:
    """``NAME_measurements`` of the header."""
    fields = [("t", ctypes.c_double), ("value", numbers(len(names["channels"])))]
    return type("Measurements", (ctypes.Structure,), {"_fields_": fields})


def _commands(names: Mapping[str, Any]) -> type[ctypes.Structure]:
    """``NAME_commands`` of the header."""
    states = numbers(len(names["states"]))
    fields = [("value", numbers(len(names["controls"]))), *((k, ctypes.c_double) for k in ("wanted_v_x", "s", "e_y"))]
    fields += [("state", states), ("state_std", states), ("age", numbers(len(names["outputs"])))]
    fields += [("restarts", ctypes.c_int64)]
    fields += [(k, ctypes.c_int) for k in ("reason", "planned", "status", "plan_age", "stopping")]
    return type("Commands", (ctypes.Structure,), {"_fields_": [*fields, ("health", Counters)]})


def keep_path(path: Path, folder: FilePath) -> dict[str, Any]:
    """Write the path beside the library, to the last bit; what the manifest says of it."""
    columns = [n for n in COLUMNS if getattr(path, n) is not None]
    rows = np.column_stack([getattr(path, n) for n in columns]).tolist()
    text = "\n".join([",".join(columns), *(",".join(map(repr, row)) for row in rows), ""])
    write_atomic(folder / PATH, text)
    sum_ = hashlib.sha256((folder / PATH).read_bytes()).hexdigest()
    return {"files": {PATH: sum_}, "path": {"name": path.name, "closed": path.closed}}


def _read_path(built: BuiltFolder) -> Path:
    with (built.path / PATH).open(encoding="utf-8") as file:
        columns = file.readline().strip().split(",")
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
    known: dict[str, Any] = dict(zip(columns, rows.T, strict=True))
    return Path(**known, **built.made["path"])
