"""Tire property files: every line kept, units at the door, errors with line numbers."""

import math

import numpy as np
import pytest

from slipangle.data.readers.tir import parse_tir, read_tir
from slipangle.errors import FormatError, MissingFileError, ParameterError, UnitError

TEXT = """\
! first comment
$------------------------------units
[UNITS]
LENGTH = 'meter'
FORCE  = 'newton'
ANGLE  = 'radians'
MASS   = 'kg'
TIME   = 'second'
[MODEL]
FITTYP = 61                      $Magic Formula version
TYRESIDE = 'Left'
MFSAFE3 =
PROPERTY_FILE_FORMAT = USER
[SHAPE]
{radial width}
 1.0    0.0
 0.9    1.0
[DIMENSION]
UNLOADED_RADIUS = 0.31           $free radius ! with a remark
[INERTIA]
MASS = 17.5
[VERTICAL]
FNOMIN = 4.0D+03
MY_OWN_KEY = 'it''s kept'
"""


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("final", [True, False])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
def test_an_unchanged_file_is_written_back_byte_for_byte(tmp_path, newline, final, encoding):
    text = TEXT.replace("first", "erste für" if encoding == "latin-1" else "first").replace("\n", newline)
    raw = (text if final else text.removesuffix(newline)).encode(encoding)
    (tmp_path / "a.tir").write_bytes(raw)
    read_tir(tmp_path / "a.tir").write(tmp_path / "b.tir")
    assert (tmp_path / "b.tir").read_bytes() == raw


def test_values_words_blanks_and_tables():
    tir = parse_tir(TEXT)
    assert tir.fit_type == 61
    assert tir.number("fnomin") == 4000.0  # Fortran's exponent
    assert tir.number("MASS") == 17.5  # the unit of the same name does not hide it
    assert tir.get("MFSAFE3") is None
    assert tir.number("MFSAFE3") is None
    assert tir.word("TYRESIDE") == "LEFT"
    assert tir.word("PROPERTY_FILE_FORMAT") == "USER"
    assert tir.word("NOT_THERE") == ""
    assert tir.entries["FITTYP"].comment == "Magic Formula version"
    assert tir.entries["UNLOADED_RADIUS"].comment == "free radius ! with a remark"
    assert tir.sections == ("UNITS", "MODEL", "SHAPE", "DIMENSION", "INERTIA", "VERTICAL")
    np.testing.assert_array_equal(tir.tables["SHAPE"], [[1.0, 0.0], [0.9, 1.0]])


def test_a_changed_value_leaves_every_other_line_alone():
    tir = parse_tir(TEXT)
    new = tir.with_values({"UNLOADED_RADIUS": 0.1 + 0.2}, comments={"FNOMIN": "seen twice"})
    before, after = tir.text.splitlines(), new.text.splitlines()
    changed = [i for i, (a, b) in enumerate(zip(before, after, strict=True)) if a != b]
    assert [after[i].split()[0] for i in changed] == ["UNLOADED_RADIUS", "FNOMIN"]
    again = parse_tir(new.text)
    assert again.number("UNLOADED_RADIUS") == 0.1 + 0.2  # all digits
    assert again.entries["UNLOADED_RADIUS"].comment == "free radius ! with a remark"
    assert again.entries["FNOMIN"].comment == "seen twice"
    assert again.number("FNOMIN") == 4000.0


def test_new_keys_go_to_their_section():
    tir = parse_tir(TEXT)
    new = parse_tir(tir.with_values({"WIDTH": 0.2, "PCX1": 1.5}, section={"WIDTH": "DIMENSION", "PCX1": "NEW"}).text)
    assert new.entries["WIDTH"].section == "DIMENSION"
    assert new.entries["PCX1"].section == "NEW"
    assert new.number("WIDTH") == 0.2
    with pytest.raises(ParameterError, match="has no UNLOADED_RADUIS; nearest are 'UNLOADED_RADIUS'"):
        tir.with_values({"UNLOADED_RADUIS": 1.0})


@pytest.mark.parametrize(
    ("units", "values", "expected"),
    [
        ("LENGTH = 'mm'\nFORCE = 'newton'", "UNLOADED_RADIUS = 344", ("UNLOADED_RADIUS", 0.344)),
        ("ANGLE = 'degrees'", "ALPMAX = 15", ("ALPMAX", math.radians(15))),
        ("FORCE = 'kN'", "FNOMIN = 4.5", ("FNOMIN", 4500.0)),
        ("LENGTH = 'inch'\nFORCE = 'pound_force'", "VERTICAL_STIFFNESS = 1000", ("VERTICAL_STIFFNESS", 175126.835)),
        ("LENGTH = 'km'\nTIME = 'hour'", "LONGVL = 60", ("LONGVL", 60 / 3.6)),
        ("PRESSURE = 'bar'", "INFLPRES = 2.4", ("INFLPRES", 240e3)),
        ("LENGTH = 'mm'\nFORCE = 'newton'", "INFLPRES = 0.24", ("INFLPRES", 240e3)),
        ("ANGLE = 'degrees'", "PHY1 = 0.004", ("PHY1", 0.004)),  # coefficients are per radian whatever the block says
    ],
)
def test_the_units_block_is_honoured(units, values, expected):
    key, value = expected
    assert parse_tir(f"[UNITS]\n{units}\n[MODEL]\n{values}\n").number(key) == pytest.approx(value, rel=1e-8)


