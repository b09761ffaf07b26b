"""Controllers compiled ahead of time: a folder that is loaded, checked, where there is no compiler."""

from __future__ import annotations

import ctypes
import hashlib
import json
import platform
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from slipangle.codegen import compiler
from slipangle.control.controller import Ahead, Controller
from slipangle.errors import ConfigError, FormatError, HashError, ParameterError
from slipangle.export.drives import DEFAULT_STEPS, Drive, preview_columns
from slipangle.export.kinds import project_of
from slipangle.export.names import checked
from slipangle.export.project import write
from slipangle.files import read_bytes, write_atomic
from slipangle.models.model import Model
from slipangle.models.storage import load as load_record
from slipangle.models.storage import save as save_record
from slipangle.optimal.arrays import applied_input, array, vector
from slipangle.optimal.ocp import Reference, at_nodes, require_reference
from slipangle.optimal.solution import Health, Plan, Status
from slipangle.paths.preview import Preview

TESTED = 50  # steps of the recorded drive that a library repeats before it is used
AGREES = 1e-9  # largest difference of a command from the recorded one, relative to 1 + its size
STATUSES = [
    Status[n]
    for n in "SOLVED REAL_TIME ITERATION_LIMIT STALLED TIME_OUT INFEASIBLE NOT_FINITE FAILED IMPLAUSIBLE".split()
]


def build(
    controller: Controller,
    folder: str | Path,
    *,
    name: str = "",
    drive: Drive | int = DEFAULT_STEPS,
    portable: bool = False,
    force: bool = False,
) -> Path:
    """Export a controller and compile it for machines like this one.

    Beside the files of `slipangle.export.export` the folder has the library, the model, and a manifest that says from
    which source, by which compiler and flags and for which processor it was made; `load` checks all of it.

    Parameters
    ----------
    controller : Controller
        What to compile.
    folder, name, drive, force
        As for `slipangle.export.export`.
    portable : bool
        For every processor of this machine's kind, slower; by default for this very one.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If there is no compiler, or it does not compile this.
    ParameterError
        If there is no C of this controller, or the name cannot be one.
    WriteError
        If the folder is not empty or cannot be written.
    """
    project = project_of(controller, checked(name) if name else "", drive)
    if "interface" not in project.facts:
        raise ParameterError(f"a {type(controller).__name__} is no controller; expected one: it is exported only")
    target = write(project, folder, force=force)
    library = f"{project.name}{compiler.SUFFIX}"
    made = compiler.compile_file(target / f"{project.name}.c", target / library, flags=project.flags, portable=portable)
    record = json.loads((target / "manifest.json").read_text(encoding="utf-8"))
    record["build"] = {
        "library": library,
        "sha256": hashlib.sha256((target / library).read_bytes()).hexdigest(),
        **made,
        **_machine(portable),
        "starts": callable(getattr(controller, "start", None)),
    }
    try:
        save_record(controller.model, target / "model.json")
    except ParameterError as error:  # a function, say, which no file keeps
        record["build"]["without_model"] = str(error)
    write_atomic(target / "manifest.json", json.dumps(record, indent=2) + "\n")
    return target


def _machine(portable: bool) -> dict[str, Any]:
    """What a library depends on."""
    processor = "" if portable else hashlib.sha256(compiler.processor().encode()).hexdigest()
    own = {"system": platform.system(), "machine": platform.machine(), "bits": 8 * ctypes.sizeof(ctypes.c_void_p)}
    return {**own, "processor": processor}


def load(folder: str | Path) -> BuiltController:
    """A controller that `build` wrote, checked: its files, its machine, and what it decides on a recorded drive.

    Parameters
    ----------
    folder : str or Path
        Where it is. A library runs with all your rights: load what you trust.

    Returns
    -------
    BuiltController
        Ready to plan; nothing is compiled.

    Raises
    ------
    MissingFileError
        If a file is not there.
    FormatError
        If the manifest is none.
    HashError
        If a file is not the one that was built.
    ConfigError
        If it was built for another machine, or decides otherwise here.
    """
    return BuiltController(folder)


