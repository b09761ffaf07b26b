"""The compiler cache: once per content, whole or not at all, and a sentence where it cannot work."""

import ctypes

import pytest

from slipangle.errors import ModelWarning
from slipangle.models import compiled

SOURCE = "double twice(double x) { return 2 * x; }\n"
needs_compiler = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "slipangle"


def files(folder):
    """What is in the cache, besides Zig's own."""
    return [p for p in folder.iterdir() if p.name != "zig"]


def call(library, x):
    library.twice.restype, library.twice.argtypes = ctypes.c_double, [ctypes.c_double]
    return library.twice(x)


@needs_compiler
def test_compiles_once_and_serves_from_the_cache(folder):
    assert call(compiled.library(SOURCE, name="twice"), 3.0) == 6.0
    (made,) = files(folder)
    assert made.name.startswith("twice-")
    before = made.stat().st_mtime_ns
    compiled._library.cache_clear()
    assert call(compiled.library(SOURCE, name="twice"), 4.0) == 8.0
    assert [p.stat().st_mtime_ns for p in files(folder)] == [before]


@needs_compiler
def test_other_content_is_another_file(folder):
    compiled.library(SOURCE, name="twice")
    compiled.library(SOURCE.replace("2 *", "3 *"), name="twice")
    assert len(files(folder)) == 2


@needs_compiler
def test_rejected_source_warns_and_leaves_nothing(folder):
    with pytest.warns(ModelWarning, match=r"did not compile 'broken' \(.*error.*\).*SLIPANGLE_CC"):
        assert compiled.library("int x = nonsense;\n", name="broken") is None
    assert files(folder) == []


@needs_compiler
def test_unwritable_cache_still_compiles(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert call(compiled.library(SOURCE, name="twice"), 5.0) == 10.0


@pytest.mark.parametrize("named", ["none", "NONE", "/no/such/cc -x"])
def test_no_compiler(monkeypatch, named):
    monkeypatch.setenv("SLIPANGLE_CC", named)
    assert compiled.compiler() is None
    assert compiled.library(SOURCE, name="twice") is None
    assert "ziglang" in compiled.sentence()
