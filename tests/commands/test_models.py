"""`slipangle identify`: a file for each model."""

from pathlib import Path

from slipangle.commands.models import _files


def test_models_whose_names_give_one_file_get_one_each():
    files = _files("out", ["a b", "a_b", "A/B", "c"])
    assert files == {
        name: Path("out") / f"{stem}.json"
        for name, stem in {"a b": "a-b", "a_b": "a-b-2", "A/B": "a-b-3", "c": "c"}.items()
    }
