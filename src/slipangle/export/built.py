"""Controllers and drivers compiled ahead of time: a folder that is loaded, checked, where there is no compiler."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from slipangle.codegen import compiler
from slipangle.control.controller import Controller
from slipangle.control.driver import Driver
from slipangle.control.racing.racer import Racer
from slipangle.errors import ParameterError
from slipangle.export.built_controller import BuiltController
from slipangle.export.built_driver import BuiltDriver, keep_path
from slipangle.export.built_folder import BuiltFolder, machine
from slipangle.export.drives import DEFAULT_STEPS, Drive
from slipangle.export.kinds import project_of
from slipangle.export.loops import LOOPS
from slipangle.export.names import checked, with_prefix
from slipangle.export.project import Project, write
from slipangle.export.settings import place, require_drive
from slipangle.files import write_atomic
from slipangle.models.storage import save as save_record


def build(
    controller: Controller | Driver | Racer,
    folder: str | Path,
    *,
    name: str = "",
    drive: Drive | int = DEFAULT_STEPS,
    portable: bool = False,
    force: bool = False,
) -> Path:
    """Export a controller, a whole driver or a racer and compile it for machines like this one.

    Beside the files of `slipangle.export.export` the folder has the library, the model, and a manifest that says from
    which source, by which compiler and flags and for which processor it was made; `load` checks all of it.

    Parameters
    ----------
    controller : Controller, Driver or Racer
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
        If there is no C of this controller, a setting is of another kind, or the name cannot be one.
    WriteError
        If the folder is not empty or cannot be written.
    """
    place(folder, "folder")
    require_drive(drive)
    project = project_of(controller, checked(name) if name else "", drive)
    if "interface" not in project.facts:
        raise ParameterError(f"a {type(controller).__name__} is no controller; expected one: it is exported only")
    return write(project, folder, force=force, more=lambda scratch: _compile(project, controller, portable, scratch))


def _compile(project: Project, controller: Controller | Driver | Racer, portable: bool, folder: Path) -> None:
    """Put the library beside its sources, the model or path too, and all of it into their manifest."""
    library = f"{project.name}{compiler.SUFFIX}"
    sources = [folder / with_prefix(name, project.name) for name in project.sources]
    made = compiler.compile_file(sources, folder / library, flags=project.flags, portable=portable)
    whole = isinstance(controller, Driver | Racer)
    record = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    record["build"] = {
        "library": library,
        "sha256": _sum(folder / library),
        **made,
        **machine(portable),
        **(keep_path(controller.path, folder) if whole else _keep_model(controller, folder)),
    }
    write_atomic(folder / "manifest.json", json.dumps(record, indent=2) + "\n")


def _keep_model(controller: Controller, target: Path) -> dict[str, Any]:
    """Write what predicts beside the library; what the manifest says of that."""
    said: dict[str, Any] = {"starts": callable(getattr(controller, "start", None))}
    try:
        save_record(controller.model, target / "model.json")
    except ParameterError as error:  # a function, say, which no file keeps
        said["without_model"] = str(error)
    return said


def _sum(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def load(folder: str | Path) -> BuiltController | BuiltDriver:
    """What `build` wrote, checked: its files, its machine, and what it decides on a recorded drive.

    Parameters
    ----------
    folder : str or Path
        Where it is. A library runs with all your rights: load what you trust.

    Returns
    -------
    BuiltController or BuiltDriver
        Ready to plan, or to drive; nothing is compiled.

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
    made = BuiltFolder(folder)
    return BuiltDriver(made) if made.record["kind"] in LOOPS else BuiltController(made)
