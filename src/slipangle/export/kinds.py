"""Which project an exported thing becomes: one function, to which each kind of thing adds its own."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from slipangle.control.mpc import MPC
from slipangle.errors import ParameterError
from slipangle.export.drives import Drive, standard_drive
from slipangle.export.mpc import mpc_project
from slipangle.export.project import Project


@singledispatch
def project_of(thing: Any, name: str, drive: Drive | int) -> Project:
    """The project of a thing; others register theirs.

    Parameters
    ----------
    thing : object
        What is exported.
    name : str
        The project's name, checked; empty for the kind's own.
    drive : Drive or int
        What the replay repeats, or the number of steps of a drive of its own.

    Raises
    ------
    ParameterError
        If there is no C of such a thing.
    """
    raise ParameterError(f"a {type(thing).__name__} has no C; expected an MPC solved in real time")


@project_of.register
def _(thing: MPC, name: str, drive: Drive | int) -> Project:
    return mpc_project(thing, name or "mpc", drive if isinstance(drive, Drive) else standard_drive(thing, drive))
