"""A folder of an export is written whole or not at all."""

import json

import pytest

from slipangle.errors import ConfigError, WriteError
from slipangle.export import project
from slipangle.export.project import Project, write, written

OLD = Project(name="racer", kind="a thing", sentence="A thing.", files={"car.c": "int car(void);\n"}, drive="1\n")
NEW = Project(name="racer", kind="a thing", sentence="Another.", files={"car.c": "int car(int);\n"}, drive="2\n")


def content(folder):
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def stopped_by(error):
    def more(scratch):
        (scratch / "racer.so").write_bytes(b"half a libr")
        raise error

    return more


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ConfigError("the compiler failed"), OSError(28, "disk full")])
def test_what_is_stopped_leaves_the_folder_as_it_was(tmp_path, error):
    kind = WriteError if isinstance(error, OSError) else type(error)
    with pytest.raises(kind):
        write(NEW, tmp_path / "new", more=stopped_by(error))
    assert not (tmp_path / "new").exists()
    before = content(write(OLD, tmp_path / "old"))
    with pytest.raises(kind):
        write(NEW, tmp_path / "old", force=True, more=stopped_by(error))
    assert content(tmp_path / "old") == before
    (tmp_path / "empty").mkdir()
    with pytest.raises(kind):
        write(NEW, tmp_path / "empty", more=stopped_by(error))
    assert content(tmp_path / "empty") == {}


def test_what_is_foreign_in_the_folder_is_neither_removed_nor_listed(tmp_path):
    (tmp_path / "notes.txt").write_text("own")
    made = write(OLD, tmp_path, force=True)
    assert written(made) == sorted(OLD.everything)
    (tmp_path / "racer.c").unlink()
    (tmp_path / "racer.c").mkdir()
    (tmp_path / "racer.c" / "precious").write_text("own")
    before = (tmp_path / "drive.csv").read_text()
    with pytest.raises(WriteError, match=r"racer\.c' is a folder, where a file is to be written"):
        write(NEW, tmp_path, force=True)
    assert (tmp_path / "racer.c" / "precious").read_text() == "own"
    assert (tmp_path / "drive.csv").read_text() == before


def test_more_is_written_with_the_rest_and_the_manifest_last(tmp_path, monkeypatch):
    moved, replace = [], project.os.replace
    monkeypatch.setattr(project.os, "replace", lambda a, b: (moved.append(b.name), replace(a, b)))
    made = write(NEW, tmp_path / "new", more=lambda scratch: (scratch / "racer.so").write_bytes(b"whole"))
    assert (made / "racer.so").read_bytes() == b"whole"
    assert moved[-1] == "manifest.json"
    assert {*moved} == {*NEW.everything, "racer.so"} == {*content(made)}
    assert json.loads((made / "manifest.json").read_text())["name"] == "racer"
