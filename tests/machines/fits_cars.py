"""`identify_car`: which corrections it keeps, and how far its intervals reach, must not depend on the machine."""

from __future__ import annotations

from benchmarks.foreign_cars.real import CARS

from slipangle.identify.car.identify_car import identify_car
from tests.identify.car.test_identify_car import KNOWN, drives, log
from tests.machines.fits_black_box import free_run
from tests.machines.registry import Errors, fit


def errors(train, test, **known) -> Errors:
    """Free runs, and ends of the interval of the front stiffness over its value."""
    found = identify_car(train, **known)
    low, high = found.interval("C_f")
    value = found.model.value("C_f")
    return {**free_run(found.model, train, test), "train low C_f": low / value, "train high C_f": high / value}


@fit("identify_car, five simulated drives")
def _() -> Errors:
    return errors(drives(), log(20.0, 9).hold_mean(), **KNOWN)


@fit("identify_car, DART")
def _() -> Errors:
    car = CARS["DART, 1:10"]
    train, test = (data.hold_mean() for data in car.logs())
    return errors(train, test, mass=car.known.mass, wheelbase=car.known.wheelbase, l_f=car.known.l_f)