class BuiltController(Controller):
    """A controller on a compiled library; see `load`.

    It goes on from its own last plan: ``previous`` is that plan, or None to start anew. Made by `load`, which raises
    ConfigError, HashError or FormatError where the library is not of this machine, was changed, or is none.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        record = self._manifest()
        made, self._names, self._sizes = record["build"], record["interface"], record["sizes"]
        self.name, self.built = record["name"], made
        for what, sum_ in (("library", made["sha256"]), ("drive.csv", record["sha256"]["drive.csv"])):
            file = made["library"] if what == "library" else what
            raw = read_bytes(self.folder / file, "the built controller's", "a folder that 'slipangle build' wrote")
            if hashlib.sha256(raw).hexdigest() != sum_:
                raise HashError(
                    f"'{file}' in '{folder}' is not the file that was built; expected it whole: build again"
                )
        here = _machine(not made["processor"])
        for key, value in here.items():
            if made[key] != value:
                said = "another processor" if key == "processor" else f"{key} {made[key]}, this one's is {value}"
                raise ConfigError(
                    f"'{folder}' was built for {said}; expected this machine: build it here, or there with --portable"
                )
        self.dt, self.horizon, self.times = record["dt"], self._sizes["HORIZON"], np.array(self._names["times"])
        self.controls, self.references = tuple(self._names["controls"]), tuple(self._names["references"])
        self.exogenous, self._states = tuple(self._names["exogenous"]), tuple(self._names["states"])
        self._load(made["library"])
        self._last: object = None
        self._test()

    def __reduce__(self) -> Any:
        return load, (self.folder,)

    def _manifest(self) -> dict[str, Any]:
        expected = "a folder that 'slipangle build' wrote"
        try:
            record = json.loads(read_bytes(self.folder / "manifest.json", "the manifest", expected))
            missing = {"build", "interface", "sizes", "sha256", "dt", "name"} - set(record)
        except (ValueError, TypeError) as error:
            if isinstance(error, OSError | FormatError) or type(error).__module__.startswith("slipangle"):
                raise
            raise FormatError(f"'{self.folder / 'manifest.json'}' is no manifest; expected {expected}") from None
        if missing:
            raise FormatError(f"'{self.folder}' was exported, not built (no {min(missing)}); expected {expected}")
        return record

    # ---- the library -------------------------------------------------------------------------------------------

    def _load(self, file: str) -> None:
        try:
            library = ctypes.CDLL(str((self.folder / file).resolve()))
        except OSError as error:
            raise ConfigError(f"'{file}' cannot be loaded ({error}); expected this machine: build it here") from None
        self._start, self._plan = (getattr(library, f"{self.name}_{n}") for n in ("start", "plan"))
        self._start.argtypes, self._plan.argtypes = [ctypes.c_void_p, ctypes.c_size_t], [ctypes.c_void_p] * 3
        self._library = library
        self._given, self._out = _input(self._sizes)(), _output(self._sizes)()
        raw = np.zeros(self._sizes["BYTES"] + 64, dtype=np.uint8)
        self._memory = raw[-raw.ctypes.data % 64 :]
        self._arrays = {f[0]: _view(self._given, f[0]) for f in self._given._fields_ if f[0] != "applied_known"}

    def _begin(self) -> None:
        code = self._start(self._memory.ctypes.data, self._sizes["BYTES"])
        if code:
            raise ConfigError(f"the library of '{self.folder}' refuses its memory (code {code}): build it again")

    def _test(self) -> None:
        """Repeat the beginning of the recorded drive."""
        with (self.folder / "drive.csv").open(encoding="utf-8") as file:
            rows = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2, max_rows=TESTED)
        self._begin()
        n = len(self.controls)
        flat = [self._arrays[k] for k in ("x", "tracked", "exogenous", "corridor", "applied") if k in self._arrays]
        if rows.shape[1] != sum(a.size for a in flat) + n:
            raise FormatError(
                f"'{self.folder / 'drive.csv'}' has {rows.shape[1]} columns; expected those of the header"
            )
        for row in rows:
            for part, to in zip(np.split(row[:-n], np.cumsum([a.size for a in flat])[:-1]), flat, strict=True):
                to[...] = part.reshape(to.shape)
            self._given.applied_known = int(not np.isnan(self._arrays["applied"]).any())
            self._plan(self._memory.ctypes.data, ctypes.byref(self._given), ctypes.byref(self._out))
            off = np.abs(_view(self._out, "command") - row[-n:]).max() / (1 + np.abs(row[-n:]).max())
            if not off <= AGREES:
                raise ConfigError(
                    f"the library of '{self.folder}' decides otherwise than when it was built (by {off:.2g}); expected "
                    f"{AGREES:g} at most: build it again, here"
                )
        self._begin()

    # ---- a controller --------------------------------------------------------------------------------------------

    @cached_property
    def model(self) -> Model:  # type: ignore[override]  # read when it is asked for
        """What predicts, for those who estimate its state.

        Raises MissingFileError if it could not be kept.
        """
        file = self.folder / "model.json"
        read_bytes(file, "the model", f"one that a file can keep ({self.built.get('without_model', 'it is missing')})")
        return load_record(file)

    def start(self, measured: Mapping[str, float]) -> np.ndarray:
        """State of the model from the channels measured now, zero where none is; shape (n_states,).

        Raises ParameterError if the controller that was built has a way of its own to find it, such as one with lags.
        """
        if self.built.get("starts"):
            raise ParameterError(
                f"the built controller '{self.name}' does not know the state to start from; expected the state that "
                "the controller finds that it was built from: call that one's start, or give an estimator"
            )
        return np.array([measured.get(n, 0.0) for n in self._states])

    def reference(self, preview: Preview, **exogenous: np.ndarray | float) -> Reference:
        """`Reference` from a look along a path; exogenous inputs that it does not know must be given.

        Raises ParameterError if one is lacking or unknown.
        """
        preview.require_times(self.times)
        known = preview_columns(preview)
        rows = {n: at_nodes(np.asarray(v, dtype=float), self.horizon) for n, v in exogenous.items()}
        lacking = [n for n in self.exogenous if n not in known and n not in rows]
        if lacking or set(rows) - set(self.exogenous):
            wrong = (lacking or sorted(set(rows) - set(self.exogenous)))[0]
            raise ParameterError(f"the exogenous input '{wrong}' is given or lacking; expected {list(self.exogenous)}")
        tracked = [known.get(n, np.zeros(self.horizon + 1)) for n in self.references]
        inputs = [(known | rows)[n] for n in self.exogenous]
        return Reference(
            tracked=np.column_stack(tracked) if tracked else np.empty((self.horizon + 1, 0)),
            exogenous=np.column_stack(inputs) if inputs else np.empty((self.horizon + 1, 0)),
            corridor=np.column_stack([preview.right, preview.left]),
        )

    def check_reference(self, reference: Reference) -> Reference:
        """The reference as arrays of numbers in the shapes of this controller; raises ParameterError otherwise."""
        require_reference(reference)
        rows, w = self._sizes["EXOGENOUS_ROWS"], np.asarray(reference.exogenous)
        if w.ndim == 2 and len(w) == self.horizon < rows:
            w = np.vstack([w, w[-1:]])
        elif w.ndim == 2 and len(w) == self.horizon + 1 > rows:
            w = w[:rows]
        if self._sizes["CORRIDOR"] and reference.corridor is None:
            raise ParameterError("the reference has no corridor; expected one: use reference(preview)")
        shape = self.horizon + 1, len(self.references)
        return Reference(
            tracked=array(reference.tracked, shape, self.references, "reference.tracked"),
            exogenous=array(w, (rows, len(self.exogenous)), self.exogenous, "reference.exogenous"),
            inputs=reference.inputs,
            corridor=reference.corridor,
        )

    def plan(
        self, x: np.ndarray, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
    ) -> Plan:
        """See `Controller.plan`; ``previous`` is this controller's last plan, or None to start anew.

        Raises ParameterError if it is another one, too.
        """
        begin, given = perf_counter(), self._arrays
        wanted = self.check_reference(self.reference(reference) if isinstance(reference, Preview) else reference)
        if previous is None:
            self._begin()
        elif previous.memory is not self._last:
            raise ParameterError("previous is not the last plan of this built controller; expected that one, or None")
        given["x"][...] = vector(x, self._states, "x")
        for key in ("tracked", "exogenous", "corridor"):
            if key in given:
                given[key][...] = getattr(wanted, key)
        given["inputs"][...] = 0.0 if wanted.inputs is None else wanted.inputs
        given["applied"][...] = 0.0 if applied is None else applied_input(applied, self.controls)
        self._given.applied_known = applied is not None
        self._plan(self._memory.ctypes.data, ctypes.byref(self._given), ctypes.byref(self._out))
        out, self._last = self._out, object()
        return Plan(
            u=_view(out, "u").copy(),
            x=_view(out, "x").copy(),
            status=STATUSES[out.status],
            seconds=perf_counter() - begin,
            cost=out.cost,
            iterations=out.iterations,
            controls=self.controls,
            age=out.age,
            stopping=bool(out.stopping),
            residual=out.residual,
            violation=out.violation,
            memory=self._last,
            times=self.times,
            health=Health(*(getattr(out.health, n) for n in Health._fields)),
        )


def _view(of: ctypes.Structure, name: str) -> np.ndarray:
    return np.ctypeslib.as_array(getattr(of, name))


def _array(*lengths: int) -> Any:
    kind: Any = ctypes.c_double
    for length in reversed(lengths):
        kind = kind * length
    return kind


def _input(n: dict[str, int]) -> type[ctypes.Structure]:
    """``NAME_input`` of the header."""
    shapes = {"x": (n["STATES"],), "tracked": (n["NODES"], n["REFERENCES"])}
    shapes |= {"exogenous": (n["EXOGENOUS_ROWS"], n["EXOGENOUS"]), "corridor": (n["NODES"], 2 * n["CORRIDOR"])}
    shapes |= {"inputs": (n["HORIZON"], n["CONTROLS"]), "applied": (n["CONTROLS"],)}
    fields = [(k, _array(*s)) for k, s in shapes.items() if all(s)]
    return type("Input", (ctypes.Structure,), {"_fields_": [*fields, ("applied_known", ctypes.c_int)]})


def _output(n: dict[str, int]) -> type[ctypes.Structure]:
    """``NAME_output`` of the header."""
    counters = type("Counters", (ctypes.Structure,), {"_fields_": [(k, ctypes.c_int64) for k in Health._fields]})
    shapes = {"command": (n["CONTROLS"],), "u": (n["HORIZON"], n["CONTROLS"]), "x": (n["NODES"], n["STATES"])}
    fields = [(k, _array(*s)) for k, s in shapes.items()]
    fields += [(k, ctypes.c_double) for k in ("cost", "residual", "violation", "seconds")]
    fields += [(k, ctypes.c_int) for k in ("status", "age", "stopping", "iterations")]
    return type("Output", (ctypes.Structure,), {"_fields_": [*fields, ("health", counters)]})
