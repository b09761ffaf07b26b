"""Tires from files and back: versions, defaults, identical forces, bad input."""

import math
from dataclasses import MISSING, fields, replace

import casadi as ca
import numpy as np
import pytest

from slipangle.data.readers.tir import parse_tir, read_tir
from slipangle.errors import FormatError, MissingFileError, ModelWarning, ParameterError
from slipangle.models.tires.magic_formula.coefficients import MF52Coefficients, MF61Coefficients
from slipangle.models.tires.magic_formula.terms import Conventions
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.magic_formula.validity import ValidRange
from tests.models.tires.example_tires import MF52, MF61, TIRES

BARE = """\
[MODEL]
{head}
[DIMENSION]
UNLOADED_RADIUS = 0.31
[VERTICAL]
FNOMIN = 4000
[LONGITUDINAL_COEFFICIENTS]
PCX1 = 1.6
PDX1 = 1.2
PKX1 = 22
[LATERAL_COEFFICIENTS]
PCY1 = 1.3
PDY1 = 1.1
PKY1 = -20
PKY2 = 2
"""
REQUIRED = ("UNLOADED_RADIUS", "FNOMIN", "PCX1", "PDX1", "PKX1", "PCY1", "PDY1", "PKY1", "PKY2")


def bare(head="FITTYP = 61", extra=""):
    return parse_tir(BARE.format(head=head) + extra)


def grid(limits, n=7):
    load = (max(limits.load[0], 0.0), min(limits.load[1], 1e5))
    slip = np.clip(limits.slip_ratio, -1.5, 1.5)
    axes = (slip, limits.slip_angle, load, limits.camber)
    return [m.ravel() for m in np.meshgrid(*(np.linspace(*a, n) for a in axes))]


# ---- public files -------------------------------------------------------------------------------------------------


def test_every_public_file_is_finite_over_its_range_and_round_trips(real_data, tmp_path):
    for file in real_data.glob("tir/*.tir"):
        tire = MagicFormulaTire.from_tir(file)
        s, a, f, g = grid(tire.limits)
        before = tire.evaluate(s, a, f, camber=g, axes="ISO-W")
        for name, value in before._asdict().items():
            assert np.isfinite(value).all(), (file.name, name)
        assert np.max(np.abs(before.F_y)) < 2 * np.max(f)

        again = MagicFormulaTire.from_tir(tire.write_tir(tmp_path / file.name))
        assert (tmp_path / file.name).read_bytes() == file.read_bytes()
        assert again == tire
        rewritten = read_tir(file).with_values({n: v for n, v in read_tir(file).numbers.items() if n != "FITTYP"})
        for other in (again, MagicFormulaTire.from_tir(rewritten)):
            after = other.evaluate(s, a, f, camber=g, axes="ISO-W")
            for x, y in zip(before, after, strict=True):
                np.testing.assert_array_equal(x, y)


def test_a_new_file_from_public_coefficients_gives_identical_forces(real_data, tmp_path):
    for file in real_data.glob("tir/*.tir"):
        tire = MagicFormulaTire.from_tir(file)
        fresh = MagicFormulaTire(
            coefficients=tire.coefficients, limits=tire.limits, combined=tire.combined, axes=tire.axes, side=tire.side
        )
        again = MagicFormulaTire.from_tir(fresh.write_tir(tmp_path / file.name))
        assert again.coefficients == tire.coefficients
        assert again == tire
        s, a, f, g = grid(tire.limits, 4)
        for x, y in zip(
            tire.evaluate(s, a, f, camber=g, axes="ISO-W"),
            again.evaluate(s, a, f, camber=g, axes="ISO-W"),
            strict=True,
        ):
            np.testing.assert_array_equal(x, y)


def test_dialects_of_the_public_files(real_data):
    def read(start):
        (file,) = real_data.glob(f"tir/{start}*.tir")
        return MagicFormulaTire.from_tir(file)

    assert isinstance(read("MagicFormula61").coefficients, MF61Coefficients)
    for start in ("MagicFormula52", "VW", "audi", "feda", "hmmwv__tire__HMMWV_Pac"):
        assert isinstance(read(start).coefficients, MF52Coefficients)
    assert read("VW").side == "LEFT"
    assert read("MagicFormula61").side == "RIGHT"
    assert read("feda").side == ""  # UNKNOWN
    assert read("feda").combined == "ellipse"  # asked for
    assert read("audi").combined == "ellipse"  # no coefficients of combined slip
    assert read("VW").combined == "weighting"
    hmmwv = read("hmmwv__tire__HMMWV_Pac").coefficients
    assert hmmwv.NOMPRES == 800e3  # spelled IP_NOM
    assert hmmwv.LFZO == 0.580904846
    assert read("feda").limits.slip_ratio == (-0.8, 0.0)


