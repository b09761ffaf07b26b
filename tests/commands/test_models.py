"""`slipangle identify`: a file for each model."""

from pathlib import Path

import numpy as np

import slipangle as sa
from slipangle.commands.models import _files, load_models


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
