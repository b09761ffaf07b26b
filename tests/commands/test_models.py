"""`slipangle identify`: a file for each model."""

import json
import math
import re
from pathlib import Path

import numpy as np

import slipangle as sa
from slipangle.cli import main
from slipangle.commands.models import _estimates, _files, load_models
from slipangle.units import shown_in_si
from tests.report.example import fit_info


def test_models_whose_names_give_one_file_get_one_each():
    files = _files("out", ["a b", "a_b", "A/B", "c"])
    assert files == {
        name: Path("out") / f"{stem}.json"
        for name, stem in {"a b": "a-b", "a_b": "a-b-2", "A/B": "a-b-3", "c": "c"}.items()
    }


def test_two_files_of_one_name_are_two_models(tmp_path):
    u, y = np.random.default_rng(0).standard_normal((2, 40))
    data = sa.Dataset.from_arrays({"u": u}, {"y": y}, 0.1)
    fitted = {"monday": sa.ARX(na=1, nb=1).fit(data), "friday": sa.ARX(na=2, nb=1).fit(data)}
    files = [str(sa.save(model, tmp_path / day / "arx.json")) for day, model in fitted.items()]
    files.append(str(sa.save(fitted["monday"], tmp_path / "other.json")))
    loaded = load_models([*files, files[-1]])
    assert [*loaded] == [str(tmp_path / "monday" / "arx"), str(tmp_path / "friday" / "arx"), "other"]
    assert [m.na for m in loaded.values()] == [1, 2, 1]


JOB = """title = "a log"
[data]
file = "log.csv"
inputs = ["delta"]
outputs = ["r", "U"]
train = 0.6
columns.delta = { column = "delta", unit = "rad" }
columns.r = { column = "r", unit = "rad/s" }
columns.U = { column = "U", unit = "-" }
[[model]]
name = "arx"
kind = "arx"
na = 1
nb = 1
"""


def test_errors_are_printed_with_their_units(tmp_path, capsys):
    """As the page has them: in deg/s, with --si in rad/s; of a number alone no unit."""
    delta, noise, other = np.random.default_rng(0).standard_normal((3, 400))
    rows = zip(0.02 * np.arange(400), delta, np.roll(delta, 1) + 0.1 * noise, np.roll(delta, 1) + other, strict=True)
    text = "".join(",".join(f"{v:.5f}" for v in row) + "\n" for row in rows)
    (tmp_path / "log.csv").write_text("time [s],delta,r,U\n" + text)
    (tmp_path / "job.toml").write_text(JOB)
    job, out = str(tmp_path / "job.toml"), str(tmp_path / "models")
    assert main(["identify", job, "--out", out, "--json"]) == 0
    capsys.readouterr()
    printed = []
    for more in ((), ("--si",), ("--json",)):
        assert main(["validate", f"{out}/arx.json", "--data", job, *more]) == 0
        printed.append(capsys.readouterr().out)
    rmse = json.loads(printed[2])["free_run"]["r"]["rmse"]
    assert 0.05 < rmse < 0.2
    for said, factor, unit in ((printed[0], 180 / math.pi, "deg/s"), (printed[1], 1.0, "rad/s")):
        assert f"RMSE {factor * rmse:.4g} {unit}   R2" in said
        assert re.search(r"free run +U .*RMSE [\d.]+   R2", said)


def test_estimates_are_printed_as_the_page_has_them():
    info = fit_info()  # with an offset of -0.0021 rad
    offset = info.names.index("steering_offset")
    assert _estimates(info)[offset].split()[1:3] == [f"{math.degrees(-0.0021):.4f}", "deg"]
    assert _estimates(info)[0].split()[1:4] == ["81", "230", "N/rad"]
    with shown_in_si():
        assert _estimates(info)[offset].split()[1:3] == ["-0.002100", "rad"]
