"""Models alike but for values of parameters share the C of their free runs; any other difference tells them apart."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from slipangle.identify.physics.forward_code import code_of
from slipangle.identify.physics.structure import structure
from slipangle.models.vehicles.saturating_bicycle import SaturatingBicycle, SaturatingBicycleParams
from slipangle.models.wrappers.delayed import Delayed

KNOWN = dict(mass=1300.0, inertia_z=1900.0, wheelbase=2.6, l_f=1.2, C_f=9e4, C_r=1.2e5)
FREE = ("C_f", "steering_offset", "delay_delta")


def car(longest=0.1, delay=0.02, **other):
    kinds = {n: other.pop(n) for n in ("dt", "outputs", "small_angles", "substeps") if n in other}
    bicycle = SaturatingBicycle(params=SaturatingBicycleParams(**KNOWN | other), **{"dt": 0.02} | kinds)
    return Delayed(bicycle, delays={"delta": delay}, longest=longest)


@pytest.mark.parametrize("other", [{"mass": 1500.0}, {"C_f": 8e4}, {"delay": 0.05}, {"steering_offset": 0.01}], ids=str)
def test_other_values_of_parameters_are_the_same_code_with_other_numbers(other):
    one, two = code_of(car(), FREE), code_of(car(**other), FREE)
    assert one.run is two.run
    assert one.drive is two.drive
    assert np.array_equal(one.rest, two.rest) == ("mass" not in other)


@pytest.mark.parametrize(
    "other",
    [{"bias_r": 0.01}, {"outputs": ("v_y", "r")}, {"small_angles": False}, {"longest": 0.2}],
    ids=str,
)
def test_other_equations_are_other_code(other):
    """A parameter that is zero is none of the code, so one that is not makes another."""
    one, two = code_of(car(), FREE), code_of(car(**other), FREE)
    assert (one.run, one.drive) != (two.run, two.drive)


def test_equations_that_hold_numbers_of_their_own_are_written_anew():
    """A subclass that looks at a value while it writes its equations: the code has it, so no other may share it."""

    class Branching(SaturatingBicycle):
        def derivative(self, x, u):
            slope = super().derivative(x, u)
            return 2.0 * slope if self.params.mass > 1400.0 else slope

    light = Branching(params=SaturatingBicycleParams(**KNOWN), dt=0.02)
    heavy = replace(light, params=light.params.with_values(mass=1500.0))
    assert code_of(light, ("C_f",)).run != code_of(heavy, ("C_f",)).run
    assert code_of(light, ("C_f",)).run == code_of(light, ("C_f",)).run


def test_what_others_wrote_is_not_taken_for_known():
    """A function or a class of a user may look at a number elsewhere, which may be another by the next fit."""

    @dataclass(frozen=True)
    class Theirs:
        C_f: float = 1.0

    made: dict[str, Any] = {}
    exec("def typed(x): return x", made)
    for thing in (Theirs(), lambda x: x, (1.0, Theirs()), made["typed"]):
        with pytest.raises(TypeError, match="is made of is not known"):
            structure(thing)
