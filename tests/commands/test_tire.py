"""``slipangle tire``: what it prints and writes, and one sentence for every mistake."""

import argparse
import html
import json
import re
import shlex

import numpy as np
import pytest

from slipangle import commands
from slipangle.cli import main
from slipangle.commands import tire
from slipangle.commands.tire import read_tire
from slipangle.errors import ConfigError, FormatError, MissingFileError, ParameterError, WriteError
from slipangle.models.storage import save
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.neural import NeuralTire
from slipangle.models.tires.physical import BrushTire
from tests.rig import TIRE, channels, write_dat, write_mat


def run(*arguments):
    parser = argparse.ArgumentParser()
    tire.add(commands.Commands(parser.add_subparsers()))
    return commands.run(parser.parse_args(["tire", *map(str, arguments)]))


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig")
    write_mat(folder / "cornering.mat", {k: v[::2] for k, v in channels().items()})
    write_dat(folder / "drive.dat", {k: v[::8] for k, v in channels("drive/brake").items()})
    return folder / "cornering.mat", folder / "drive.dat"


@pytest.fixture
def tir(tmp_path):
    return TIRE.write_tir(tmp_path / "tire.tir")


def test_eval(tir, capsys):
    assert run("eval", tir, "--slip-angle=-5:5:5", "--slip-ratio", "0,0.1", "--load", "600,900", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert len(rows) == 12
    row = next(r for r in rows if (r["load [N]"], r["slip angle [deg]"], r["slip ratio [-]"]) == (900, 5, 0.1))
    expected = TIRE.forces(0.1, np.deg2rad(5.0), 900.0)
    assert row["F_y [N]"] == pytest.approx(expected.F_y, rel=1e-9)
    assert row["F_x [N]"] == pytest.approx(expected.F_x, rel=1e-9)
    assert run("eval", tir, "--load", "600") == 0
    assert "slip angle [deg]" in capsys.readouterr().out


def test_eval_outside_the_range(tmp_path, capsys):
    from dataclasses import replace

    from slipangle.models.tires.magic_formula.validity import ValidRange

    path = replace(TIRE, limits=ValidRange(load=(100.0, 1500.0))).write_tir(tmp_path / "tire.tir")
    with pytest.raises(ParameterError, match=r"load is 5000 N; expected 100 to 1500 N .* extrapolation with --extrap"):
        run("eval", path, "--load", "5000")
    assert run("eval", path, "--load", "5000", "--extrapolate") == 0
    assert "slipangle: the tire is extrapolated: load is 5000 N" in capsys.readouterr().err


def rows_of(capsys, *arguments):
    assert run("eval", *arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_eval_in_other_axes_slips_pressure_and_speed(tir, capsys):
    at = (tir, "--load", "700", "--slip-angle", "4", "--camber", "2")
    gamma, alpha = np.deg2rad(2.0), np.deg2rad(4.0)
    for option, axes in (("iso", "ISO-W"), ("sae", "SAE"), ("adapted-sae", "adapted SAE")):
        (row,) = rows_of(capsys, *at, "--axes", option, "--kappa", "0.05", "--pressure", "90", "--speed", "15")
        known = TIRE.evaluate(0.05, alpha, 700.0, axes=axes, camber=gamma, pressure=90e3, speed=15.0)
        for name in ("F_x", "F_y"):
            assert row[f"{name} [N]"] == pytest.approx(getattr(known, name), rel=1e-9)
        for name in ("M_x", "M_y", "M_z"):
            assert row[f"{name} [N m]"] == pytest.approx(getattr(known, name), rel=1e-9)
        assert row["kappa [-]"] == 0.05
    (s,), (kappa,) = (rows_of(capsys, *at, name, "0.2") for name in ("--slip-ratio", "--kappa"))
    assert s["F_x [N]"] == pytest.approx(TIRE.forces(0.2, alpha, 700.0, camber=gamma).F_x)
    assert kappa["F_x [N]"] == pytest.approx(TIRE.forces(0.2 / 1.2, alpha, 700.0, camber=gamma).F_x)


def test_conventions_by_name(tir, capsys):
    at = (tir, "--load", "700", "--slip-angle", "12", "--camber", "4")
    plain, mfeval = (rows_of(capsys, *at, *more)[0]["F_y [N]"] for more in ((), ("--conventions", "mfeval")))
    named = rows_of(capsys, *at, "--conventions", "lateral_slip=angle,camber=angle")[0]["F_y [N]"]
    assert abs(plain - mfeval) > 0.1
    assert named == pytest.approx(mfeval, rel=1e-9)
    assert rows_of(capsys, *at, "--file-axes", "adapted-sae")[0]["F_y [N]"] == pytest.approx(-plain, rel=0.1)
    for bad, message in (("matlab", "'matlab' is no convention; "), ("camber=sin", "camber is 'sin'")):
        with pytest.raises(SystemExit):
            run("eval", *at, "--conventions", bad)
        assert message in capsys.readouterr().err


def test_force_waives_a_range(tir, capsys):
    tir.write_text(tir.read_text(encoding="utf-8").replace("QCZ1 ", "!QCZ1 ") + "QCZ1 = 58.8\n", encoding="utf-8")
    with pytest.raises(FormatError, match="read it all the same with force=True"):
        run("eval", tir, "--load", "600")
    assert run("eval", tir, "--load", "600", "--force") == 0
    assert "QCZ1 = 58.8 (trail shape factor); expected 0 to 10: used as it stands" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("model", "kind", "extra"),
    [("brush", BrushTire, ()), ("mlp:2,2", NeuralTire, ("--inputs", "load")), ("rbf:2", NeuralTire, ())],
)
def test_fit_writes_a_tire_that_can_be_read(model, kind, extra, runs, tmp_path, capsys):
    out, page = tmp_path / "tire.json", tmp_path / "fit.html"
    assert run("fit", *runs, "--model", model, "--out", out, "--page", page, *extra, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert "sign system of the data: SAE" in told["notes"][0]
    assert told["written"] == [str(out), str(page)]
    assert {row[0] for row in told["errors"]} == {"F_x", "F_y", "M_z", "M_x"}
    assert isinstance(read_tire(out), kind)
    assert "Fit to measurements" in page.read_text(encoding="utf-8")
    assert run("fit", *runs, "--model", "brush", "--out", out) == 0
    told = capsys.readouterr().out
    assert re.search(rf"wrote {re.escape(str(out))}, which replaces the one of \d{{4}}-\d\d-\d\d", told)


@pytest.mark.slow
def test_fit_of_magic_formula_6_1(runs, tmp_path, capsys):
    assert run("fit", *runs, "--radius", "0.26", "--out", tmp_path / "a.tir") == 0
    shown = capsys.readouterr().out
    assert "PDY1" in shown
    assert "95 % interval" in (tmp_path / "a.tir").read_text(encoding="utf-8")
    back = read_tire(tmp_path / "a.tir")
    assert back.forces(0.0, 0.1, 667.0).F_y == pytest.approx(TIRE.forces(0.0, 0.1, 667.0).F_y, rel=0.02)
    assert run("fit", runs[0], "--start", tmp_path / "a.tir", "--side", "LEFT", "--out", tmp_path / "b.tir") == 0
    again = read_tire(tmp_path / "b.tir")
    assert again.mounted("RIGHT").mirrored
    assert again.coefficients.PDX1 == back.coefficients.PDX1  # a cornering run says nothing about F_x


def test_plot(tir, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert run("plot", tir, "--load", "400,800", "--out", page) == 0
    assert f"wrote {page}" in capsys.readouterr().out
    text = page.read_text(encoding="utf-8")
    assert "Combined slip" in text
    assert "M_z over slip angle" in text
    assert "400 N" in text


def test_pages_say_the_whole_command_that_makes_them(tir, runs, tmp_path):
    """Run as it stands there it makes the same page: blanks in names, and options that no table shows."""
    fit = ["tire", "fit", str(runs[0]), "--model", "brush", "--offsets", "--seed", "3", "--page", "my fit.html"]
    plot = ["tire", "plot", str(tir), "--load", "400,800", "--camber", "-2", "--out", "my plot.html"]
    for arguments in (fit, plot):
        page = tmp_path / arguments[-1]
        arguments[-1] = str(page)
        assert main(arguments) == 0
        again = re.search(r'<code id="again">(.*?)</code>', page.read_text(encoding="utf-8"), re.S)
        assert again is not None
        assert shlex.split(html.unescape(again[1])) == ["slipangle", *arguments]


def test_convert_there_and_back(tir, tmp_path, capsys):
    assert run("convert", tir, tmp_path / "a.json") == 0
    assert "replaces" not in capsys.readouterr().out
    assert run("convert", tir, tmp_path / "a.json") == 0
    assert "a.json, which replaces the one of" in capsys.readouterr().out
    assert run("convert", tmp_path / "a.json", tmp_path / "b.tir") == 0
    assert run("convert", tir, tmp_path / "m.json", "--mirror") == 0
    a, b, m = (read_tire(p) for p in (tir, tmp_path / "b.tir", tmp_path / "m.json"))
    at = (0.02, np.linspace(-0.2, 0.2, 21), 700.0)
    assert b.forces(*at).F_y == pytest.approx(a.forces(*at).F_y, rel=1e-12)
    assert m.forces(0.02, -at[1], 700.0).F_y == pytest.approx(-a.forces(*at).F_y, rel=1e-12)
    assert isinstance(b, MagicFormulaTire)


def test_mistakes(tir, runs, tmp_path):
    brush = save(BrushTire(C_alpha=5e4, C_s=6e4), tmp_path / "brush.json")
    cases = [
        (("eval", tmp_path / "no.tir", "--load", "1"), MissingFileError, "no.tir"),
        (("eval", tmp_path / "a.txt", "--load", "1"), FormatError, "ends in '.txt'; expected a .tir file"),
        (("fit", *runs, "--model", "mf62"), ConfigError, "no tire model 'mf62'; expected one of mf61"),
        (("fit", *runs, "--model", "rbf:2,2"), ConfigError, "has one layer"),
        (("fit", *runs, "--model", "brush", "--out", tmp_path / "x.tir"), FormatError, "no place in a .tir file"),
        (("fit", *runs, "--out", tmp_path / "x.doc"), FormatError, "neither .tir nor .json"),
        (("fit", *runs, "--model", "mlp:2", "--inputs", "lode"), ParameterError, "nearest are 'load'"),
        (("fit", tmp_path / "no.mat"), MissingFileError, "does not exist"),
        (("fit", *runs, "--model", "brush", "--start", tir), ConfigError, "--start is for mf61, the model is brush"),
        (("fit", *runs, "--model", "brush", "--side", "LEFT"), ConfigError, "--side is for mf61, the model is brush"),
        (("fit", *runs, "--start", tir, "--radius", "0.2"), ConfigError, "--radius and --start are given"),
        (("plot", tir, "--out", tir / "x.html"), WriteError, "is a file"),
        (("convert", brush, tmp_path / "x.tir"), FormatError, "BrushTire has no place in a .tir file"),
        (("convert", brush, tmp_path / "x.json", "--mirror"), ConfigError, "only a Magic Formula tire can be mirrored"),
        (("convert", tir, tmp_path / "x.tir", "--mirror"), FormatError, "mirrored tire has no place"),
        (("eval", brush, "--load", "1", "--speed", "9"), ParameterError, "a BrushTire does not depend on speed"),
        (("eval", brush, "--load", "1", "--conventions", "mfeval"), FormatError, "for .tir files only"),
    ]
    for arguments, error, message in cases:
        with pytest.raises(error) as caught:
            run(*arguments)
        assert message in str(caught.value), arguments
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["a", "1:2", "0:1:0", "0:1e9:1e-9", "1,,2"])
def test_lists_that_are_none(text, tir, capsys):
    with pytest.raises(SystemExit):
        run("eval", tir, "--load", text)
    assert "is no list of numbers" in capsys.readouterr().err


def test_a_list_may_start_with_a_minus(tir, capsys):
    arguments = ["tire", "eval", str(tir), "--load", "600", "--json", "--slip-angle"]
    assert main([*arguments, "-5:5:5"]) == 0
    apart = capsys.readouterr().out
    assert main([*arguments[:-1], "--slip-angle=-5:5:5"]) == 0
    assert apart == capsys.readouterr().out
