"""A closed loop as WebAssembly: plant, controller, path and speed law in one small program that a web page drives.

`Live` is the loop of `slipangle.simulate.loop.closed_loop` with settings that a reader may change; `Live.wasm` compiles
it with the ``ziglang`` package, `Live.loop` is the same drive for Python.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path as FilePath
from typing import Any

import casadi as ca
import numpy as np

from slipangle.codegen import cache as code_cache
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.export.controllers import table
from slipangle.export.drivers import path_tables
from slipangle.export.drives import NO_DRIVE
from slipangle.export.joined import has_parts
from slipangle.export.loops import path_source
from slipangle.export.models import sourced, step_function
from slipangle.export.mpc import mpc_project
from slipangle.export.project import template
from slipangle.models.wrappers.on_ground import POSE
from slipangle.numerics.integrate import discretise
from slipangle.optimal.terms import Values, Weights
from slipangle.paths.path import Path
from slipangle.simulate.plant import Plant

SAMPLE = 0.01  # s, between samples of the result and steps of the speed law, as `closed_loop` has it
LONGEST = 60.0  # s of driving; a longer one does not answer at once
MOST_BYTES = 400_000  # of WebAssembly
MOST_LETTERS = 6 * MOST_BYTES  # of C; three to five make a byte
LATEST = 0.3  # s of steering delay at most
_PLACES = {"pace": 0, "friction": 1, "delay": 2, "mass": 3}  # of settings, before the weights
_FLAGS = ("-target", "wasm32-wasi", "-mexec-model=reactor", "-Os", "-msimd128", "-std=gnu11", "-fno-sanitize=undefined")
_INCLUDES = '#include "car.h"\n#include <math.h>\n#include <string.h>'
_EXPORTED = ("settings", "rows", "commands", "predicted", "count", "plans", "age", "begin", "plan", "go")


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What a reader may change: its value now, and between what."""

    name: str
    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Live:
    """A loop that drives elsewhere; without noise, as a reader wants to see what a setting does and nothing else.

    Parameters
    ----------
    plant : Plant
        Noise and sensors of it do not count.
    mpc : MPC
        Steers, solved in real time.
    path : Path
        Open, with a speed profile.
    driver : SpeedDriver
        Holds the speed, with gains that do not depend on it.

    Raises
    ------
    ParameterError
        If a part of the loop has no place in the page; the sentence says which.
    """

    plant: Plant
    mpc: MPC
    path: Path
    driver: SpeedDriver

    def __post_init__(self) -> None:
        wrong = [said for said, found in self._wrong().items() if found]
        if wrong:
            raise ParameterError(f"{wrong[0]}; expected a loop of an MPC, a car and a speed law: show the recorded one")

    def _wrong(self) -> dict[str, bool]:
        """What has no place in a page, and whether this loop has it."""
        model, plant = self.mpc.model, self.plant.model
        inputs, law = set(plant.inputs), set(self.driver.inputs(0.0))
        steering = self.mpc.controls[0]
        return {
            "the problem has scenarios, free parameters, Huber costs or an exact Hessian": has_parts(self.mpc),
            "the controller decides more than the steering": len(self.mpc.controls) > 1,
            "the plant has inputs that nobody sets here": not inputs <= {steering, *law} or steering not in inputs,
            "the plant does not measure the model's outputs as states": not {*model.outputs, *POSE, "v_x"}
            <= {*plant.states},
            "the model has inputs beside steering and speed": not set(model.inputs) <= {steering, "v_x"},
            "the controller looks at more than path and speed": not set(self.mpc.exogenous) <= {*_EXOGENOUS},
            "the speed law has gains over speed": len(self.driver.speeds) > 1,
            "the path is closed or has no speed": self.path.closed or self.path.v_x is None,
            f"the drive takes more than {LONGEST:g} s": self.path.v_x is not None and self._seconds > LONGEST,
            "an input other than the steering is late": not set(self.plant.delay) <= {steering},
        }

    @property
    def _seconds(self) -> float:
        """What the profile takes. [s]"""
        v_x = np.asarray(self.path.v_x)
        return float(np.sum(self.path.spacing / np.maximum(v_x[:-1], 0.5)))

    @property
    def _varied(self) -> bool:
        """Whether friction and mass of the plant can be changed."""
        return bool(getattr(self.plant.model, "tells_tire_use", False))

    @property
    def row(self) -> int:
        """Numbers that the program notes of every sample."""
        return 9 + (4 if self._varied else 0)

    @property
    def weights(self) -> tuple[str, ...]:
        """What the controller weighs, by name: tracked quantities, then changes of inputs."""
        return (*self.mpc.ocp.tracked, *self.mpc.ocp.S)

    @cached_property
    def settings(self) -> tuple[Setting, ...]:
        """What a reader may change, in the order in which the program takes it."""
        steering = self.mpc.controls[0]
        delay = float(self.plant.delay.get(steering, 0.0))
        fixed = {} if self._varied else {"low": 1.0, "high": 1.0}
        return (
            Setting(name="pace", value=1.0, low=0.6, high=1.6),
            Setting(name="friction", value=1.0, **{"low": 0.3, "high": 1.2, **fixed}),
            Setting(name="delay", value=delay, low=0.0, high=LATEST),
            Setting(name="mass", value=1.0, **{"low": 0.7, "high": 1.5, **fixed}),
            *(Setting(name=f"weight {n}", value=1.0, low=0.01, high=100.0) for n in self.weights),
        )

    def loop(self, **settings: float) -> dict[str, Any]:
        """Plant, controller, path and driver with some settings changed, as `closed_loop` takes them.

        Parameters
        ----------
        **settings : float
            By name; ``pace`` times the speed profile, ``friction`` and ``mass`` times the plant's (its yaw inertia goes
            with its mass), ``delay`` of the steering [s], ``weight_NAME`` times a weight.
        """
        known = {s.name.replace(" ", "_"): s.value for s in self.settings}
        if unknown := settings.keys() - known.keys():
            raise ParameterError(f"there is no setting {sorted(unknown)[0]!r}; expected one of {', '.join(known)}")
        return self._loop(known | settings)

    def _loop(self, now: Mapping[str, float]) -> dict[str, Any]:
        return {**self._plant_and_path(now), "controller": self._weighed(now), "driver": self.driver}

    def _plant_and_path(self, now: Mapping[str, float]) -> dict[str, Any]:
        plant = replace(self.plant, noise=Values(), delay=Values({self.mpc.controls[0]: now["delay"]}))
        if self._varied:
            plant = replace(plant, model=plant.model.varied(friction=now["friction"], mass=now["mass"]))
        return {"plant": plant, "path": self.path.with_speed(np.asarray(self.path.v_x) * now["pace"])}

    def _weighed(self, now: Mapping[str, float]) -> MPC:
        """The controller with its weights times these factors."""
        ocp = self.mpc.ocp

        def scaled(of: Mapping[str, float]) -> Weights:
            return Weights({n: v * now.get(f"weight_{n}", 1.0) for n, v in of.items()})

        ends = scaled(ocp.terminal) if isinstance(ocp.terminal, Weights) else ocp.terminal
        ocp = replace(ocp, Q=scaled(ocp.Q), S=scaled(ocp.S), terminal=ends)
        return MPC(ocp=ocp, solver=self.mpc.solver, fallback=self.mpc.fallback, safe=self.mpc.safe)

    # ---- the program -------------------------------------------------------------------------------------------

    @cached_property
    def sources(self) -> dict[str, str]:
        """C of the controller and of the loop around it."""
        project = mpc_project(self.mpc, "car", NO_DRIVE)
        return {
            "car.h": project.everything["car.h"],
            "car.c": "\n".join([project.everything["car.c"], *self._of_weights(), template("live_weights.c")]),
            "live.c": self._live("live_mpc.c"),
        }

    def _live(self, decides: str) -> str:
        """What drives: the loop, and the part of it that decides."""
        constants = [*self._constants(), *self._of_controller()]
        return "\n".join([_INCLUDES, *constants, template("live.c"), template(decides)])

    def _of_weights(self) -> list[str]:
        ocp = self.mpc.ocp
        of_changes = [len(ocp.tracked) + list(ocp.S).index(n) if n in ocp.S else -1 for n in ocp.controls]
        return [table("FACTOR_OF_CHANGE", of_changes, "int")]

    def _constants(self) -> list[str]:
        """Of the loop, the plant and the path."""
        plant, mpc = self.plant.model, self.mpc
        steering, states = plant.inputs.index(mpc.controls[0]), plant.states
        slowest = self._seconds / self.settings[0].low
        numbers = {
            "PX": len(states),
            "PU": len(plant.inputs),
            "N_SETTINGS": len(self.settings),
            "WEIGHTS": len(_PLACES),
            "USES": self.row - 9,
            "LINE_ROWS": len(self.path.s),
            "MOST_ROWS": round(1.5 * slowest / SAMPLE) + 100,
            "MOST_PLANS": round(1.5 * slowest / mpc.dt) + 20,
            "MOST_DELAY": round(LATEST / self.plant.dt),
            "PER_SAMPLE": round(SAMPLE / self.plant.dt),
            "PER_PLAN": round(mpc.dt / SAMPLE),
            "STEERING": steering,
            "SPEED": states.index("v_x"),
            **{n.upper(): at for n, at in _PLACES.items()},
        }
        real = {"SAMPLE": SAMPLE, "STEP": self.plant.dt}
        lines = [*(f"#define {n} {v}" for n, v in numbers.items()), *(f"#define {n} ({v!r})" for n, v in real.items())]
        lines += [table("POSE", [states.index(n) for n in POSE], "int"), table("SHARE", self.plant._share)]
        path = path_tables(self.path, mpc, _EXOGENOUS)
        return [*lines, *path, path_source(), sourced([*self._of_plant(), *self._of_model()])]

    def _of_controller(self) -> list[str]:
        """Of the controller's model and of the speed law."""
        plant, model, law = self.plant.model, self.mpc.model, self.driver
        steering, states = self.mpc.controls[0], plant.states
        at = [[states.index(n) if n in states else -1 for n in names] for names in (model.states, model.outputs)]
        inputs = [-1 if n == steering else states.index(n) for n in model.inputs]
        real = {"KP": law.kp[0], "KI": law.ki[0], "FEEDFORWARD": law.feedforward}
        real |= {"BRAKE_MOST": law.limits[0], "DRIVE_MOST": law.limits[1]}
        shares = {name: (drive, brake) for name, drive, brake in law._shares}
        lines = [f"#define MU {len(model.inputs)}", f"#define MY {len(model.outputs)}", "#define YAW_RATE (-2)"]
        lines += [f"#define {n} ({float(v)!r})" for n, v in real.items()]
        lines += [table(n, v, "int") for n, v in zip(("STATES", "OUTPUTS"), at, strict=True)]
        lines += [table("INPUTS", inputs, "int")]
        lines += [table("DRIVE", [shares.get(n, (0.0, 0.0))[0] for n in plant.inputs])]
        lines += [table("BRAKE", [shares.get(n, (0.0, 0.0))[1] for n in plant.inputs])]
        return lines

    def _of_model(self) -> list[Any]:
        """Step and correction of the controller's model."""
        correct = self.mpc.model.functions[2]
        x, u, y = f"x[{self.mpc.model.n_states}]", f"u[{self.mpc.model.n_inputs}]", f"y[{self.mpc.model.n_outputs}]"
        result = x.replace("x", "next")
        return [
            ("static void model_step", step_function(self.mpc.model), [x, u], result),
            ("static void model_correct", correct, [x, u, y], result),
        ]

    def _of_plant(self) -> list[Any]:
        """Step, start and tire use."""
        plant = self.plant.model
        x, u = ca.SX.sym("x", plant.n_states), ca.SX.sym("u", plant.n_inputs)
        q, v = ca.SX.sym("q", len(self.settings)), ca.SX.sym("v")
        X, Y, psi = self.path.start
        start = ca.Function("start", [v], [ca.densify(ca.vertcat(*list(plant.straight(v, X=X, Y=Y, psi=psi))))])
        listed: list[Any] = [
            ("static void plant_start", start, ["v[1]"], "x0[PX]"),
            ("static void plant_moved", self._plant_step(x, u, q), ["x[PX]", "u[PU]", "q[N_SETTINGS]"], "next[PX]"),
        ]
        if self._varied:
            car = plant.varied(friction=q[1], mass=q[3])
            used = ca.Function("use", [x, u, q], [ca.densify(ca.vertcat(*car.tire_use(x, u)))])
            listed.append(("static void plant_use", used, ["x[PX]", "u[PU]", "q[N_SETTINGS]"], "used[4]"))
        return listed

    def _plant_step(self, x: ca.SX, u: ca.SX, q: ca.SX) -> ca.Function:
        plant = self.plant.model
        if not self._varied:
            return ca.Function("step", [x, u, q], [ca.densify(plant.functions[0](x, u))])
        n = plant.n_inputs

        def rate(now: Any, drive: Any) -> Any:
            return plant.varied(friction=drive[n + 1], mass=drive[n + 3]).derivative(now, drive[:n])

        sizes = {"n_states": plant.n_states, "n_inputs": n + q.numel()}
        step = discretise(rate, plant.dt, method=plant.method, substeps=plant.substeps, **sizes)
        return ca.Function("step", [x, u, q], [ca.densify(step(x, ca.vertcat(u, q)))])

    def wasm(self) -> bytes | None:
        """The program; None without the ``ziglang`` package, or where it is too large for a page or fails."""
        if importlib.util.find_spec("ziglang") is None or os.environ.get("SLIPANGLE_CC", "").strip().lower() == "none":
            return None
        sources = self.sources
        if sum(map(len, sources.values())) > MOST_LETTERS:
            return None
        made = compiled(sources)
        return made if made is not None and len(made) <= MOST_BYTES else None