# ---- versions and defaults ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "kind"),
    [
        *((f"FITTYP = {n}", MF52Coefficients) for n in (5, 6, 21, 52)),
        *((f"FITTYP = {n}", MF61Coefficients) for n in (60, 61, 62)),
        ("FITTYP =", MF52Coefficients),
        ("PROPERTY_FILE_FORMAT = 'PAC2002'", MF52Coefficients),
        ("PROPERTY_FILE_FORMAT = 'PAC2002'\nLKYC = 1", MF52Coefficients),
        ("LKYC = 1", MF61Coefficients),
        ("PKY4 = 2", MF61Coefficients),
    ],
)
def test_fittyp_chooses_the_version(head, kind):
    assert isinstance(MagicFormulaTire.from_tir(bare(head)).coefficients, kind)


@pytest.mark.parametrize("fit_type", [0, 51, 70])
def test_other_versions_are_refused(fit_type):
    with pytest.raises(FormatError, match=f"FITTYP {fit_type}; expected one of 5, 6, 21, 52, 60, 61, 62"):
        MagicFormulaTire.from_tir(bare(f"FITTYP = {fit_type}"))


@pytest.mark.parametrize("name", REQUIRED)
@pytest.mark.parametrize("blank", [True, False])
def test_a_missing_coefficient_is_named(name, blank):
    lines = BARE.format(head="FITTYP = 61").splitlines()
    lines = [f"{name} =" if blank and ln.startswith(name) else ln for ln in lines if blank or not ln.startswith(name)]
    with pytest.raises(FormatError, match=f"lacks {name}, which the Magic Formula cannot do without"):
        MagicFormulaTire.from_tir(parse_tir("\n".join(lines)))


def test_required_coefficients_are_those_without_default():
    assert {f.name for f in fields(MF61Coefficients) if f.default is MISSING} == set(REQUIRED)
    assert {f.name for f in fields(MF52Coefficients) if f.default is MISSING} == set(REQUIRED)


def test_defaults_leave_an_effect_out():
    c = MagicFormulaTire.from_tir(bare()).coefficients
    assert isinstance(c, MF61Coefficients)
    assert (c.LMUX, c.LFZO, c.PKY4, c.PEX1, c.RBX1, c.QSY7, c.LMUV) == (1, 1, 2, 0, 0, 0, 0)
    old, new = (MagicFormulaTire.from_tir(bare(f"FITTYP = {n}")) for n in (6, 61))
    s, a, f = (x.ravel() for x in np.meshgrid([-0.1, 0.0, 0.2], [-0.2, 0.0, 0.1], [1000.0, 4000.0]))
    for x, y in zip(old.forces(s, a, f), new.forces(s, a, f), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-9)  # without extras the versions agree


def test_rolling_resistance_without_exponent_is_proportional_to_load_in_both_forms():
    extra = "[ROLLING_COEFFICIENTS]\nQSY1 = 0.01\n"
    for form in ("book", "paper"):
        tire = MagicFormulaTire.from_tir(bare(extra=extra), conventions=Conventions(rolling_resistance=form))
        np.testing.assert_allclose(
            tire.forces(0.0, 0.0, np.array([0.0, 2000.0, 4000.0])).M_y, -0.31 * 0.01 * np.array([0.0, 2000.0, 4000.0])
        )


