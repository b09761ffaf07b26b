"""Runs of the Tire Test Consortium: every layout and sign system gives the same data; bad files get one sentence."""

import contextlib

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels, read_ttc
from slipangle.errors import (
    ExcitationError,
    FormatError,
    MissingColumnError,
    MissingFileError,
    SlipangleError,
    TooShortError,
    UnitError,
)
from tests.rig import TIRE, UNITS, channels, pounds, write_dat, write_mat

SIGNALS = ("slip_ratio", "slip_angle", "load", "camber", "pressure", "speed", "F_x", "F_y", "M_x", "M_z")


def same(a, b, tolerance=1e-6):
    for key in SIGNALS:
        assert getattr(a, key) == pytest.approx(getattr(b, key), rel=tolerance, abs=tolerance * 10), key


@pytest.mark.parametrize("kind", ["cornering", "drive/brake"])
@pytest.mark.parametrize(
    ("z_down", "opposes", "name"),
    [(True, True, "SAE"), (False, True, "ISO-W"), (True, False, "adapted SAE"), (False, False, "turned round")],
)
def test_every_sign_system_gives_the_same_data(kind, z_down, opposes, name):
    every = slice(None, None, 3)
    reference, found = (
        from_channels({k: v[every] for k, v in channels(kind, **signs).items()}, UNITS)
        for signs in ({}, {"z_down": z_down, "opposes": opposes, "ratio_turned": not opposes})
    )
    assert name in found.notes[0]
    same(found, reference)


def held(angle, *, opposes, z_down=True):
    """A drive/brake run at one slip angle [deg], of a tire whose side force pulls to one side a little."""
    rng, ratio = np.random.default_rng(0), np.tile(0.2 * np.sin(np.linspace(0, 2 * np.pi, 400, endpoint=False)), 5)
    load, alpha = np.repeat([220.0, 440.0, 660.0, 880.0, 440.0], 400), angle + 0.05 * rng.normal(size=2000)
    left = load * (0.02 + 2.2 * np.sin(1.4 * np.arctan(0.2 * alpha))) / np.sqrt(1 + (8 * ratio) ** 2)
    side = -1.0 if z_down else 1.0  # our y in the file's axes
    columns = {"SA": alpha * side * (-1.0 if opposes else 1.0), "SL": ratio, "FY": side * left, "FZ": side * load}
    columns["FX"] = load * 2.2 * np.sin(1.5 * np.arctan(12 * ratio))
    return {**columns, "MZ": rng.normal(size=2000), "P": np.full(2000, 83.0)}


@pytest.mark.parametrize("angle", [-6.0, -1.5, 1.5, 3.0])
@pytest.mark.parametrize("opposes", [True, False])
@pytest.mark.parametrize("z_down", [True, False])
def test_a_run_at_one_slip_angle_shows_its_sign(angle, opposes, z_down):
    data = from_channels(held(angle, opposes=opposes, z_down=z_down), UNITS)
    assert np.rad2deg(np.median(data.slip_angle)) == pytest.approx(angle, abs=0.01)
    assert np.sign(np.median(data.F_y)) == np.sign(angle)
    assert f"SA > 0 gives FY {'< 0' if opposes else '> 0'}," in data.notes[0]
    assert "that MZ aligns in right-handed axes is taken" in data.notes[0]


@pytest.mark.parametrize("opposes", [True, False])
def test_a_run_at_no_slip_angle_shows_none_and_says_so(opposes):
    data = from_channels(held(0.0, opposes=opposes), UNITS)
    assert "that SA > 0 gives FY < 0 is taken, at this slip angle the data do not tell" in data.notes[0]


def test_signs_are_ours():
    data = from_channels(channels(), UNITS)
    assert data.load.min() > 0
    assert np.corrcoef(data.slip_angle, data.F_y)[0, 1] > 0.8
    straight = np.abs(data.slip_angle) < 0.03
    assert np.corrcoef(data.M_z[straight], data.F_y[straight])[0, 1] < -0.5
    braking = from_channels(channels("drive/brake"), UNITS)
    assert np.corrcoef(braking.slip_ratio, braking.F_x)[0, 1] > 0.5
    assert braking.slip_ratio.max() == pytest.approx(0.3 / 1.3)  # counted on the larger speed when driving
    assert braking.slip_ratio.min() == pytest.approx(-0.3)


def test_data_are_those_of_the_tire():
    data = from_channels(channels(noise=0.0), UNITS)
    f = TIRE.evaluate(0.0, -data.slip_angle, data.load, axes="ISO-W", camber=data.camber, pressure=data.pressure)
    assert data.F_y == pytest.approx(f.F_y, rel=1e-9, abs=1e-9)
    assert data.speed.mean() == pytest.approx(40 / 3.6, rel=1e-3)


def test_a_moment_against_the_axes_is_turned():
    columns = channels()
    reference = from_channels(columns, UNITS)
    found = from_channels({**columns, "MZ": -columns["MZ"]}, UNITS)
    assert "MZ points against" in found.notes[0]
    same(found, reference)


@pytest.mark.parametrize("kind", ["cornering", "drive/brake"])
def test_files_of_every_layout(tmp_path, kind):
    columns = {k: v[:: 9 if kind == "cornering" else 27] for k, v in channels(kind).items()}
    reference = from_channels(columns, UNITS)
    write_mat(tmp_path / "a.mat", columns)
    write_mat(tmp_path / "b.mat", columns, UNITS)
    write_mat(tmp_path / "c.mat", *pounds(columns))
    write_dat(tmp_path / "d.dat", columns)
    write_dat(tmp_path / "e.dat", columns, None)
    write_dat(tmp_path / "f.dat", *pounds(columns))
    for letter, suffix in zip("abcdef", ("mat", "mat", "mat", "dat", "dat", "dat"), strict=True):
        found = read_ttc(tmp_path / f"{letter}.{suffix}")
        same(found, reference, 1e-5)
        assert found.name == letter


