"""A closed loop without Python in it: plant and driver are compiled, and so is what is between them."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from slipangle.codegen.compiler import library
from slipangle.codegen.struct import clock
from slipangle.control.commands import CompiledDriver
from slipangle.errors import ConfigError, ParameterError
from slipangle.optimal.solution import Plan
from slipangle.paths.line import FLAGS
from slipangle.simulate.plant import Plant, Simulation
from slipangle.simulate.run import End
from slipangle.simulate.sensors import Stream

CHUNK = 500  # samples between looks from Python
ENDS = (None, End.FINISHED, End.TIME, End.LEFT_PATH, End.NOT_FINITE)
HELD, WANTED = -1, -2  # what an input is that is none of the commands
KEPT, GAP, SKIPPED = 0, 1, 2  # what becomes of a sample


class _Stream(ctypes.Structure):
    """``Stream`` of loop.c."""

    _fields_ = [
        *((n, ctypes.c_long) for n in ("of", "every", "late", "next", "room", "first", "waiting")),
        *((n, ctypes.c_double) for n in ("gain", "bias", "quantum", "low", "high", "shown")),
        *((n, ctypes.c_void_p) for n in ("error", "lost", "values", "arrivals")),
    ]


class _Loop(ctypes.Structure):
    """``Loop`` of loop.c."""

    _fields_ = [
        *((n, ctypes.c_void_p) for n in ("step", "x")),
        *((n, ctypes.c_long) for n in ("n_states", "n_inputs", "steps", "most_late")),
        *((n, ctypes.c_void_p) for n in ("late", "share", "past", "moved", "states")),
        *((n, ctypes.c_long) for n in ("n_streams", "tick")),
        *((n, ctypes.c_void_p) for n in ("streams", "grid", "size", "shape", "judged")),
        *((n, ctypes.c_double) for n in ("place", "sample", "limit")),
        ("to_the_end", ctypes.c_long),
        *((n, ctypes.c_void_p) for n in ("decide", "last_plan", "memory")),
        *((n, ctypes.c_long) for n in ("n_channels", "plan_bytes", "commands_bytes", "wanted", "planned", "begun")),
        *((n, ctypes.c_void_p) for n in ("channels", "sensors", "std", "told", "said", "before", "command", "held")),
        *((n, ctypes.c_void_p) for n in ("noise", "rows", "plans", "seconds", "planned_at")),
        *((n, ctypes.c_long) for n in ("n_rows", "n_plans")),
    ]


def compiled_loop(plant: Plant, driver: Any, channels: Sequence[str] | None) -> CompiledLoop | None:
    """The loop of this plant and this driver, if both are compiled and the driver asks for states and inputs only."""
    called: CompiledDriver | None = getattr(driver, "compiled", None)
    kernel, line = getattr(plant.model, "steps", None), driver.path.line
    if called is None or kernel is None or line is None:
        return None
    known = (*plant.model.states, *plant.model.inputs)
    asked = [n for n in called.channels if n in plant.channels and (channels is None or n in channels)]
    if not {*asked, *plant.sensors, "X", "Y", "psi", "v_x"} <= set(known):
        return None
    loaded = _library()
    return None if loaded is None else CompiledLoop(loaded, plant, driver, called, asked)


def source() -> str:
    """C of the loop, for any plant and driver."""
    texts = [files(f"slipangle.{room}") / name for room, name in (("paths", "line.c"), ("simulate", "loop.c"))]
    return "\n".join([clock(), *(t.read_text(encoding="utf-8") for t in texts)])


def _library() -> ctypes.CDLL | None:
    """Of the loop; None without a compiler."""
    return library(source(), name="loop", flags=FLAGS)


class CompiledLoop:
    """What `slipangle.simulate.drive.drive` runs where plant and driver are compiled; `compiled_loop` makes it.

    Parameters
    ----------
    loaded : CDLL
        Of loop.c.
    plant, driver
        As of `drive`.
    called : CompiledDriver
        How the driver is called.
    asked : sequence of str
        What it is told of the plant's measurements.
    """

    def __init__(
        self, loaded: ctypes.CDLL, plant: Plant, driver: Any, called: CompiledDriver, asked: Sequence[str]
    ) -> None:
        self._run, self._plant, self._driver, self._called = loaded.loop_drive, plant, driver, called
        self._asked = set(asked)
        self._names = (*plant.model.states, *plant.model.inputs)
        self._arrays: dict[str, np.ndarray] = {}

    def __call__(
        self,
        simulation: Simulation,
        held: Mapping[str, float],
        per_sample: int,
        *,
        sample: float,
        limit: float,
        to_the_end: bool,
    ) -> tuple[np.ndarray, tuple[list[float], list[Plan]], End]:
        """Drive until the end; rows as `drive` keeps them, times and plans, why it is over.

        ``held`` are inputs that the driver does not set, ``to_the_end`` whether the end of the path ends the drive.

        Raises ParameterError if the driver refuses a time.
        """
        loop, streams = self._begin(simulation, held, per_sample), list(simulation._streams.values())
        loop.sample, loop.limit, loop.to_the_end = sample, limit, to_the_end
        noisy = [(n, std, draws) for n, std, draws in simulation._noise if n in self._asked]
        rows, times, plans, code = [], [], [], 0
        while code == 0:
            for name, _, draws in noisy:
                column = self._called.channels.index(name)
                self._arrays["noise"][:, column] = np.fromiter(draws, float, CHUNK)
            errors = [_drawn(s, loop.tick, CHUNK, per_sample) for s in streams]
            for at, (error, lost) in enumerate(errors):
                self._streams[at].error, self._streams[at].lost = error.ctypes.data, lost.ctypes.data
            code = self._run(ctypes.addressof(loop), CHUNK)
            if code >= len(ENDS):
                raise ParameterError(f"the driver refuses the time after {times[-1:]} s; expected one below 1e10 s")
            table = self._arrays["rows"][: loop.n_rows].copy()
            rows.append(table)
            for k in range(loop.n_plans):
                plans.append(self._called.plan(self._arrays["plans"][k].tobytes(), float(self._arrays["seconds"][k])))
                times.append(float(table[self._arrays["planned_at"][k], 0]))
        end = ENDS[code]
        if end is None:
            raise AssertionError
        return np.concatenate(rows), (times, plans), end

    def _begin(self, simulation: Simulation, held: Mapping[str, float], steps: int) -> _Loop:
        """The struct, with the plant as it is at the start."""
        plant, called, line = self._plant, self._called, self._driver.path.line
        model, names = plant.model, self._names
        n, m, c = model.n_states, model.n_inputs, len(called.channels)
        commands = {name: i for i, name in enumerate(self._driver.controls)}
        of = {name: commands.get(name, WANTED if name == "v_x" else HELD) for name in model.inputs}
        sensors = list(simulation._streams)
        noise = {name: std for name, std, _ in simulation._noise if name in self._asked}
        whole = {
            "late": simulation._delay,
            "judged": [names.index(name) for name in ("X", "Y", "psi", "v_x")],
            "channels": [names.index(name) if name in self._asked else -1 for name in called.channels],
            "sensors": [sensors.index(k) if k in sensors and k in self._asked else -1 for k in called.channels],
            "command": [of[name] for name in model.inputs],
            "planned_at": np.zeros(CHUNK),
        }
        real = {
            "x": simulation.state,
            "share": plant._share,
            "past": simulation._past,
            "moved": np.empty((steps, m)),
            "states": np.empty((steps, n)),
            "std": [noise.get(name, 0.0) for name in called.channels],
            "told": np.empty(1 + c),
            "held": [held.get(name, 0.0) for name in model.inputs],
            "noise": np.zeros((CHUNK, c)),
            "rows": np.empty((CHUNK, 5 + n + m)),
            "seconds": np.empty(CHUNK),
        }
        size, place = called.commands.itemsize, called.commands.fields or {}
        bytes_ = {"said": size, "before": size, "plans": (CHUNK, called.plan_bytes)}
        arrays = {k: np.array(v, dtype=ctypes.c_long) for k, v in whole.items()}
        arrays |= {k: np.array(v, dtype=float) for k, v in real.items()}
        arrays |= {k: np.zeros(v, dtype=np.uint8) for k, v in bytes_.items()}
        self._arrays, self._streams = arrays, (_Stream * len(sensors))()
        self._rings = [self._stream(at, s, steps) for at, s in enumerate(simulation._streams.values())]
        loop = _Loop(
            step=ctypes.cast(model.steps.library.drive, ctypes.c_void_p).value,
            **{k: v.ctypes.data for k, v in arrays.items()},
            **dict(zip(("grid", "shape", "size"), line.data, strict=True)),
            **{k: getattr(called, k) for k in ("decide", "last_plan", "memory", "plan_bytes")},
            **{"commands_bytes": size, "wanted": place["wanted_v_x"][1], "planned": place["planned"][1]},
            streams=ctypes.addressof(self._streams),
        )
        loop.n_states, loop.n_inputs, loop.steps, loop.n_channels = n, m, steps, c
        loop.most_late, loop.n_streams = len(simulation._past), len(sensors)
        return loop

    def _stream(self, at: int, stream: Stream, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Lay out an instrument; where its samples wait."""
        s, name = stream.sensor, list(self._plant.sensors)[at]
        room = (stream.late + steps) // stream.every + 3
        values, arrivals = np.zeros(room), np.zeros(room, dtype=ctypes.c_long)
        for k, (arrival, value) in enumerate(stream.waiting):
            values[k], arrivals[k] = value, arrival
        self._streams[at] = _Stream(
            **{"of": self._names.index(name), "every": stream.every, "late": stream.late, "room": room},
            **{"waiting": len(stream.waiting), "shown": stream.shown, "gain": s.gain, "bias": s.bias},
            **{"quantum": s.quantum, "low": s.range[0], "high": s.range[1]},
            **{"values": values.ctypes.data, "arrivals": arrivals.ctypes.data},
        )
        return values, arrivals


