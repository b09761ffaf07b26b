"""Out of the lab: drivers, controllers and models as C that runs without Python, each a folder of its own.

Start with `export`, or the method of that name of a controller or a model; `build` compiles ahead of time what `load`
takes where there is no compiler.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from slipangle.data.dataset import Dataset
from slipangle.export.budget import measured, with_budget
from slipangle.export.built import build, load
from slipangle.export.built_controller import BuiltController
from slipangle.export.built_driver import BuiltDriver
from slipangle.export.drivers import DriverRecorder
from slipangle.export.drives import DEFAULT_STEPS, Drive, Recorder
from slipangle.export.kinds import project_of
from slipangle.export.names import checked
from slipangle.export.precision import as_near, as_precision, require_near
from slipangle.export.project import write
from slipangle.export.settings import place, require_budget, require_drive


def export(
    thing: Any,
    folder: str | Path,
    *,
    name: str = "",
    drive: Drive | Dataset | int = DEFAULT_STEPS,
    precision: str = "double",
    budget: int = 0,
    force: bool = False,
) -> Path:
    """Write a driver, a racer, a controller or a model as self-contained C99 into a folder.

    The folder has the source, a header with units and ranges, a wrapper for C++17, a program that replays a recorded
    drive, a Makefile, CMakeLists.txt, a README and a manifest with checksums. The code allocates nothing, opens no
    file, reads no clock but the caller's, and keeps all its memory in one struct.

    Parameters
    ----------
    thing : Model, EKF, MHE, LearnedSideSlip, RecursiveARX, MPC, MultiARXMPC, PathFollower, Driver or Racer
        What to export; an MPC is one solved in real time. A driver is estimator, path, controller and speed law in one,
        a racer one that drives a lap at the limit, its ``between`` "sectors" or False.
    folder : str or Path
        Where; a new or an empty folder.
    name : str, optional
        With which files and functions begin; by default what is exported, such as ``mpc``.
    drive : Drive, Dataset or int
        What the program replays. Of a controller, a driver or a racer: what a `Recorder` or a `DriverRecorder` wrote
        down. Of a model: data, from whose start and inputs it runs free. Of an estimator: data that it goes over. Or so
        many steps of a drive of its own.
    precision : str
        Of all numbers in C: ``"double"`` or ``"single"``, for processors that know no double; see docs/export.md.
    budget : int
        Over how many hard states to count the instructions and the stack of a step, of a controller or a driver; the
        README and the manifest have what is at most. 0 for not.
    force : bool
        Write into a folder that is not empty too.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If Valgrind or a compiler is missing, for the budget.
    ParameterError
        If the thing has no C, or none in this precision, or follows a path too far from the origin for that, a setting
        is of another kind, or the name cannot be one there.
    WriteError
        If the folder is not empty or cannot be written.
    """
    place(folder, "folder")
    require_drive(drive)
    require_budget(budget)
    require_near(thing, precision)
    thing = as_near(thing, precision)
    project = as_precision(project_of(thing, checked(name) if name else "", drive), precision)
    if budget:
        project = replace(project, **with_budget(project, measured(project, budget)))
    return write(project, folder, force=force)


__all__ = ["BuiltController", "BuiltDriver", "Drive", "DriverRecorder", "Recorder", "build", "export", "load"]
