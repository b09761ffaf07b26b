"""`PlantFMU`: a vehicle in an FMU for co-simulation, FMI 2.0 or 3.0, by fmpy (extra ``[fmu]``)."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from slipangle import units
from slipangle.errors import FormatError, ParameterError, SimulationError, nearest, shown
from slipangle.extras import extra
from slipangle.shown import Brief
from slipangle.simulate.foreign import KNOWN, Channels, require_plant

REAL = ("Real", "Float64")
CLOSE = 1e-6  # m, rad, m/s by which a start may differ from what was asked, over 1 + its size


class PlantFMU(Brief):
    """A `PlantProtocol` in an FMU for co-simulation.

    Channels keep the toolbox's names; a mapping says which variable of the FMU each one is. A variable whose unit the
    FMU declares (deg, km/h, ...) is converted; without one it counts as SI. Its axes must be those of ISO 8855.

    Parameters
    ----------
    path : str or Path
        The file.
    inputs : mapping of str to str, optional
        Variable of each command, such as ``{"delta": "SteeringAngle"}``; by default every real input by its own name.
    outputs : mapping of str to str, optional
        Variable of each measurement, any that can be read; by default every real output by its own name, and X, Y,
        psi and v_x where a variable has that name or ``state.X``.
    start : mapping of str to str, optional
        Variables that hold X, Y, psi and v_x before initialisation, such as ``{"v_x": "v_0"}``; by default those
        that are read as X, ..., where they can be set.
    parameters : mapping of str to float, optional
        Values of other variables, by their names in the FMU and in its units, set before initialisation.
    dt : float, optional
        Time of one step [s]; by default the step size that the FMU recommends.

    Raises
    ------
    MissingExtraError
        If fmpy is not installed.
    FormatError
        If the file is no FMU for co-simulation with a library for this machine.
    ParameterError
        If a variable is not there or no real number, no step size is known, or a mapping is none of names or numbers.
    SimulationError
        If the FMU refuses a call, ends, or starts elsewhere than it was asked to, each in `reset` and `step` too.
    """

    _lists = ("path", "inputs", "outputs", "dt")

    def __init__(
        self,
        path: str | Path,
        *,
        inputs: Mapping[str, str] | None = None,
        outputs: Mapping[str, str] | None = None,
        start: Mapping[str, str] | None = None,
        parameters: Mapping[str, float] | None = None,
        dt: float | None = None,
    ) -> None:
        self._fmpy, self.path = extra("fmpy", "fmu", "driving an FMU"), Path(path)
        self._part: Any = None
        try:
            described = self._fmpy.read_model_description(str(path), validate=False)
        except Exception as error:  # of code that is not ours
            raise FormatError(f"'{path}' cannot be read as an FMU ({_said(error)}); expected one") from error
        if described.coSimulation is None:
            raise FormatError(f"'{path}' is an FMU for model exchange alone; expected one for co-simulation")
        self._described, self._newer = described, described.fmiVersion.startswith("3")
        self._variables = {v.name: v for v in described.modelVariables}
        known = {v.name: v for v in described.modelVariables if v.type in REAL}
        _require_mappings(inputs=inputs, outputs=outputs, start=start)
        self._in = dict(inputs) if inputs is not None else {n: n for n, v in known.items() if v.causality == "input"}
        self._out = dict(outputs) if outputs is not None else self._measured(known)
        self._start = dict(start) if start is not None else self._settable(known)
        for what, names in (("inputs", self._in), ("outputs", self._out), ("start", self._start)):
            for variable in names.values():
                self._require(variable, what)
        if unknown := set(self._start) - set(KNOWN):
            raise ParameterError(f"start names {shown(sorted(unknown))}; expected channels of {', '.join(KNOWN)}")
        self._parameters = _numbers(parameters or {}, "parameters")
        for variable in self._parameters:
            self._require(variable, "parameters")
        experiment = described.defaultExperiment
        step = dt if dt is not None else getattr(experiment, "stepSize", None)
        if step is None:
            raise ParameterError(f"'{path}' recommends no step size; expected the time of one step: say dt=0.001")
        self.dt: Any = _numbers({"dt": step}, "dt")["dt"]
        self.inputs, self.outputs = tuple(self._in), tuple(self._out)
        require_plant(self)
        self._factors = {n: self._factor(n) for n in (*self._in.values(), *self._out.values(), *self._start.values())}
        self._time = 0.0
        self._load()

    # ---- the protocol -------------------------------------------------------------------------------------------

    def reset(self, start: Channels) -> Channels:
        """See `PlantProtocol.reset`."""
        return self._called(self._reset, start)

    def step(self, commands: Channels) -> Channels:
        """See `PlantProtocol.step`."""
        return self._called(self._step, commands)

    def close(self) -> None:
        """End the FMU and remove what was unpacked."""
        part, self._part = self._part, None
        if part is not None:
            try:
                if self._begun:
                    part.terminate()
                part.freeInstance()
            except Exception:  # of code that is not ours; it is over anyway
                pass
        self._removed()

    def __enter__(self) -> PlantFMU:
        return self

    def __exit__(self, *ended: object) -> None:
        self.close()

    # ---- the FMU ------------------------------------------------------------------------------------------------

    def _load(self) -> None:
        self._folder, self._begun = tempfile.mkdtemp(prefix="slipangle-fmu-"), False
        self._removed = weakref.finalize(self, shutil.rmtree, self._folder, True)  # at the latest when Python ends
        kind = self._fmpy.fmi3.FMU3Slave if self._newer else self._fmpy.fmi2.FMU2Slave
        try:
            self._fmpy.extract(str(self.path), unzipdir=self._folder)
            self._part = kind(
                guid=self._described.guid,
                unzipDirectory=self._folder,
                modelIdentifier=self._described.coSimulation.modelIdentifier,
                instanceName="plant",
            )
            self._part.instantiate()
        except Exception as error:  # of code that is not ours
            self._part = None
            self.close()
            raise FormatError(
                f"'{self.path}' cannot be started here ({_said(error)}); expected an FMU with a library for this kind "
                "of machine"
            ) from error

    def _reset(self, start: Channels) -> Channels:
        part = self._part
        if self._begun:
            part.terminate()
            part.fmi3Reset(part.component) if self._newer else part.reset()
            self._begun = False
        for variable, value in self._parameters.items():
            self._set({variable: value})
        self._set({v: start[n] / self._factors[v] for n, v in self._start.items() if n in start})
        self._set({v: start[n] / self._factors[v] for n, v in self._in.items() if n in start})
        if not self._newer:
            part.setupExperiment(startTime=0.0)
        part.enterInitializationMode()
        part.exitInitializationMode()
        self._begun, self._time = True, 0.0
        measured = self._get()
        for n, wanted in start.items():
            if n in measured and not abs(measured[n] - wanted) <= CLOSE * (1.0 + abs(wanted)):
                raise SimulationError(
                    f"it starts at {n} = {measured[n]:.6g}, asked for {wanted:.6g}; expected the same: name the "
                    f"variable that sets it in start={{'{n}': ...}}"
                )
        return measured

    def _step(self, commands: Channels) -> Channels:
        self._set({v: commands[n] / self._factors[v] for n, v in self._in.items()})
        said = self._part.doStep(self._time, self.dt)
        if self._newer and said[1]:
            raise SimulationError(f"it ends the simulation at t = {self._time:.6g} s; expected it to go on")
        self._time += self.dt
        return self._get()

    def _set(self, values: Mapping[str, float]) -> None:
        if values:
            put = self._part.setFloat64 if self._newer else self._part.setReal
            put([self._variables[n].valueReference for n in values], [float(v) for v in values.values()])

    def _get(self) -> dict[str, float]:
        take = self._part.getFloat64 if self._newer else self._part.getReal
        values = take([self._variables[v].valueReference for v in self._out.values()])
        return {n: float(y) * self._factors[v] for (n, v), y in zip(self._out.items(), values, strict=True)}

    def _called(self, what: Any, given: Channels) -> Channels:
        if self._part is None:
            raise SimulationError(f"the FMU '{self.path.name}' is closed; expected an open one: make another PlantFMU")
        try:
            return what(given)
        except SimulationError as error:
            raise SimulationError(f"the FMU '{self.path.name}': {error}") from None
        except Exception as error:  # of code that is not ours
            raise SimulationError(
                f"the FMU '{self.path.name}' fails at t = {self._time:.6g} s ({_said(error)}); expected measurements"
            ) from error

    # ---- names and units ----------------------------------------------------------------------------------------

    def _measured(self, known: Mapping[str, Any]) -> dict[str, str]:
        listed = {n: n for n, v in known.items() if v.causality == "output"}
        for name in KNOWN:
            found = next((n for n in (name, f"state.{name}") if n in known), None)
            if name not in listed and found is not None:
                listed[name] = found
        return listed

    def _settable(self, known: Mapping[str, Any]) -> dict[str, str]:
        """Where X, Y, psi and v_x can be set before initialisation: what is read, or the state of that name."""
        listed = {}
        for name in KNOWN:
            for variable in (self._out.get(name, ""), f"state.{name}"):
                v = known.get(variable)
                if v is not None and v.causality != "output" and v.start is not None:
                    listed[name] = variable
                    break
        return listed

    def _require(self, variable: str, what: str) -> None:
        v = self._variables.get(variable)
        if v is None:
            raise ParameterError(
                f"{what} names the variable {shown(variable)}, which '{self.path.name}' does not have; "
                f"{nearest(variable, self._variables)}: use one of these"
            )
        if v.type not in REAL:
            raise ParameterError(f"{what} names {shown(variable)}, which is of type {v.type}; expected a real number")

    def _factor(self, variable: str) -> float:
        v = self._variables[variable]
        unit = v.unit or getattr(getattr(v, "declaredType", None), "unit", None) or ""
        if not unit or not units.known(unit):
            return 1.0
        return float(units.to_si(1.0, unit) - units.to_si(0.0, unit))  # kelvins stay, from whichever zero


def _require_mappings(**given: Any) -> None:
    """Raise ParameterError unless each that is given says by its name which variable a channel is."""
    for what, names in given.items():
        known = isinstance(names, Mapping) and all(isinstance(n, str) for pair in names.items() for n in pair)
        if not (names is None or known):
            raise ParameterError(
                f"{what} is {shown(names)}; expected the name of a variable for each channel, such as "
                "{'v_x': 'v_0'}: numbers go into parameters, or into reset"
            )


def _numbers(given: Any, what: str) -> dict[str, float]:
    """Numbers by name.

    Raises ParameterError if they are none.
    """
    try:
        return {name: float(value) for name, value in given.items()}
    except (AttributeError, TypeError, ValueError):
        raise ParameterError(f"{what} is {shown(given)}; expected a number by each name, in the units there") from None


def _said(error: Exception) -> str:
    text = " ".join(str(error).split())[:200]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
