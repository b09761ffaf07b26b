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
        "f": (text.replace("FYW ", "FYH ").replace("FZW ", "FZH "), MissingColumnError, "in the H axes of TYDEX only"),
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
