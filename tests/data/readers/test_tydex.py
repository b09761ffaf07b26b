"""TYDEX measurements: the same data as the channels that they were written from; bad files get one sentence."""

import contextlib

import numpy as np
import pytest

from slipangle.data.readers.ttc import from_channels
from slipangle.data.readers.tydex import read_rig
from slipangle.errors import FormatError, MissingColumnError, MissingFileError, SlipangleError
from tests.rig import UNITS, channels, write_tydex

SIGNALS = ("slip_ratio", "slip_angle", "load", "camber", "pressure", "speed", "F_x", "F_y", "M_x", "M_z", "time")


def thin(kind="cornering"):
    return {k: v[:: 9 if kind == "cornering" else 27] for k, v in channels(kind, z_down=False).items()}


@pytest.mark.parametrize("kind", ["cornering", "drive/brake"])
def test_the_same_data(kind, tmp_path):
    columns = thin(kind)
    reference = from_channels(columns, UNITS)
    write_tydex(tmp_path / "a.tdx", columns)
    found = read_rig(tmp_path / "a.tdx")
    for key in SIGNALS:
        assert getattr(found, key) == pytest.approx(getattr(reference, key), rel=1e-5, abs=1e-4), key
    assert "ISO-W" in found.notes[0]


def test_factors_offsets_and_constants(tmp_path):
    """Measured = (stored + offset) * factor + offset; the pressure is a constant."""
    columns = thin()
    reference = from_channels(
        {k: v for k, v in columns.items() if k != "P"} | {"P": np.full(len(columns["P"]), 80.0)}, UNITS
    )
    write_tydex(tmp_path / "a.tdx", columns, factors={"FZW": (2.0, 50.0, 10.0)}, pressure=0.8)
    found = read_rig(tmp_path / "a.tdx")
    assert found.load == pytest.approx(reference.load, rel=1e-5)
    assert found.pressure == pytest.approx(80e3)


def in_axes(columns, system, radius=0.25):
    """Forces and moments at the wheel's centre, and its height: by vectors and a rotation matrix for each sample."""
    out = dict(columns)
    height = np.empty(len(columns["FX"]))
    names = [f"{kind}{a}" for kind in "FM" for a in "XYZ"]
    new = {name: np.empty(len(height)) for name in names}
    for k in range(len(height)):
        lean = np.radians(columns["IA"][k])
        turn = np.array([[1, 0, 0], [0, np.cos(lean), -np.sin(lean)], [0, np.sin(lean), np.cos(lean)]])  # C to W
        to_centre = turn @ [0, 0, radius]
        height[k] = to_centre[2]
        force = np.array([columns[n][k] for n in ("FX", "FY", "FZ")])
        moment = np.array([columns["MX"][k], 7.0, columns["MZ"][k]]) - np.cross(to_centre, force)
        back = turn.T if system == "C" else np.eye(3)
        for name, value in zip(names, (*(back @ force), *(back @ moment)), strict=True):
            new[name][k] = value
    return out | new, height


@pytest.mark.parametrize("axes", "HC")
@pytest.mark.parametrize("kind", ["cornering", "drive/brake"])
def test_forces_at_the_hub_are_those_on_the_road(kind, axes, tmp_path):
    """What was measured at the wheel's centre, leaning with the wheel or not, is the same tire; MY is 7 N m."""
    columns = thin(kind)
    columns["IA"] = columns["IA"] + 3.0
    reference = from_channels(columns, UNITS)
    moved, height = in_axes(columns, axes)
    write_tydex(tmp_path / "w.tdx", moved)
    text = (tmp_path / "w.tdx").read_text().replace("FXW       ", "FX        ")
    for name in ("FYW", "FZW", "MXW", "MZW"):
        text = text.replace(f"{name}       ", f"{name[:2]}{axes}       ")
    more = [f"{name:<10}{'words':<30}{unit:<10}" for name, unit in ((f"MY{axes}", "Nm"), ("DSTGRWHC", "mm"))]
    text = text.replace("**MEASURDATA", "\n".join([*more, "**MEASURDATA"]))
    head, rows = text.split("**MEASURDATA\n")
    lines = rows.split("\n**END")[0].splitlines()
    lines = [f"{row} {y:.8g} {1e3 * h:.8g}" for row, y, h in zip(lines, moved["MY"], height, strict=True)]
    (tmp_path / "a.tdx").write_text("\n".join([f"{head}**MEASURDATA", *lines, "**END"]) + "\n")
    found = read_rig(tmp_path / "a.tdx")
    for key in SIGNALS:
        assert getattr(found, key) == pytest.approx(getattr(reference, key), rel=1e-4, abs=1e-2), key
    assert found.notes[-1] == f"forces in {axes} axes of TYDEX are brought to W axes"
    (tmp_path / "b.tdx").write_text((tmp_path / "a.tdx").read_text().replace("DSTGRWHC", "UNKNOWN "))
    without = read_rig(tmp_path / "b.tdx")
    assert without.M_x is None
    assert without.M_z is None
    assert without.F_y == pytest.approx(reference.F_y, rel=1e-4, abs=1e-2)
    assert f"moments in {axes} axes are left out: expected DSTGRWHC" in without.notes[-1]


def test_bad_files(tmp_path):
    with pytest.raises(MissingFileError, match=r"no.tdx"):
        read_rig(tmp_path / "no.tdx")
    write_tydex(tmp_path / "a.tdx", thin())
    text = (tmp_path / "a.tdx").read_text()
    cases = {
        "b": (text.replace("**MEASURCHANNELS", "**OTHER"), FormatError, r"no \*\*MEASURCHANNELS; expected a TYDEX"),
        "c": (text[: text.index("**MEASURDATA")], FormatError, r"no rows below \*\*MEASURDATA"),
        "d": (text.replace("\n**END", " 1.0\n**END"), FormatError, "line .* has 11 numbers; expected 10"),
        "e": (text.replace("\n**END", "x\n**END"), FormatError, "holds '.*x'; expected 10 numbers"),
        "g": (text.replace("**END", "**MEASURCHANNELS\nMYW\n**END"), FormatError, "names channels below its data"),
        "f": (text.replace("FYW ", "FYX "), MissingColumnError, "has no channel FY"),
    }
    for name, (content, error, said) in cases.items():
        (tmp_path / f"{name}.tdx").write_text(content)
        with pytest.raises(error, match=said) as caught:
            read_rig(tmp_path / f"{name}.tdx")
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("seed", range(10))
def test_damaged_files_never_end_in_a_traceback(tmp_path, seed):
    rng = np.random.default_rng(seed)
    write_tydex(tmp_path / "a.tdx", {k: v[::5] for k, v in thin().items()})
    raw = bytearray((tmp_path / "a.tdx").read_bytes())
    for at in rng.integers(0, len(raw), 12):
        raw[at] = rng.integers(0, 256)
    (tmp_path / "a.tdx").write_bytes(bytes(raw[: rng.integers(len(raw) // 2, len(raw))]))
    with contextlib.suppress(SlipangleError):
        assert read_rig(tmp_path / "a.tdx").n_samples > 0
