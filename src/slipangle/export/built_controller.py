"""A controller on a library that was compiled ahead of time."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from slipangle.control.controller import Ahead, Controller
from slipangle.errors import ConfigError, ParameterError
from slipangle.export.built_folder import BuiltFolder, loaded, memory, numbers, view
from slipangle.export.drives import preview_columns
from slipangle.files import read_bytes
from slipangle.models.model import Model
from slipangle.models.storage import load as load_record
from slipangle.optimal.arrays import applied_input, array, vector
from slipangle.optimal.ocp import Reference, at_nodes, require_reference
from slipangle.optimal.solution import ANEW, Health, Plan, Status
from slipangle.paths.preview import Preview

STATUSES = [
    Status[n]
    for n in "SOLVED REAL_TIME ITERATION_LIMIT STALLED TIME_OUT INFEASIBLE NOT_FINITE FAILED IMPLAUSIBLE".split()
]
Counters = type("Counters", (ctypes.Structure,), {"_fields_": [(k, ctypes.c_int64) for k in Health._fields]})


class BuiltController(Controller):
    """A controller on a compiled library; see `load`.

    It goes on from its own last plan: ``previous`` is that plan, or None to start anew.

    Parameters
    ----------
    built : BuiltFolder
        Where the library is.

    Raises
    ------
    ConfigError
        If the library cannot be loaded, or decides otherwise than when it was built.
    FormatError
        If its drive is none of this controller.
    """

    def __init__(self, built: BuiltFolder) -> None:
        record, self.folder, self.built = built.record, built.path, built.made
        self._names, self._sizes, self.name = record["interface"], record["sizes"], record["name"]
        self.dt, self.horizon, self.times = record["dt"], self._sizes["HORIZON"], np.array(self._names["times"])
        self.controls, self.references = tuple(self._names["controls"]), tuple(self._names["references"])
        self.decided = tuple(self._names.get("decided", ()))
        self.exogenous, self._states = tuple(self._names["exogenous"]), tuple(self._names["states"])
        self._library = library = built.library()
        self._start, self._plan = (getattr(library, f"{self.name}_{n}") for n in ("start", "plan"))
        self._start.argtypes, self._plan.argtypes = [ctypes.c_void_p, ctypes.c_size_t], [ctypes.c_void_p] * 3
        self._given, self._out = _input(self._sizes)(), output_of(self._sizes)()
        self._memory = memory(self._sizes["BYTES"])
        self._arrays = {f[0]: view(self._given, f[0]) for f in self._given._fields_ if f[0] != "applied_known"}
        self._last: object = None
        self._test(built)

    def __reduce__(self) -> Any:
        return loaded, (type(self), self.folder)

    def _begin(self) -> None:
        code = self._start(self._memory.ctypes.data, self._sizes["BYTES"])
        if code:
            raise ConfigError(f"the library of '{self.folder}' refuses its memory (code {code}): build it again")

    def _test(self, built: BuiltFolder) -> None:
        """Repeat the beginning of the recorded drive."""
        self._begin()
        n = len(self.controls)
        flat = [self._arrays[k] for k in ("x", "tracked", "exogenous", "corridor", "applied") if k in self._arrays]
        for row in built.drive(sum(a.size for a in flat) + n):
            for part, to in zip(np.split(row[:-n], np.cumsum([a.size for a in flat])[:-1]), flat, strict=True):
                to[...] = part.reshape(to.shape)
            self._given.applied_known = int(not np.isnan(self._arrays["applied"]).any())
            self._plan(self._memory.ctypes.data, ctypes.byref(self._given), ctypes.byref(self._out))
            built.check_repeated(view(self._out, "command"), row[-n:])
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
        reference.require_plain("a built controller")
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
        self, x: np.ndarray, /, reference: Ahead, previous: Plan | None = None, *, applied: np.ndarray | None = None
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
        self._last = object()
        return plan_of(self._out, self.controls, self.times, perf_counter() - begin, self._last, self.decided)


def _input(n: dict[str, int]) -> type[ctypes.Structure]:
    """``NAME_input`` of the header."""
    shapes = {"x": (n["STATES"],), "tracked": (n["NODES"], n["REFERENCES"])}
    shapes |= {"exogenous": (n["EXOGENOUS_ROWS"], n["EXOGENOUS"]), "corridor": (n["NODES"], 2 * n["CORRIDOR"])}
    shapes |= {"inputs": (n["HORIZON"], n["CONTROLS"]), "applied": (n["CONTROLS"],)}
    fields = [(k, numbers(*s)) for k, s in shapes.items() if all(s)]
    return type("Input", (ctypes.Structure,), {"_fields_": [*fields, ("applied_known", ctypes.c_int)]})


def output_of(n: dict[str, int]) -> type[ctypes.Structure]:
    """``NAME_output`` of a controller's header, with these sizes."""
    shapes = {"command": (n["CONTROLS"],), "u": (n["HORIZON"], n["CONTROLS"]), "x": (n["NODES"], n["STATES"])}
    shapes |= {"decided": (n.get("DECIDED", 0),)}
    fields = [(k, numbers(*s)) for k, s in shapes.items() if all(s) or k != "decided"]
    fields += [(k, ctypes.c_double) for k in ("cost", "residual", "violation", "seconds")]
    fields += [(k, ctypes.c_int) for k in ("status", "age", "stopping", "iterations", "begun_anew")]
    fields += [("demand", ctypes.c_double), ("active", ctypes.c_int)] if n.get("SWITCHES") else []
    fields += [("lesson", ctypes.c_int), ("samples", ctypes.c_int64)] if n.get("LEARNS") else []
    return type("Output", (ctypes.Structure,), {"_fields_": [*fields, ("health", Counters)]})


def plan_of(
    out: Any,
    controls: tuple[str, ...],
    times: np.ndarray,
    seconds: float,
    memory_: object,
    decided: tuple[str, ...] = (),
) -> Plan:
    """A ``NAME_output`` as a `Plan`; ``decided`` names what it decides once."""
    once = None if not decided or out.age else dict(zip(decided, view(out, "decided").tolist(), strict=True))
    if once and "duration" in once:
        times = times * (once["duration"] / times[-1])
    return Plan(
        u=view(out, "u").copy(),
        x=view(out, "x").copy(),
        status=STATUSES[out.status],
        seconds=seconds,
        cost=out.cost,
        iterations=out.iterations,
        controls=controls,
        age=out.age,
        stopping=bool(out.stopping),
        residual=out.residual,
        violation=out.violation,
        memory=memory_,
        decided=once,
        times=times,
        detail=ANEW if out.begun_anew else "",
        health=health_of(out.health),
    )


def health_of(counters: Any) -> Health:
    """``NAME_health`` as a `Health`."""
    return Health(*(getattr(counters, n) for n in Health._fields))
