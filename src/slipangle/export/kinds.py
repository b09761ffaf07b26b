"""Which project an exported thing becomes: one function, to which each kind of thing adds its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import singledispatch
from typing import Any

from slipangle.control.controller import Controller
from slipangle.control.driver import Driver
from slipangle.control.followers.compensated import Compensated
from slipangle.control.followers.followers import PathFollower
from slipangle.control.marx.adaptation import AdaptiveMultiARXMPC
from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.racing.racer import Racer
from slipangle.control.switched import SwitchedMPC
from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.estimate.ekf import EKF
from slipangle.estimate.side_slip_sensor import LearnedSideSlip
from slipangle.export.drivers import driver_project, standard_driver_drive
from slipangle.export.drives import Drive, standard_drive
from slipangle.export.estimators import estimator_project
from slipangle.export.followers import follower_project
from slipangle.export.marx import marx_project
from slipangle.export.models import model_project
from slipangle.export.mpc import as_in_c, mpc_project, said_alone
from slipangle.export.project import Project
from slipangle.export.racers import racer_project, standard_racer_drive
from slipangle.export.recursions import recursion_project
from slipangle.export.sensors import sensor_project
from slipangle.export.switched import switched_project
from slipangle.identify.linear.recursive import RecursiveARX
from slipangle.models.model import Model


@singledispatch
def project_of(thing: Any, name: str, drive: Drive | Dataset | int) -> Project:
    """The project of a thing; others register theirs.

    Parameters
    ----------
    thing : object
        What is exported.
    name : str
        The project's name, checked; empty for the kind's own.
    drive : Drive, Dataset or int
        What the replay repeats, or the number of steps of a drive of its own.

    Raises
    ------
    ParameterError
        If there is no C of such a thing.
    """
    raise ParameterError(
        f"a {type(thing).__name__} has no C; expected a model, an MPC solved in real time, a MultiARXMPC, a path "
        "follower, an EKF, an MHE, a learned SideSlipSensor, a RecursiveARX, a Driver or a Racer"
    )


def _driven(controller: Any, drive: Drive | Dataset | int, record: Any = standard_drive) -> Drive:
    """A recorded drive of a controller.

    Raises ParameterError if a data set is given, which says nothing of what a controller was asked.
    """
    if isinstance(drive, Drive):
        return drive
    if isinstance(drive, Dataset):
        raise ParameterError(
            "the drive is a Dataset; expected what a controller was asked: record it with slipangle.export.Recorder"
        )
    return record(controller, drive)


def _require_own(controller: Any, kind: type[Controller]) -> None:
    """Raise ParameterError if a subclass plans in another way than the class whose C there is."""
    if type(controller).plan is not kind.plan:
        raise ParameterError(
            f"a {type(controller).__name__} has a plan of its own, which has no C; expected a {kind.__name__}: export "
            "that"
        )


def _controller(kind: type, project: Callable[[Any, str, Drive], Project], named: str) -> None:
    """Register a kind of controller, and the name of its files by default."""

    def made(thing: Any, name: str, drive: Drive | Dataset | int) -> Project:
        _require_own(thing, kind)
        return project(thing, name or named, _driven(thing, drive))

    project_of.register(kind, made)


_controller(MultiARXMPC, marx_project, "marx")
_controller(AdaptiveMultiARXMPC, marx_project, "marx")
_controller(PathFollower, follower_project, "follower")


@project_of.register
def _(thing: MPC, name: str, drive: Drive | Dataset | int) -> Project:
    _require_own(thing, MPC)
    return said_alone(mpc_project(thing, name or "mpc", _driven(as_in_c(thing), drive)), thing)


@project_of.register
def _(thing: SwitchedMPC, name: str, drive: Drive | Dataset | int) -> Project:
    _require_own(thing, SwitchedMPC)
    asked = replace(thing, calm=as_in_c(thing.calm), limit=as_in_c(thing.limit))
    return said_alone(switched_project(thing, name or "switched", _driven(asked, drive)), thing.calm, thing.limit)


@project_of.register
def _(thing: Compensated, name: str, drive: Drive | Dataset | int) -> Project:
    _require_own(thing, Compensated)
    return follower_project(thing, name or "follower", _driven(thing, drive))


@project_of.register
def _(thing: Driver, name: str, drive: Drive | Dataset | int) -> Project:
    made = driver_project(thing, name or "driver", _driven(thing, drive, standard_driver_drive))
    return said_alone(made, thing.controller)


@project_of.register
def _(thing: Racer, name: str, drive: Drive | Dataset | int) -> Project:
    return racer_project(thing, name or "racer", _driven(thing, drive, standard_racer_drive))


@project_of.register
def _(thing: EKF, name: str, drive: Drive | Dataset | int) -> Project:
    if isinstance(drive, Drive):
        raise ParameterError("the drive is that of a controller; expected a Dataset, or a number of samples")
    return estimator_project(thing, name or "estimator", drive)


@project_of.register
def _(thing: RecursiveARX, name: str, drive: Drive | Dataset | int) -> Project:
    if isinstance(drive, Drive):
        raise ParameterError("the drive is that of a controller; expected a Dataset, or a number of samples")
    return recursion_project(thing, name or "recursion", drive)


@project_of.register
def _(thing: LearnedSideSlip, name: str, drive: Drive | Dataset | int) -> Project:
    if isinstance(drive, Drive):
        raise ParameterError("the drive is that of a controller; expected a Dataset, or a number of samples")
    return sensor_project(thing, name or "sensor", drive)


@project_of.register
def _(thing: Model, name: str, drive: Drive | Dataset | int) -> Project:
    if isinstance(drive, Drive):
        raise ParameterError("the drive is that of a controller; expected a Dataset, or a number of samples")
    return model_project(thing, name or "model", drive)
