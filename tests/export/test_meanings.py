"""What a header or a description says of a name is all that its reader knows: unit, meaning and sign."""

import re
from pathlib import Path

import pytest

import slipangle as sa
from slipangle.codegen import compiler
from slipangle.data.channels import INNER, STANDARD
from slipangle.export.fmi import _of_model
from slipangle.export.kinds import project_of
from slipangle.export.meanings import known
from slipangle.models.vehicles.catalogue import SOUSA_TABLE_7_2
from slipangle.paths.lane_change import double_lane_change
from tests.export.test_drivers import driver
from tests.export.test_mpc import STANLEY, controller
from tests.models.all_models import ALL_MODELS

needs_compiler = pytest.mark.skipif(compiler.compiler() is None, reason=compiler.sentence())
ROOT = Path(__file__).parents[2]
VEHICLES = ("bicycle", "relaxing bicycle", "nonlinear bicycle", "steered, with load transfer", "single track, Radau")
VEHICLES += ("dual track, aided", "bicycle with late steering", "bicycle pushed by a wind", "bicycle that answers late")
VEHICLES += ("ARX", "NARX, MIMO, delay", "hybrid of a bicycle", "ensemble of hybrids", "torque-vectored, banked")


def defined(thing, letter):
    """What the header says after each name of a list."""
    text = project_of(thing, "car", 2).everything["car.h"]
    return dict(re.findall(rf"^#define CAR_{letter}_(\w+) \d+ /\* .*?(\[[^\]]*\][^\]]*?) \*/$", text, re.MULTILINE))


def test_units_are_those_of_the_nomenclature():
    """Of every name inside of models that its tables have."""
    text = (ROOT / "docs" / "nomenclature.md").read_text()
    told = {}
    for names, units in re.findall(r"^\| (`.+?) \|.*\| ([^|]+) \|$", text, re.MULTILINE):
        listed = re.findall(r"`(\w+)`", names)
        each = units.split(", ")
        told |= dict(zip(listed, [*each, *[each[-1]] * len(listed)], strict=False))
    shared = set(told) & set(INNER)
    assert len(shared) > 15
    assert {n: told[n] for n in shared} == {n: INNER[n].unit for n in shared}
    assert not set(INNER) & set(STANDARD)


@pytest.mark.parametrize("name", VEHICLES)
def test_nothing_of_a_vehicle_is_without_its_unit(name):
    model = ALL_MODELS[name]
    for listed in (model.states, model.inputs, model.outputs):
        assert [n for n in listed if known(n, model.quantities) is None] == []


def test_a_brake_is_a_pedal_or_a_pressure():
    """The dual track's is 0 to 1, the longitudinal model's a pressure; an FMU of the one is not in pascals either."""
    car = ALL_MODELS["dual track, front drive"]
    assert known("brake", car.quantities).unit == "-"
    assert known("brake", sa.OnGround(sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.02)).quantities).unit == "Pa"
    units = {v.name: (v.unit, v.doc) for v in _of_model(car).variables}
    assert units["brake"] == ("-", "brake pedal, 0 to 1")
    assert units["state.phi"] == ("rad", "roll of the body, positive right side down")


def test_names_that_are_no_vehicles_mean_nothing():
    """A pendulum's angle is no pitch."""
    assert known("theta", ALL_MODELS["pendulum"].quantities) is None


@pytest.mark.parametrize(
    ("name", "unit", "doc"),
    [
        ("r[k]", "rad/s", "yaw rate, positive to the left"),
        ("r[k-2]", "rad/s", "yaw rate, positive to the left, 2 samples before"),
        ("delta(k-1)", "rad", "steering angle of the front road wheels, positive to the left, 1 sample before"),
        ("1: base r", "rad/s", "yaw rate, positive to the left, of the base, of member 1"),
        ("d_r", "rad/s2", "rate by which r changes more than the model says"),
        ("lag_delta", "s", "time constant of the lag of delta"),
    ],
)
def test_past_values_members_and_pushes(name, unit, doc):
    said = known(name, {})
    assert (said.unit, said.doc) == (unit, doc)


@pytest.mark.parametrize("name", ["x0", "e_r", "e_y", "mine[k-1]", "d_X[k", "0: mine", "lag_mine", "_lagged"])
def test_what_is_not_known_is_left_alone(name):
    assert known(name, {}) is None


@needs_compiler
def test_a_controllers_header_says_rates():
    assert defined(controller(3), "U") == {"DELTA": "[rad], -0.35 to 0.35, -1 to 1 per second"}
    assert defined(STANLEY, "U")["DELTA"].endswith(f"[rad], {-STANLEY.limit:.6g} to {STANLEY.limit:.6g}")


def test_an_estimators_parameters_have_units():
    start = sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("r",))
    ekf = sa.EKF(start=start, free=("C_f", "inertia_z"), noise_std={"r": 0.01})
    assert defined(ekf, "P") == {"C_F": "[N/rad]", "INERTIA_Z": "[kg m2]"}


@needs_compiler
def test_a_header_says_how_late_an_output_is_taken_to_be():
    start = sa.Bicycle(params=SOUSA_TABLE_7_2, dt=0.02, outputs=("v_y", "r"))
    ekf = sa.EKF(start=start, noise_std={"v_y": 0.05, "r": 0.01}, late={"v_y": 0.06})
    assert defined(ekf, "Y") == {"V_Y": "[m/s], 0.05, 60 ms late", "R": "[rad/s], 0.01"}
    whole = driver(double_lane_change(20.0), horizon=3, late={"X": 0.1})
    said = defined(whole, "Y")
    assert (said["X"], said["PSI"]) == ("[m], 0.02, 100 ms late", "[rad], 0.001")
