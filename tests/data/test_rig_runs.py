"""Runs of a rig as they are: units that no file names, standstill and warm-up, runs that contradict each other."""

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels, read_ttc
from slipangle.data.rig_runs import disagreements, offsets, without_offsets
from slipangle.data.tire_data import joined
from tests.rig import UNITS, channels, pounds, write_dat, write_mat

SIGNALS = ("slip_ratio", "slip_angle", "load", "camber", "pressure", "speed", "F_x", "F_y", "M_x", "M_z", "temperature")


def same(a, b, tolerance=1e-5):
    for key in SIGNALS:
        assert getattr(a, key) == pytest.approx(getattr(b, key), rel=tolerance, abs=10 * tolerance), key


def thin(kind="cornering"):
    return {k: v[:: 9 if kind == "cornering" else 27] for k, v in channels(kind).items()}


def us(columns):
    """In US units, the temperature too; with their names."""
    changed, units = pounds(columns)
    return changed | {"TSTC": columns["TSTC"] * 1.8 + 32}, units | {"TSTC": "deg F"}


def test_us_units_are_told_by_the_pressure(tmp_path):
    columns = thin()
    reference = from_channels(columns, UNITS)
    write_mat(tmp_path / "a.mat", us(columns)[0])  # no struct that names units
    found = read_ttc(tmp_path / "a.mat")
    same(found, reference)
    assert "does not name its unit of force: pounds, miles per hour and psi taken, by the pressure of" in found.notes[1]
    metric = from_channels(columns, {})
    assert "newtons, km/h and kPa taken, by the pressure of 76" in metric.notes[1]
    assert not any("unit of force" in note for note in reference.notes)


def test_without_pressure_the_units_are_asked_for():
    columns = us(thin())[0]
    del columns["P"]
    assert "nothing in the file confirms" in from_channels(columns, {}).notes[1]
    asked = from_channels(columns, {}, unnamed="US")
    assert asked.load.mean() == pytest.approx(from_channels(thin(), UNITS).load.mean(), rel=1e-6)


def test_units_as_rigs_write_them(tmp_path):
    """SAE in the row of units of a slip ratio, and gauge pressure."""
    columns, units = us(thin("drive/brake"))
    reference = from_channels(thin("drive/brake"), UNITS)
    write_dat(tmp_path / "a.dat", columns, units | {"SL": "SAE", "P": "psig"})
    same(read_ttc(tmp_path / "a.dat"), reference)


def started(n=400):
    """A run whose belt starts from standstill, slip being nonsense meanwhile, and whose tread warms up."""
    columns = {k: v[::9] for k, v in channels("drive/brake").items()}
    size = len(columns["V"])
    rng = np.random.default_rng(1)
    rising = {k: np.concatenate([v[:n], v]) for k, v in columns.items()}
    rising["V"][:n] = np.linspace(0.03, 36.0, n)
    rising["SL"][:n] = rng.uniform(-1.45, 1.4, n)
    rising["FX"][:n] = rng.normal(0, 20, n)
    rising["TSTC"] = np.concatenate([np.full(n, 25.0), 60 - 30 * np.exp(-np.arange(size) / (0.03 * size))])
    return rising, columns


def test_standstill_and_warm_up_are_cut():
    rising, columns = started()
    data = from_channels(rising, UNITS)
    said = " ".join(data.notes)
    assert "samples left out at speeds that the run was not held at, 0.03 to 36" in said
    assert "samples of the warm-up left out, 30 degC up to 57 degC" in said
    assert "a positive slip ratio brakes" not in said
    assert data.speed.min() > 10.0
    assert data.temperature.min() > 56.9
    assert data.n_samples > 0.7 * len(columns["V"])
    warm = from_channels(rising, UNITS, warm_up=False)
    assert warm.n_samples == len(columns["V"])
    assert warm.temperature.min() == pytest.approx(30.0)


def test_several_speeds_are_all_kept():
    columns = thin()
    half = len(columns["V"]) // 2
    columns["V"][:half] *= 0.5
    assert from_channels(columns, UNITS).n_samples == len(columns["V"])


def test_a_tread_that_warms_up_all_along_is_not_cut():
    columns = thin()
    columns["TSTC"] = np.linspace(30, 80, len(columns["V"]))
    data = from_channels(columns, UNITS)
    assert data.n_samples == len(columns["V"])
    assert "warms up all along, from 30 to 80 degC: nothing was cut" in " ".join(data.notes)


def two_runs(offset=0.0):
    cornering = from_channels(channels(), UNITS, name="cornering")
    columns = channels("drive/brake", seed=3)
    columns["MX"] = columns["MX"] + offset * np.abs(columns["FZ"])
    return cornering, from_channels(columns, UNITS, name="drive")


def test_runs_that_disagree_are_named():
    parts = two_runs(-0.04)
    data = joined(parts)
    assert [len(rows) for rows in data.runs] == [len(p) for p in parts]
    (said,) = disagreements(data, [p.name for p in parts])
    assert "M_x of 'drive' is -0.04 m of the load off that of 'cornering' at equal slip and load" in said
    assert not disagreements(joined(two_runs()))
    assert not disagreements(parts[0])


def test_offsets_can_be_removed():
    data = without_offsets(joined(two_runs(-0.04)))
    clean = joined(two_runs())
    assert np.mean(data.M_x - clean.M_x) == pytest.approx(0.0, abs=0.002 * 667)
    assert "M_x of run 2 moved by +0.04 m of the load to the level of run 1" in " ".join(data.notes)
    assert np.array_equal(data.F_y, clean.F_y)
    assert max(abs(o.share) / o.spread for o in offsets(data)) < 0.2
