"""Cars on tires of files: axle curves, what the file knows of rolling, the dual track around a bicycle."""

import math
from dataclasses import replace

import numpy as np
import pytest

from slipangle.data.dataset import Dataset
from slipangle.errors import ParameterError
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.tires.magic_formula.coefficients import MF52Coefficients, MF61Coefficients
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.simple import LinearTire, Rolling
from slipangle.models.vehicles.catalogue import PASSENGER_TIRE, SOUSA_CAR_7, SOUSA_TABLE_6_1
from slipangle.models.vehicles.on_tires import axle_force, bicycle_on, dual_track_on, peak_friction, with_tires
from slipangle.models.vehicles.tire_bicycle import TireBicycle, TireBicycleParams

CHASSIS = TireBicycleParams(mass=1500.0, inertia_z=2500.0, wheelbase=2.7, l_f=1.2)
PLAIN = dict(FNOMIN=4000, UNLOADED_RADIUS=0.31, PCX1=1.6, PDX1=1.2, PKX1=22, PCY1=1.3, PDY1=1.1, PKY1=-20, PKY2=2.0)


def stiffness_by_hand(load, scale=1.0):
    """4.E25 of `PLAIN`, both wheels."""
    return 2 * scale * 20 * 4000 * math.sin(2 * math.atan(load / 8000))


def test_the_bicycle_has_the_stiffness_of_its_axles():
    tire = MagicFormulaTire(coefficients=MF61Coefficients(**PLAIN))
    load_f, load_r = 0.5 * 1500 * 9.81 * 1.5 / 2.7, 0.5 * 1500 * 9.81 * 1.2 / 2.7
    found = bicycle_on(CHASSIS, tire)
    assert found.C_f == pytest.approx(stiffness_by_hand(load_f), rel=1e-3)
    assert found.C_r == pytest.approx(stiffness_by_hand(load_r), rel=1e-3)
    scaled = TireBicycle(params=CHASSIS.with_values(LKY_f=1.3), dt=0.05, tire_f=tire, tire_r=tire)
    assert scaled.bicycle.C_f == pytest.approx(stiffness_by_hand(load_f, 1.3), rel=1e-3)
    assert peak_friction(tire, 4000.0) == pytest.approx(1.1, rel=1e-3)
    assert peak_friction(tire.scaled(LMUY=0.7), 4000.0) == pytest.approx(0.77, rel=1e-3)


def test_rolling_comes_from_the_file():
    """Paper of Besselink et al., eqs. 1, 7, 17 to 19 and A48, and 4.E70 of the book, by hand."""
    more = dict(VERTICAL_STIFFNESS=2e5, BREFF=8.0, DREFF=0.3, FREFF=0.05, QSY1=0.012, LONGVL=20.0)
    stiff = dict(LATERAL_STIFFNESS=1.2e5, LONGITUDINAL_STIFFNESS=3e5)
    tire = MagicFormulaTire(coefficients=MF61Coefficients(**PLAIN, **more, **stiff))
    found, load = tire.rolling(3000.0), 3000.0
    radius = 0.31 - 4000 / 2e5 * (0.3 * math.atan(8 * 0.75) + 0.05 * 0.75)
    assert found.radius == pytest.approx(radius)
    assert found.relaxation_x == pytest.approx(3000 * 22 / 3e5)
    assert found.relaxation_y == pytest.approx(stiffness_by_hand(load) / 2 / 1.2e5)
    assert found.rolling_resistance == pytest.approx(0.012 * 0.31 / radius)
    assert MagicFormulaTire(coefficients=MF61Coefficients(**PLAIN)).rolling(load) == Rolling(radius=0.31)
    older = MagicFormulaTire(coefficients=MF52Coefficients(**PLAIN, PTX1=1.5, PTY1=2.0, PTY2=1.8)).rolling(4000.0)
    assert older.relaxation_x == pytest.approx(1.5 * 0.31)
    assert older.relaxation_y == pytest.approx(2.0 * math.sin(2 * math.atan(1 / 1.8)) * 0.31)
    assert LinearTire(C_alpha=5e4).rolling(load) == Rolling()


