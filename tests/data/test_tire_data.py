"""TireData: checks, mirror, joining, sweeps."""

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels
from slipangle.data.tire_data import TireData, Tolerance, joined, levels
from slipangle.errors import NotFiniteError, ParameterError, TooShortError, UnitError
from tests.rig import CAMBERS, LOADS, PRESSURES, UNITS, channels

CORNERING = from_channels(channels(), UNITS)
BRAKING = from_channels(channels("drive/brake"), UNITS)


def small(**changes):
    n = 30
    values = {"slip_ratio": np.zeros(n), "slip_angle": np.linspace(-0.1, 0.1, n), "load": np.full(n, 1e3)}
    values |= {"F_x": np.zeros(n), "F_y": np.linspace(-1e3, 1e3, n)}
    return TireData(**(values | changes))


def test_sweeps_are_the_levels_of_the_rig():
    sweeps = CORNERING.sweeps()
    assert len(sweeps) == len(LOADS) * len(CAMBERS) * len(PRESSURES)
    expected = [(f, c, p) for f in LOADS for c in CAMBERS for p in PRESSURES]
    for sweep, (load, camber, pressure) in zip(sweeps, expected, strict=True):
        assert sweep.load == pytest.approx(load, abs=4)
        assert np.rad2deg(sweep.camber) == pytest.approx(camber, abs=0.02)
        assert sweep.pressure == pytest.approx(1e3 * pressure, abs=100)
        assert sweep.kind == "lateral"
        assert len(sweep.rows) == 240
    assert len(np.unique(np.concatenate([s.rows for s in sweeps]))) == CORNERING.n_samples
    assert {s.kind for s in BRAKING.sweeps()} == {"combined"}
    straight = BRAKING.rows(np.abs(BRAKING.slip_angle) < 0.01)
    assert {s.kind for s in straight.sweeps()} == {"longitudinal"}


def test_samples_between_levels_belong_to_none():
    rng = np.random.default_rng(0)
    ramp = np.linspace(500, 1000, 60)
    values = np.concatenate([500 + 5 * rng.standard_normal(800), ramp, 1000 + 5 * rng.standard_normal(800)])
    found, index = levels(values, 90.0)
    assert found == pytest.approx([500, 1000], abs=10)
    assert (index[830 - 10 : 830 + 10] == -1).all()
    assert (index[:800] == 0).all()
    assert (index[-800:] == 1).all()


def test_a_wide_tolerance_joins_loads():
    assert len(CORNERING.sweeps(Tolerance(load=2000.0, camber=0.2, pressure=5e4))) == 1


def test_mirror_keeps_the_physics():
    mirrored = CORNERING.mirrored()
    assert mirrored.F_y == pytest.approx(-CORNERING.F_y)
    assert mirrored.camber == pytest.approx(-CORNERING.camber)
    assert mirrored.F_x == pytest.approx(CORNERING.F_x)
    assert mirrored.mirrored().M_z == pytest.approx(CORNERING.M_z)
    assert np.corrcoef(mirrored.slip_angle, mirrored.F_y)[0, 1] > 0.8


def test_joining_and_thinning():
    both = joined([CORNERING, BRAKING], name="both")
    assert both.n_samples == CORNERING.n_samples + BRAKING.n_samples
    assert both.mu_y[: CORNERING.n_samples] == pytest.approx(CORNERING.mu_y)
    thin = both.thinned(1000)
    assert thin.n_samples == 1000
    assert len(np.unique(thin.slip_ratio)) > 100  # not the same places of every sweep
    assert thin.thinned(2000) is thin
    plain = joined([CORNERING, small()])
    assert plain.pressure is None
    assert any("pressure was measured in some" in note for note in plain.notes)
    with pytest.raises(TooShortError, match="no record"):
        joined([])


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"load": np.full(30, -1e3)}, ParameterError, "load .* down to -1000 N; expected positive"),
        ({"F_y": np.full(29, 0.0)}, ParameterError, "29 samples of F_y and 30 of load"),
        ({"F_x": np.full(30, np.inf)}, NotFiniteError, "F_x .* sample 0"),
        ({"F_y": np.full(30, 9e3)}, UnitError, "F_y .* 9 times the load"),
        ({"slip_angle": np.linspace(-12, 12, 30)}, UnitError, "slip_angle .* convert degrees"),
        ({"slip_ratio": np.linspace(-20, 20, 30)}, UnitError, "slip_ratio .* convert percent"),
        ({"load": np.empty(0)}, TooShortError, "holds no sample"),
    ],
)
def test_bad_data(changes, error, message):
    with pytest.raises(error, match=message):
        small(**changes)


def test_arrays_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        CORNERING.F_y[0] = 1.0


def test_levels_of_values_without_bounds():
    with pytest.raises(ParameterError, match=r"reach from 0 to 1e\+12, .* at most 1e\+04 times: leave outliers"):
        levels(np.array([0.0, 1.0, 1e12]), 90.0)
