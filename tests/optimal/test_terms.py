"""Weights, limits and values: from names or dictionaries, checked either way."""

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from slipangle.control.marx.mpc import MultiARXMPC
from slipangle.control.mpc import MPC
from slipangle.control.speed.driver import SpeedDriver
from slipangle.errors import ParameterError
from slipangle.optimal.ocp import OCP
from slipangle.optimal.terms import Limits, Values, Weights
from tests.control.marx.test_mpc import BY_POSE
from tests.control.test_mpc import still
from tests.optimal.linear import Linear, double_integrator


@pytest.mark.parametrize("kind", [Values, Weights])
@pytest.mark.parametrize("bad", [math.nan, math.inf, "heavy", None, [1.0], 10**400, 1j])
def test_numbers_that_are_none_are_refused(kind, bad):
    for make in (lambda: kind(Y=bad), lambda: kind({"Y": bad})):
        with pytest.raises(ParameterError, match="'Y'"):
            make()


@pytest.mark.parametrize("bad", [(1.0, 0.0), (math.nan, 1.0), -1.0, "ab", None, (1, 2, 3), {}, 1j, math.nan])
def test_limits_that_are_none_are_refused(bad):
    for make in (lambda: Limits(Y=bad), lambda: Limits({"Y": bad})):
        with pytest.raises(ParameterError, match="'Y'"):
            make()


@pytest.mark.parametrize("kind", [Values, Weights, Limits])
def test_only_names_and_dictionaries_will_do(kind):
    for bad in ([("Y", 1.0)], "Y", 1.0, {1: 1.0}):
        with pytest.raises(ParameterError, match="expected"):
            kind(bad)
    assert kind({"Y": 1.0}, X=2.0) == kind(Y=1.0, X=2.0)
    odd = kind({"r[k-1]": 1.0})
    assert eval(repr(odd)) == odd
    for other in (copy.deepcopy(odd), pickle.loads(pickle.dumps(odd))):
        assert (other, hash(other)) == (odd, hash(odd))


@pytest.mark.parametrize("solver", ["ipopt", "realtime"])
def test_dictionaries_plan_as_the_classes_do(solver):
    plain = {
        "Q": {"p": 1.0, "v": 0.1},
        "R": {"a": 0.1},
        "S": {"a": 0.2},
        "terminal": {"p": 3.0},
        "limits": {"a": 2, "v": [-1.0, 1.0]},
        "rates": {"a": 5.0},
        "slack": {"v": 10.0},
        "slack_linear": {"v": 1.0},
        "safe": {"a": -0.5},
        "plausible": {"p": 1e3},
    }
    kinds = {"limits": Limits, "rates": Limits, "safe": Values, "plausible": Limits}
    mpc = MPC(double_integrator(), horizon=6, solver=solver, **plain)
    classes = MPC(
        double_integrator(), horizon=6, solver=solver, **{n: kinds.get(n, Weights)(v) for n, v in plain.items()}
    )
    x = np.array([1.0, 0.5])
    assert np.array_equal(mpc.plan(x, still(mpc)).u, classes.plan(x, still(classes)).u)
    for name in plain:
        assert isinstance(getattr(mpc.ocp if hasattr(mpc.ocp, name) else mpc, name), kinds.get(name, Weights))


@pytest.mark.parametrize("name", ["Q", "R", "S", "terminal", "slack", "slack_linear"])
@pytest.mark.parametrize("kind", [MPC, OCP])
def test_a_negative_weight_is_refused_wherever_it_stands(kind, name):
    good = {"Q": {"p": 1.0}, "R": {"a": 1.0}, "limits": {"v": 1.0}}
    channel = {"R": "a", "S": "a", "slack": "v", "slack_linear": "v"}.get(name, "p")
    with pytest.raises(ParameterError, match=f"weight of '{channel}' is -1"):
        kind(double_integrator(), horizon=3, **{**good, name: {channel: -1.0}})
    with pytest.raises(ParameterError, match=name):
        kind(double_integrator(), horizon=3, **{**good, name: [1.0]})


def test_the_other_controllers_check_too():
    with pytest.raises(ParameterError, match="'e_y' is -1"):
        replace(BY_POSE, Q={"e_y": -1.0})
    with pytest.raises(ParameterError, match="'delta'"):
        replace(BY_POSE, limits={"delta": (1.0, -1.0)})
    with pytest.raises(ParameterError, match="rates"):
        replace(BY_POSE, rates=3.0)
    assert isinstance(replace(BY_POSE, safe={"delta": 0.1}).safe, Values)
    assert isinstance(replace(BY_POSE, limits={"delta": 0.1}), MultiARXMPC)
    driver = SpeedDriver(kp=(1.0,), ki=(1.0,), limits=(-1.0, 1.0), drive={"T_f": 1.0, "T_r": 0.5})
    assert driver.inputs(2.0) == {"T_f": 2.0, "T_r": 1.0}
    with pytest.raises(ParameterError, match="'T_f'"):
        replace(driver, drive={"T_f": math.nan})


def test_names_that_are_no_identifiers_can_be_used():
    base = double_integrator()
    lagged = Linear(A=base.A, B=base.B, C=base.C, D=base.D, states=("r[k]", "r[k-1]"))
    mpc = MPC(lagged, solver="ipopt", horizon=5, Q={"r[k-1]": 1.0, "r[k]": 2.0}, R={"a": 1.0}, limits={"r[k-1]": 4.0})
    same = MPC(base, solver="ipopt", horizon=5, Q={"v": 1.0, "p": 2.0}, R={"a": 1.0}, limits={"v": 4.0})
    x = np.array([1.0, -0.5])
    assert mpc.plan(x, still(mpc)).u == pytest.approx(same.plan(x, still(same)).u)