def test_values_and_conventions_reach_the_tire():
    tire = MagicFormulaTire.from_tir(
        bare(extra="[LATERAL_COEFFICIENTS]\nRBY1 = 10\nRCY1 = 1\n"),
        conventions=Conventions(lateral_slip="angle"),
        outside="extrapolate",
        combined="none",
        axes="SAE",
        side="RIGHT",
    )
    assert (tire.outside, tire.combined, tire.axes, tire.side) == ("extrapolate", "none", "SAE", "RIGHT")
    assert tire.conventions.lateral_slip == "angle"
    assert MagicFormulaTire.from_tir(bare(extra="[L]\nRBY1 = 10\n")).combined == "weighting"
    assert MagicFormulaTire.from_tir(bare()).combined == "ellipse"
    positive = parse_tir(BARE.format(head="FITTYP = 61").replace("PKY1 = -20", "PKY1 = 20"))
    assert MagicFormulaTire.from_tir(positive).axes == "adapted SAE"
    assert MagicFormulaTire.from_tir(positive).forces(0.0, 0.1, 4000.0).F_y > 0


def test_units_other_than_si():
    text = "[UNITS]\nLENGTH = 'mm'\nFORCE = 'kN'\nANGLE = 'degrees'\n" + BARE.format(head="FITTYP = 61")
    text = text.replace("= 0.31", "= 310").replace("= 4000", "= 4.0") + "[R]\nALPMIN = -15\nALPMAX = 15\nFZMAX = 9\n"
    tire = MagicFormulaTire.from_tir(parse_tir(text))
    assert tire.coefficients.FNOMIN == 4000.0
    assert tire.limits.slip_angle[1] == pytest.approx(math.radians(15))
    assert tire.limits.load == (0.0, 9000.0)
    plain = MagicFormulaTire.from_tir(bare())
    assert tire.forces(0.0, 0.1, 3000.0).F_y == pytest.approx(plain.forces(0.0, 0.1, 3000.0).F_y, rel=1e-12)


# ---- bad input ----------------------------------------------------------------------------------------------------


def test_an_unknown_coefficient_with_a_value_is_flagged_and_kept(tmp_path):
    tir = bare(extra="[LATERAL_COEFFICIENTS]\nPCY2 = 0.5\nPKY9 = 0.0\nLXYZ = 1\n")
    with pytest.warns(ModelWarning, match="has PCY2, which version 6 of the Magic Formula does not use"):
        tire = MagicFormulaTire.from_tir(tir)
    assert tire.to_tir().number("PCY2") == 0.5


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ("[S]\nLMUX = 'high'\n", "line 17 .* LMUX the value 'high'; expected a number"),
        ("[S]\nLMUX = -1\n", r"LMUX = -1 .*; expected 0 to 100.*--force"),
        ("[R]\nFZMIN = 9000\nFZMAX = 200\n", "FZMIN = 9000 and FZMAX = 200; expected FZMIN below FZMAX"),
    ],
)
def test_bad_values_are_named(extra, message):
    with pytest.raises(FormatError, match=message):
        MagicFormulaTire.from_tir(bare(extra=extra))


def test_a_file_that_does_not_exist(tmp_path):
    with pytest.raises(MissingFileError, match="cannot be read"):
        MagicFormulaTire.from_tir(tmp_path / "none.tir")


# ---- write --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tire", TIRES.values(), ids=TIRES.keys())
def test_a_tire_without_file_writes_every_coefficient(tire, tmp_path):
    tire = replace(tire, limits=ValidRange(load=(200.0, 9000.0), slip_angle=(-0.3, 0.3)))
    again = MagicFormulaTire.from_tir(tire.write_tir(tmp_path / "new.tir", comments={"PDY1": "0.97 to 1.11"}))
    assert again == tire
    assert again.source is not None
    assert again.source.entries["PDY1"].comment == "0.97 to 1.11"
    assert again.source.entries["PDX1"].comment == "peak friction at nominal load"
    assert set(again.source.sections) >= {"UNITS", "MODEL", "LATERAL_COEFFICIENTS", "SCALING_COEFFICIENTS"}
    assert not [key for key, line in again.source.entries.items() if line.section == "MODEL"
                and key not in ("FITTYP", "TYRESIDE", "LONGVL", "VXLOW")]  # fmt: skip


def test_only_what_changed_is_rewritten():
    tir = bare(extra="! a remark\n[ALIGNING_COEFFICIENTS]\nQDZ1 = 0.1  $trail\n")
    tire = MagicFormulaTire.from_tir(tir).with_coefficients(QDZ1=0.12, PEY1=-0.5, PDX1=1.2)
    new = tire.to_tir(comments={"PKY1": "plus or minus 0.3"})
    before, after = tir.text.splitlines(), new.text.splitlines()
    assert [ln for ln in after if ln not in before] == [
        "PKY1 = -20 $plus or minus 0.3",
        f"{'PEY1':<24} = -0.5",
        "QDZ1 = 0.12 $trail",
    ]
    assert new.entries["PEY1"].section == "LATERAL_COEFFICIENTS"
    assert MagicFormulaTire.from_tir(new) == tire