class Crew:
    """Copies of a compiled driver, one in each car, asked all at once.

    Raises ParameterError if the driver is not compiled, ConfigError without a compiler.

    Parameters
    ----------
    driver : AnyDriver
        One that was built.
    n : int
        How many.
    seen : sequence of str
        What the cars measure, in the order of `step`'s columns.
    """

    def __init__(self, driver: Any, n: int, seen: Sequence[str]) -> None:
        called: CompiledDriver | None = getattr(driver, "compiled", None)
        if called is None:
            raise ParameterError(f"a {type(driver).__name__} is not compiled; expected one that was built: see export")
        loaded = _library()
        if loaded is None:
            raise ConfigError(
                "many drivers at a time run in compiled code only; expected a C compiler: install it as cc"
            )
        self._ask, self._called = loaded.loop_ask, called
        self._memory = called.begin(n)
        self._told = np.full((n, 1 + len(called.channels)), np.nan)
        self._said = np.zeros(n, dtype=called.commands)
        self._columns = [(1 + called.channels.index(name), j) for j, name in enumerate(seen) if name in called.channels]

    def step(self, t: float, measured: np.ndarray, drives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Commands of all at a time [s], as the driver's C has them, and what each took, shape (n,) [s].

        Those who do not drive any more keep their commands, in no time.

        ``measured`` has a row per car, shape (n, n_seen), ``drives`` says who still does, shape (n,).

        Raises ParameterError if a driver refuses the time.
        """
        self._told[:, 0] = t
        for at, j in self._columns:
            self._told[:, at] = measured[:, j]
        memory, told, said = self._memory, self._told, self._said
        seconds = np.ascontiguousarray(drives, dtype=float)
        sizes = (memory.strides[0], told.ctypes.data, told.shape[1], said.ctypes.data, said.itemsize)
        if self._ask(self._called.decide, memory.ctypes.data, *sizes, seconds.ctypes.data, len(said)):
            raise ParameterError(f"the driver refuses the time {t:g} s; expected one below 1e10 s")
        return said, seconds


def _drawn(stream: Stream, tick: int, samples: int, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors of an instrument's samples to come, and what becomes of them, drawn in the order of a loop in Python."""
    edges = (tick + steps * np.arange(samples + 1)) // stream.every
    counts, s = np.diff(edges), stream.sensor
    n = int(edges[-1] - edges[0])
    if n == 0:
        return np.empty(0), np.empty(0, dtype=np.int8)
    if not s.drift and not (s.noise and s.drop_out):
        error, lost = stream.draw(n)
    else:
        error, lost = (np.concatenate(a) for a in zip(*(stream.draw(int(k)) for k in counts if k), strict=True))
    kind = SKIPPED if s.lost == "hold" else GAP
    return np.ascontiguousarray(error), np.where(lost, kind, KEPT).astype(np.int8)