_EXOGENOUS = {"v_x": 5, "curvature": 4, "v_x_dot": -1}


def compiled(sources: Mapping[str, str]) -> bytes | None:
    """WebAssembly of C files by name, from the cache where they were compiled before; None where that fails."""
    identity = "\0".join(["live", *_FLAGS, *_EXPORTED, *sources.values()])
    for folder, _ in code_cache.folders():
        try:
            found = code_cache.find(folder, "live", identity, ".wasm")
            if found is None:
                found = _compile(sources, folder, identity)
            return None if found is None else found.read_bytes()
        except OSError:
            continue
    return None


def _compile(sources: Mapping[str, str], folder: FilePath, identity: str) -> FilePath | None:
    with tempfile.TemporaryDirectory(dir=folder, prefix=".live.") as scratch:
        for name, text in sources.items():
            (FilePath(scratch) / name).write_text(text, encoding="utf-8")
        call = [sys.executable, "-m", "ziglang", "cc", *_FLAGS, "-Wl,--strip-all"]
        call += [f"-Wl,--export=live_{n}" for n in _EXPORTED]
        call += ["-o", "live.wasm", *(n for n in sources if n.endswith(".c")), "-lm"]
        environment = {"ZIG_GLOBAL_CACHE_DIR": str(folder / "zig"), **os.environ}
        try:
            done = subprocess.run(call, cwd=scratch, env=environment, capture_output=True, timeout=300, check=False)
        except (OSError, subprocess.TimeoutExpired):
            return None
        made = FilePath(scratch) / "live.wasm"
        if done.returncode or not made.is_file():
            return None
        return code_cache.keep(made, folder, "live", identity)