def test_spellings_of_the_file_are_kept():
    tir = bare("FITTYP = 6", "[SCALING_COEFFICIENTS]\nLFZ0 = 0.9\n")
    tire = MagicFormulaTire.from_tir(tir)
    assert tire.coefficients.LFZO == 0.9
    new = tire.with_coefficients(LFZO=0.8).to_tir()
    assert new.number("LFZ0") == 0.8
    assert new.get("LFZO") is None


@pytest.mark.parametrize("combined", ["weighting", "ellipse", "none"])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("axes", ["ISO-W", "SAE", "adapted SAE"])
@pytest.mark.parametrize("start", ["nothing", "a file"])
def test_what_is_no_coefficient_round_trips_too(combined, mirrored, axes, start):
    tire = MF61 if start == "nothing" else MagicFormulaTire.from_tir(MF61.to_tir())
    tire = replace(
        tire, combined=combined, mirrored=mirrored, axes=axes, side="RIGHT", limits=ValidRange(load=(1.0, 9e3))
    )
    again = MagicFormulaTire.from_tir(parse_tir(tire.to_tir().text))
    assert again == tire
    back = replace(again, combined="weighting", mirrored=False, axes="ISO-W")
    assert MagicFormulaTire.from_tir(parse_tir(back.to_tir().text)) == back


def test_a_file_cannot_ask_for_weights_that_it_does_not_have():
    with pytest.raises(ParameterError, match="cannot say combined='weighting' without coefficients"):
        MagicFormulaTire.from_tir(bare(), combined="weighting").to_tir()


@pytest.mark.parametrize(
    ("head", "combined", "mirrored"),
    [
        ("USE_MODE = 14", "weighting", False),
        ("USE_MODE = -14", "weighting", True),
        ("USE_MODE = 3", "none", False),
        ("FE_METHOD = 'YES'", "ellipse", False),
        ("FE_METHOD = 'NO'", "weighting", False),
    ],
)
def test_switches_of_the_file(head, combined, mirrored):
    tire = MagicFormulaTire.from_tir(bare(head, "[L]\nRBY1 = 10\n"))
    assert (tire.combined, tire.mirrored) == (combined, mirrored)


def test_unknown_axes_are_refused():
    with pytest.raises(FormatError, match="AXIS_SYSTEM 'ISO'; nearest are 'ISO-W'"):
        MagicFormulaTire.from_tir(bare("AXIS_SYSTEM = 'ISO'"))


def test_symbols_cannot_be_written():
    with pytest.raises(ParameterError, match="PDY1 is a symbol; expected a number"):
        MF61.with_coefficients(PDY1=ca.SX.sym("p")).to_tir()


def test_versions_write_their_own_number():
    assert MF61.to_tir().fit_type == 61
    assert MF52.to_tir().fit_type == 6


# ---- files as they are ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("PKY1", "PKY2", "PKY4", "axes"),
    [
        (-20.0, 2.0, 2.0, "ISO-W"),
        (20.0, 2.0, 2.0, "adapted SAE"),
        (27.4, 2.0, -3.27, "ISO-W"),
        (-20.0, -2.0, 2.0, "adapted SAE"),
        (20.0, -2.0, 2.0, "ISO-W"),
    ],
)
def test_axes_go_by_the_cornering_stiffness(PKY1, PKY2, PKY4, axes):
    """A positive slip angle gives a force to the left whichever coefficient carries the sign."""
    tir = (
        bare()
        .with_values({"PKY1": PKY1, "PKY2": PKY2})
        .with_values({"PKY4": PKY4}, section={"PKY4": "LATERAL_COEFFICIENTS"})
    )
    tire = MagicFormulaTire.from_tir(tir)
    assert tire.axes == axes
    assert tire.forces(0.0, 0.03, 4000.0).F_y > 500
    assert tire.to_tir().text == tir.text


def test_version_5_2_has_no_pky4():
    tir = bare("FITTYP = 6", "PKY4 = -2\n").with_values({"PKY1": 20.0})
    with pytest.warns(ModelWarning, match="PKY4"):
        assert MagicFormulaTire.from_tir(tir).axes == "adapted SAE"


