"""Numbers and clocks that two people would read differently: refused, or read with a sentence."""

import numpy as np
import pytest

from slipangle.data.numerals import decoded, to_number
from slipangle.data.readers import Column, read_csv
from slipangle.errors import FormatError, SampleTimeError, SlipangleError, TimeError, shown


@pytest.fixture
def log(tmp_path):
    def write(text):
        path = tmp_path / "run.csv"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize("text", ["1_0", "１２", "1__0", "0x10", "1d5", "", "1,5", "1 2"])
def test_only_plain_numbers_are_numbers(text):
    with pytest.raises(ValueError):
        to_number(text)


@pytest.mark.parametrize("cell", ["1_0", "１２", "0x10", "1,5"])
def test_cells_that_are_no_plain_number(log, cell):
    quoted = f'"{cell}"'
    with pytest.raises(FormatError, match=r"line 3, column 'u' holds .*; expected a number"):
        read_csv(log(f"t,u\n0,1\n0.1,{quoted}\n0.2,3\n"))


def test_a_point_and_a_comma_for_decimals(log):
    with pytest.raises(FormatError, match=r"'1,5' in line 3 and '2.5' in line 4; expected one decimal mark"):
        read_csv(log("t;u\n0;1\n1;1,5\n2;2.5\n"))
    with pytest.raises(FormatError, match=r"'1,234' in line 2 and '1\.5' in line 2; expected one decimal mark"):
        read_csv(log("t;u;y\n0;1,234;1.5\n1;2;3\n2;3;4\n"))


def test_a_comma_that_may_part_thousands(log):
    with pytest.raises(FormatError, match=r"'1,234' in line 2, which can be 1\.234 or 1234; expected"):
        read_csv(log("t;u\n0;1,234\n1;2,345\n2;3,456\n"))


def test_a_comma_beyond_the_first_lines(log):
    rows = "".join(f"{k};{k}\n" for k in range(100))
    data = read_csv(log(f"t;u\n{rows}100;0,5\n"))
    assert data["u"][-1] == 0.5


@pytest.mark.parametrize("cell", ["0,125", "1234,567", "1,5", "-0,001", "1,23e-4"])
def test_commas_that_are_decimal(log, cell):
    data = read_csv(log(f"t;u\n0;1\n1;{cell}\n2;1,234\n"))
    assert data["u"].tolist() == [1.0, float(cell.replace(",", ".")), 1.234]
    assert "decimal commas are read as points" in data.notes


@pytest.mark.parametrize(("unit", "scale"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("start", [0, 1_700_000_000])
def test_stamps_that_are_not_seconds(log, unit, scale, start):
    """50 Hz in a finer unit that the file does not name."""
    stamps = [int((start + 0.02 * k) * scale + 0.5) for k in range(40)]
    rows = "".join(f"{t},{np.sin(0.1 * k):.6f},{np.cos(0.1 * k):.6f}\n" for k, t in enumerate(stamps))
    path = log(f"time,delta,r\n{rows}")
    with pytest.raises(TimeError, match=rf"names no unit.*expected seconds, .* as 'time \[{unit}\]'"):
        read_csv(path)
    with pytest.raises(TimeError, match="expected seconds"):
        read_csv(path, {"a": "r", "delta": "delta"})
    data = read_csv(path, time=Column("time", unit))
    assert data.dt == pytest.approx(0.02, rel=1e-6)


def test_slow_stamps_of_other_processes_are_said(log):
    rows = "".join(f"{20 * k},{k % 3},{k % 5}\n" for k in range(40))
    data = read_csv(log(f"t,heating,temperature\n{rows}"))
    assert data.dt == 20.0
    assert any("names no unit: its steps of 20 are taken as seconds" in note for note in data.notes)
    quick = "".join(f"{k},{0.1 * (k % 3)},{0.2 * (k % 5)}\n" for k in range(40))
    drive, other = (read_csv(log(f"t,{names}\n{quick}")) for names in ("delta,r", "heating,temperature"))
    assert any("its steps of 1 are taken as seconds; if they are not, name the unit as" in n for n in drive.notes)
    assert not any("taken as seconds" in note for note in other.notes)
    named = read_csv(log(f"t [s],heating,temperature\n{rows}"))
    assert not any("taken as seconds" in note for note in named.notes)


def test_resampling_has_an_upper_bound(log):
    rows = "".join(f"{20_000_000 * k},{k % 3}\n" for k in range(800))
    data = read_csv(log(f"t [s],u\n{rows}"))
    with pytest.raises(SampleTimeError, match=r"makes 8e\+11 samples; expected at most 1e\+08: .* the unit of"):
        data.resample(0.02)


def test_a_message_repeats_at_most_a_line(log):
    long = "x" * 600_000
    with pytest.raises(FormatError) as caught:
        read_csv(log(f"t,u\n0,1\n1,{long}\n2,3\n"))
    assert len(str(caught.value)) < 400
    with pytest.raises(SlipangleError) as caught:
        read_csv(log(f"t,{'y ' * 300_000}\n0,1\n1,2\n2,3\n"), ["u"])
    assert len(str(caught.value)) < 2001
    assert len(str(SlipangleError(long))) < 400
    assert len(shown(long)) == len(shown(list(range(1000)))) == 60


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings(encoding):
    assert decoded("Größe".encode(encoding), "file", "text") == "Größe"
    with pytest.raises(FormatError, match="'file' is not a text file; expected text"):
        decoded(b"a\0b", "file", "text")
