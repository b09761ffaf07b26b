"""Files that a library would follow for ever, or complain about more than once, end in one sentence."""

import struct

import pytest

from slipangle.data.readers import open_log, read
from slipangle.errors import FormatError, SlipangleError
from tests.data.readers import test_formats


@pytest.mark.parametrize("version", ["mdf3", "mdf4"])
def test_channel_groups_that_go_round_are_refused(version, tmp_path):
    path = tmp_path / f"{version}.mf4"
    test_formats.mdf(path)
    raw = bytearray(path.read_bytes())
    kind, link = (b"##DG", 24) if version == "mdf4" else (b"DG", 4)
    at = raw.index(kind, 64)
    raw[at + link : at + link + 4] = struct.pack("<I", at)
    path.write_bytes(raw)
    with pytest.raises(FormatError, match="two ways lead to its byte"):
        open_log(path)


@pytest.mark.parametrize("name", ["Parquet", "Feather", "MATLAB 5", "MATLAB 7.3", "mdf3", "mdf4", "MoTeC ld"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_half_a_file_ends_in_one_sentence(name, share, tmp_path):
    path = tmp_path / "run.bin"
    test_formats.FORMATS[name][0](path)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(share * len(raw))])
    with pytest.raises(SlipangleError) as caught:
        read(path, test_formats.FORMATS[name][1], nan="merge")
    assert "\n" not in str(caught.value)