def test_a_slip_ratio_that_brakes_is_turned_round():
    usual = MagicFormulaTire.from_tir(bare())
    with pytest.warns(ModelWarning, match=r"PKX1 = -22\): a positive slip ratio of its coefficients brakes"):
        turned = MagicFormulaTire.from_tir(bare().with_values({"PKX1": -22.0}))
    slip = np.linspace(-0.3, 0.3, 13)
    for name in ("F_x", "F_y", "K_x"):
        a, b = (getattr(t.evaluate(slip, 0.05, 4000.0, axes="ISO-W"), name) for t in (usual, turned))
        np.testing.assert_allclose(b, a, rtol=1e-12)


def test_a_stiffness_of_both_signs_is_said():
    with pytest.warns(ModelWarning, match="changes its sign with load, at 6000 N against 4000 N"):
        MagicFormulaTire.from_tir(bare(extra="PKY4 = 5.8\n"))


def test_a_coefficient_beyond_its_range_can_be_waived(tmp_path):
    tir = bare(extra="[A]\nQCZ1 = 58.8\nQDZ1 = 0.1\nQBZ1 = 10\n")
    with pytest.raises(FormatError, match=r"QCZ1 = 58.8 \(trail shape factor\); expected 0 to 10: .* --force|force"):
        MagicFormulaTire.from_tir(tir)
    with pytest.warns(ModelWarning, match="QCZ1 = 58.8 .* used as it stands"):
        tire = MagicFormulaTire.from_tir(tir, force=True)
    x = np.tan(-0.02)
    K = -20 * 4000 * math.sin(2 * math.atan(0.5))
    F_y = 4400 * math.sin(1.3 * math.atan(K / (1.3 * 4400) * x))
    trail = 0.1 * 0.31 * math.cos(58.8 * math.atan(10 * x)) * math.cos(0.02)
    assert tire.evaluate(0.0, -0.02, 4000.0, axes="ISO-W").M_z == pytest.approx(-trail * F_y, rel=1e-6)
    assert tire.with_coefficients(PDY1=1.0).coefficients.QCZ1 == 58.8
    from slipangle.models.storage import load, save

    assert load(save(tire, tmp_path / "tire.json")) == tire


def test_what_others_count_by_is_not_waived():
    with pytest.raises(FormatError, match=r"LFZO = -1 .*: correct the file$"):
        MagicFormulaTire.from_tir(bare(extra="LFZO = -1\n"), force=True)


def test_empty_limits_can_be_waived():
    tir = bare(extra="[R]\nPRESMIN = 0\nPRESMAX = 0\n")
    with pytest.warns(ModelWarning, match="PRESMIN = 0 and PRESMAX = 0: no limit"):
        assert MagicFormulaTire.from_tir(tir, force=True).limits.pressure == (-math.inf, math.inf)


def test_no_ratio_of_radii_is_one():
    tir = bare(extra="[V]\nQ_RE0 = 0\n")
    tire = MagicFormulaTire.from_tir(tir)
    assert tire.rolling_radius(4000.0) == 0.31
    assert tire.to_tir().text == tir.text


WRAPPED = "PCX1 = 1.6 $shape factor of the force\nalong, as measured on (dry) asphalt\n  and wet\n"


def test_comments_that_wrap(tmp_path):
    text = BARE.format(head="FITTYP = 61").replace("PCX1 = 1.6\n", WRAPPED)
    with pytest.warns(ModelWarning, match="line 9 of 'tir' and 1 more is read as the rest of the comment above it"):
        tir = parse_tir(text)
    assert tir.number("PCX1") == 1.6
    assert tir.text == text
    assert tir.with_values({"PCX1": 1.5}).number("PCX1") == 1.5


@pytest.mark.parametrize("line", ["PDX1 1.2", "PDX1: 1.2", "PDX1", "MASS 9", "[MODEL", "1.0 x 2", "PDX1 1,2"])
def test_what_looks_like_an_entry_is_no_comment(line):
    text = BARE.format(head="FITTYP = 61").replace("PCX1 = 1.6\n", f"PCX1 = 1.6 $shape\n{line}\n")
    with pytest.raises(FormatError, match="line 9 of 'tir' reads"):
        parse_tir(text)