def test_values_are_written_in_the_units_of_the_file():
    tir = parse_tir("[UNITS]\nLENGTH = 'mm'\n[DIMENSION]\nUNLOADED_RADIUS = 344\n")
    new = tir.with_values({"UNLOADED_RADIUS": 0.35})
    assert new.get("UNLOADED_RADIUS") == 350
    assert "UNLOADED_RADIUS = 350" in new.text
    assert new.number("UNLOADED_RADIUS") == pytest.approx(0.35, rel=1e-14)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("PCX1 = 1.2.3", "line 3 .* gives PCX1 the value '1.2.3'; expected a number"),
        ("PCX1 = 1,5", "a point, not a comma"),
        ("PCX1 = nan", "line 3 .* 'nan'"),
        ("PCX1 = 'open", "line 3 .* expected a number or a quoted text"),
        ("PCX1 1.5", r"line 3 .* reads 'PCX1 1.5'; expected a \[SECTION\]"),
        ("= 1.5", "line 3"),
        ("[LATERAL", "line 3"),
        ("1.0 two", "line 3"),
    ],
)
def test_an_unreadable_line_is_named(line, message):
    with pytest.raises(FormatError, match=message):
        parse_tir(f"! a file\n[MODEL]\n{line}\n")


def test_a_word_where_a_number_is_needed_is_named():
    with pytest.raises(FormatError, match="line 2 of 'tir' gives FNOMIN the value 'heavy'"):
        parse_tir("[VERTICAL]\nFNOMIN = 'heavy'\n").number("FNOMIN")


def test_contradicting_values_are_refused_and_equal_ones_are_not():
    assert parse_tir("[MODEL]\nPCX1 = 1.5\n[X]\nPCX1 = 1.50\n").number("PCX1") == 1.5
    with pytest.raises(FormatError, match=r"gives PCX1 twice, 1.5 in line 2 and 1.6 in line 4"):
        parse_tir("[MODEL]\nPCX1 = 1.5\n[X]\nPCX1 = 1.6\n")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[UNITS]\nLENGTH = 'metr'\n", "line 2 .* LENGTH in 'metr'; nearest are .*'METER'"),
        ("[UNITS]\nLENGTH = 'inch'\nFORCE = 'newton'\n", "mixes LENGTH in 'inch' and FORCE in 'newton'"),
        ("[UNITS]\nLENGTH = 'mm'\nLENGTH = 'meter'\n", "gives LENGTH twice"),
        ("[UNITS]\nLENGTH = 'meter'\n[D]\nUNLOADED_RADIUS = 344\n", "UNLOADED_RADIUS .* 344 m .* mixes units"),
        ("[UNITS]\nFORCE = 'newton'\n[V]\nFNOMIN = 4.5\n", "FNOMIN .* 4.5 N .* mixes units"),
        ("[UNITS]\nFORCE = 'newton'\n[V]\nNOMPRES = 2.4\n", "NOMPRES .* 2.4 Pa .* mixes units"),
    ],
)
def test_wrong_or_mixed_units_are_refused(text, message):
    with pytest.raises(UnitError, match=message):
        parse_tir(text)


def test_files_that_are_no_tire_files(tmp_path):
    with pytest.raises(MissingFileError, match=r"none\.tir' cannot be read"):
        read_tir(tmp_path / "none.tir")
    with pytest.raises(MissingFileError):
        read_tir(tmp_path)
    (tmp_path / "empty.tir").write_text("")
    with pytest.raises(FormatError, match="holds no 'KEY = value' line"):
        read_tir(tmp_path / "empty.tir")
    (tmp_path / "binary.tir").write_bytes(b"PCX1 = 1\0\0")
    with pytest.raises(FormatError, match="binary file"):
        read_tir(tmp_path / "binary.tir")


def test_every_public_file_round_trips(real_data, tmp_path):
    for file in real_data.glob("tir/*.tir"):
        tir = read_tir(file)
        tir.write(tmp_path / file.name)
        assert (tmp_path / file.name).read_bytes() == file.read_bytes()
        assert tir.number("FNOMIN")
        assert any(line.key.startswith("PCX") for line in tir.lines)


def test_ragged_table_names_its_line():
    with pytest.raises(FormatError, match=r"line 17 of 'tir' has 1 numbers; expected 2 as in the rows of \[SHAPE\]"):
        parse_tir(TEXT.replace(" 0.9    1.0", " 0.9")).tables  # noqa: B018


def test_a_number_of_python_only_is_refused():
    with pytest.raises(FormatError, match="gives FITTYP the value '6_1'"):
        parse_tir(TEXT.replace("= 61", "= 6_1"))