def test_a_car_takes_from_its_tires_what_they_know():
    tire = MagicFormulaTire(coefficients=MF61Coefficients(**PLAIN, LATERAL_STIFFNESS=1.2e5, LONGITUDINAL_STIFFNESS=3e5))
    car = with_tires(SOUSA_CAR_7, tire)
    loads = [0.5 * 2000 * 9.81 * arm / 3.0 for arm in (1.6, 1.4)]
    assert car.relaxation_y == pytest.approx(np.mean([stiffness_by_hand(f) / 2 / 1.2e5 for f in loads]))
    assert car.radius == 0.31
    assert car.rolling_resistance == SOUSA_CAR_7.rolling_resistance  # the file has none
    assert with_tires(SOUSA_TABLE_6_1, tire).radius == 0.31
    assert with_tires(SOUSA_CAR_7, LinearTire(C_alpha=5e4)) == SOUSA_CAR_7


def test_a_dual_track_around_a_bicycle():
    car = dual_track_on(CHASSIS, PASSENGER_TIRE, car={"height": 0.6})
    assert (car.mass, car.wheelbase, car.l_f, car.height, car.radius) == (1500.0, 2.7, 1.2, 0.6, 0.344)
    assert car.track_f == pytest.approx(0.55 * 2.7)
    small = dual_track_on(
        CHASSIS.with_values(mass=1.8, inertia_z=0.03, wheelbase=0.26, l_f=0.12), LinearTire(C_alpha=40.0)
    )
    assert small.radius == pytest.approx(0.12 * 0.26)
    with pytest.raises(ParameterError, match="no parameter 'hight'; nearest"):
        dual_track_on(CHASSIS, PASSENGER_TIRE, car={"hight": 0.6})


def test_a_mirrored_tire_pushes_the_other_way():
    """Conicity of a tire that describes a side cancels over the axle; without a side it adds up."""
    c = MF61Coefficients(**PLAIN, PVY1=0.05)
    sided = MagicFormulaTire(coefficients=c, side="LEFT")
    assert axle_force(sided, 0.0, 4000.0) == pytest.approx(0.0, abs=1e-9)
    assert axle_force(replace(sided, side=""), 0.0, 4000.0) == pytest.approx(2 * 0.05 * 4000)
    moved = axle_force(sided, 0.0, 4000.0, 1000.0)  # the right one carries more, and pushes to the other side
    assert moved == pytest.approx(0.05 * (3000 - 5000))


def test_load_transfer_takes_side_force():
    """The curve of stiffness over load bends down: unequal loads give less."""
    at = [float(axle_force(PASSENGER_TIRE, 0.05, 4000.0, t)) for t in (0.0, 1500.0, -1500.0)]
    assert at[1] == pytest.approx(at[2])
    assert at[1] < 0.99 * at[0]


def test_scaling_factors_are_recovered():
    """From a noise-free run at up to 0.9 g, whatever the file's own factors."""
    tire = MagicFormulaTire(coefficients=replace(PASSENGER_TIRE.coefficients, LMUY=0.95, LKY=1.1))
    true = {"LMUY_f": 0.8, "LKY_f": 0.9, "LMUY_r": 0.9, "LKY_r": 1.2}
    car = TireBicycle(params=CHASSIS.with_values(**true), dt=0.05, tire_f=tire, tire_r=tire, outputs=("v_y", "r"))
    t = 0.05 * np.arange(400)
    inputs = {
        "delta": 0.1 * np.sin(0.8 * t + 0.02 * t * t) * np.linspace(0.2, 1, len(t)),
        "v_x": 21 + 3 * np.sin(t / 5),
    }
    run = car.simulate(Dataset.from_arrays(inputs, dict.fromkeys(car.outputs, 0 * t), car.dt))
    data = Dataset.from_arrays(inputs, {o: run.channel(o) for o in car.outputs}, car.dt)
    assert np.max(np.abs(data["r"] * inputs["v_x"])) > 7.0
    start = replace(car, params=CHASSIS)
    found = GreyBox(start=start, free=tuple(true)).fit(data)
    for name, value in true.items():
        assert found.value(name) == pytest.approx(value, rel=1e-6), name
    front, _ = found.scaled_tires
    assert front.coefficients.LMUY == pytest.approx(0.95 * 0.8, rel=1e-6)


def test_what_has_no_scaling_factors_says_so():
    with pytest.raises(ParameterError, match="a LinearTire has no scaling factor LKY; expected a Magic Formula tire"):
        LinearTire(C_alpha=5e4).scaled(LMUY=1.0, LKY=1.1)
    with pytest.raises(ParameterError, match="PDY1 is no scaling factor"):
        PASSENGER_TIRE.scaled(PDY1=1.1)
    with pytest.raises(ParameterError, match="no parameter 'LMU'"):
        PASSENGER_TIRE.scaled(LMU=1.1)