def test_loaded_samples_only():
    columns = channels()
    n = len(columns["SA"])
    columns["FZ"] = columns["FZ"].copy()
    columns["FZ"][:500] = -3.0
    columns["FY"] = columns["FY"].copy()
    columns["FY"][500] = np.nan
    data = from_channels(columns, UNITS)
    assert data.n_samples == n - 501
    assert f"501 of {n} samples" in " ".join(data.notes)


def test_slip_ratio_on_the_loaded_radius_is_said():
    columns = channels("drive/brake")
    columns["SR"] = columns.pop("SL") + 0.01
    assert "SR, on the loaded radius" in " ".join(from_channels(columns, UNITS).notes)
    assert "free rolling" in " ".join(from_channels(channels(), UNITS).notes)


def one_sided():
    columns = channels()
    return {k: v[columns["SA"] > 0] for k, v in columns.items()}


def test_one_side_can_be_read():
    """Half a sweep shows its signs; only a fit needs both sides."""
    same(from_channels(one_sided(), UNITS), from_channels(channels(), UNITS).rows(channels()["SA"] > 0))


def without(name):
    return {k: v for k, v in channels().items() if k != name}


@pytest.mark.parametrize(
    ("columns", "units", "error", "message"),
    [
        (without("FZ"), UNITS, MissingColumnError, "no channel FZ; nearest are 'MZ', 'FY', 'FX'"),
        (channels(), {**UNITS, "FY": "lb"}, UnitError, "FX in N, FY in lbf, FZ in N; expected one"),
        (channels(), {**UNITS, "SA": "furlong"}, UnitError, "SA in 'furlong', an unknown unit"),
        (channels(), {**UNITS, "P": "deg"}, UnitError, "P of 'run' is given in 'deg', which is angle"),
        ({**channels(), "FZ": channels()["FZ"] / 4.448}, {}, UnitError, "different units, newtons and pounds"),
        ({**channels(), "SA": np.deg2rad(channels()["SA"])}, {}, UnitError, "it may be in radians"),
        ({**channels(), "SA": 0 * channels()["SA"] + 1}, UNITS, ExcitationError, "neither slip angle nor slip ratio"),
        ({**channels(), "FY": np.roll(channels()["FY"], 60)}, UNITS, ExcitationError, "hardly go together"),
        ({**channels(), "SA": channels()["SA"][:-1]}, UNITS, FormatError, "expected as many in each"),
        ({k: v[:10] for k, v in channels().items()}, UNITS, TooShortError, "10 loaded samples"),
        ({**channels(), "FZ": np.full(len(channels()["FZ"]), np.nan)}, UNITS, TooShortError, "0 loaded samples"),
    ],
)
def test_bad_channels(columns, units, error, message):
    with pytest.raises(error, match=message) as caught:
        from_channels(columns, units)
    assert "\n" not in str(caught.value)


def test_bad_files(tmp_path):
    with pytest.raises(MissingFileError, match="does not exist"):
        read_ttc(tmp_path / "no.mat")
    cases = {
        "a.csv": ("SA,FY", FormatError, "expected .mat or .dat"),
        "b.dat": ("title\n1\t2\t3\n", FormatError, "no line of channel names"),
        "c.dat": ("t\nSA\tFX\tFY\tFZ\ndeg\tN\tN\tN\n1\t2\t3\n", FormatError, "line 4 of .* has 3 values; expected 4"),
        "d.dat": ("t\nSA\tFX\tFY\tFZ\ndeg\tN\tN\tN\n1\t2\t3\tx\n", FormatError, "line 4 of .* holds 'x'"),
        "e.dat": ("t\nSA\tFX\tFY\tFZ\ndeg\tN\tN\tN\n", TooShortError, "no line of numbers"),
        "f.mat": ("not a matlab file", FormatError, "not a MATLAB file of version 5 to 7"),
    }
    for file, (text, error, message) in cases.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
        with pytest.raises(error, match=message):
            read_ttc(tmp_path / file)
    write_mat(tmp_path / "g.mat", {"x": np.zeros(3)})
    with pytest.raises(MissingColumnError, match="none of the channels"):
        read_ttc(tmp_path / "g.mat")


@pytest.mark.parametrize("seed", range(20))
def test_damaged_files_never_end_in_a_traceback(tmp_path, seed):
    rng = np.random.default_rng(seed)
    columns = {k: v[::40] for k, v in channels().items()}
    for file, write in ((tmp_path / "a.dat", write_dat), (tmp_path / "a.mat", write_mat)):
        write(file, columns)
        raw = bytearray(file.read_bytes())
        for at in rng.integers(0, len(raw), 12):
            raw[at] = rng.integers(0, 256)
        file.write_bytes(bytes(raw[: rng.integers(len(raw) // 2, len(raw))]))
        with contextlib.suppress(SlipangleError):
            assert read_ttc(file).n_samples > 0


def test_a_sample_beyond_all_bounds_is_named():
    columns = channels()
    columns["MX"][5] = 1e200
    with pytest.raises(UnitError, match=r"MX of 'run' reaches 1e\+200 in SI units; expected at most 1e\+08"):
        from_channels(columns, UNITS)
