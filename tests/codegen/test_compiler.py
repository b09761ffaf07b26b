"""The compiler cache: once per content, whole or not at all, only from this user's hands, and a sentence otherwise."""

import ctypes
import os
import shlex
import shutil
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from slipangle.codegen import cache as code_cache
from slipangle.codegen import compiler as compiled
from slipangle.errors import ConfigError, ModelWarning
from slipangle.files import cache_folder, private_folder

SOURCE = "double twice(double x) { return 2 * x; }\n"
needs_compiler = pytest.mark.skipif(compiled.compiler() is None, reason=compiled.sentence())
needs_owners = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owners here")

# Another process, so that a library which crashes when it is loaded cannot take the tests along.
CHILD = """
import ctypes, sys
from slipangle.codegen import compiler as compiled
loaded = compiled.library(open(sys.argv[1]).read(), name="twice")
loaded.twice.restype, loaded.twice.argtypes = ctypes.c_double, [ctypes.c_double]
print(loaded.twice(4.0), loaded._name)
"""


@pytest.fixture
def folder(monkeypatch, tmp_path):
    tmp_path.chmod(0o700)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiled, "_stuck", set())
    compiled._say_once.cache_clear()
    return tmp_path / "slipangle"


def files(folder):
    """What is in the cache, besides Zig's own."""
    return [p for p in folder.iterdir() if p.name != "zig"]


def call(library, x):
    library.twice.restype, library.twice.argtypes = ctypes.c_double, [ctypes.c_double]
    return library.twice(x)


def in_a_new_process(tmp_path, **environment):
    """Value and place of the library, and the messages."""
    (tmp_path / "source.c").write_text(SOURCE)
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(tmp_path / "source.c")],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, (done.returncode, done.stderr[-500:])
    value, place = done.stdout.split(maxsplit=1)
    assert float(value) == 8.0
    return Path(place.strip()), done.stderr


def shared_library(source, folder, name):
    """A foreign library, made without the cache."""
    (folder / "foreign.c").write_text(source)
    made = folder / name
    cc = [*compiled.compiler(), "-shared", "-fPIC", "-o", str(made), str(folder / "foreign.c")]
    subprocess.run(cc, check=True, capture_output=True)
    return made.read_bytes()


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
def test_several_files_are_one_library_and_the_wrong_one_is_named(tmp_path):
    one, other, target = tmp_path / "one.c", tmp_path / "other.c", tmp_path / f"both{compiled.SUFFIX}"
    one.write_text("double twice(double x);\ndouble fourfold(double x) { return twice(twice(x)); }\n")
    other.write_text(SOURCE)
    made = compiled.compile_file([one, other], target)
    loaded = ctypes.CDLL(str(target))
    loaded.fourfold.restype, loaded.fourfold.argtypes = ctypes.c_double, [ctypes.c_double]
    assert loaded.fourfold(2.0) == 8.0
    assert "-shared" in made["flags"]
    other.write_text("int x = nonsense;\n")
    with pytest.raises(ConfigError, match=r"did not compile '[^']*other\.c' \(.*error.*\).*SLIPANGLE_CC"):
        compiled.compile_file([one, other], tmp_path / "none.so")
    assert not (tmp_path / "none.so").exists()


@needs_compiler
def test_unwritable_cache_still_compiles(monkeypatch, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert call(compiled.library(SOURCE, name="twice"), 5.0) == 10.0
    assert len(files(private_folder())) == 1  # the next process finds it there


@pytest.mark.parametrize("named", ["none", "NONE", "/no/such/cc -x"])
def test_no_compiler(monkeypatch, named):
    monkeypatch.setenv("SLIPANGLE_CC", named)
    assert compiled.compiler() is None
    assert compiled.library(SOURCE, name="twice") is None
    assert "ziglang" in compiled.sentence()


@needs_compiler
@pytest.mark.parametrize("damage", ["half", "start", "empty", "garbage", "flipped", "longer", "foreign"])
def test_damaged_library_is_rebuilt(folder, tmp_path, damage):
    compiled.library(SOURCE, name="twice")
    (made,) = files(folder)
    good = made.read_bytes()
    foreign = shared_library("int other(void) { return 7; }\n", tmp_path, "foreign.so")
    flipped = bytearray(good)
    for i in range(64, len(good), max(1, len(good) // 200)):
        flipped[i] ^= 0xFF
    bad = {
        "half": good[: len(good) // 2],
        "start": good[:5000],
        "empty": b"",
        "garbage": b"no library\n" * 100,
        "flipped": bytes(flipped),
        "longer": good + b"\0",
        "foreign": foreign,
    }[damage]
    fresh = made.with_suffix(".new")  # not in place: this process has the good one mapped
    fresh.write_bytes(bad)
    fresh.chmod(0o700)
    fresh.replace(made)
    place, _ = in_a_new_process(tmp_path)
    assert place.parent == folder
    assert [p.read_bytes() for p in files(folder)] != [bad]
    assert len(files(folder)) == 1


@needs_compiler
def test_a_library_of_another_source_under_this_name_is_not_loaded(folder, tmp_path):
    compiled.library(SOURCE.replace("2 *", "3 *"), name="twice")
    (other,) = files(folder)
    raw = other.read_bytes()
    compiled.library(SOURCE, name="twice")
    (mine,) = (p for p in files(folder) if p != other)
    mine.rename(folder / "kept")
    stem = mine.name.rsplit("-", 1)[0]
    (folder / f"{stem}-{other.name.rsplit('-', 1)[1]}").write_bytes(raw)  # whole, but compiled from something else
    in_a_new_process(tmp_path)


@needs_compiler
@needs_owners
def test_a_planted_library_does_not_run(folder, tmp_path):
    """A folder open to all, with a library that leaves a mark when it is loaded, under every name that fits."""
    mark = tmp_path / "it-ran"
    code = f"""
        #include <stdio.h>
        double twice(double x) {{ return 0; }}
        __attribute__((constructor)) static void run(void) {{ fclose(fopen("{mark}", "w")); }}
    """
    planted = shared_library(textwrap.dedent(code), tmp_path, "planted.so")
    compiled.library(SOURCE, name="twice")
    (made,) = files(folder)
    made.unlink()
    made.write_bytes(planted)
    made.chmod(0o777)
    folder.chmod(0o777)
    in_a_new_process(tmp_path)
    assert not mark.exists()
    assert folder.stat().st_mode & 0o777 == 0o700


@needs_compiler
@needs_owners
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize("foreign", ["folder", "parent", "file"])
def test_somebody_elses_folder_or_file_is_not_used(folder, tmp_path, tmp_path_factory, foreign):
    compiled.library(SOURCE, name="twice")
    (made,) = files(folder)
    os.chown({"folder": folder, "parent": tmp_path, "file": made}[foreign], 4242, 4242)
    try:
        place, said = in_a_new_process(tmp_path, TMPDIR=str(tmp_path_factory.mktemp("private")))
    finally:
        os.chown(tmp_path, 0, 0)
    if foreign == "file":
        assert place.parent == folder
        assert place.stat().st_uid == 0
    else:
        assert place.parent != folder
        assert "belongs to another user, so what is compiled there could be changed by others" in said


@needs_owners
def test_folders_that_others_can_write_are_left_out(monkeypatch, tmp_path):
    tmp_path.chmod(0o777)
    with pytest.raises(PermissionError, match="can be written by other users"):
        code_cache.prepare(tmp_path / "slipangle")
    tmp_path.chmod(0o1777)  # as /tmp is: nobody can rename what is ours
    assert code_cache.prepare(tmp_path / "slipangle").stat().st_mode & 0o777 == 0o700
    (tmp_path / "link").symlink_to(tmp_path / "slipangle")
    assert code_cache.prepare(tmp_path / "link") == tmp_path / "slipangle"


@needs_owners
def test_made_folders_are_private_whatever_the_umask(tmp_path):
    before = os.umask(0)
    try:
        made = code_cache.prepare(tmp_path / "a" / "b")
    finally:
        os.umask(before)
    assert [p.stat().st_mode & 0o777 for p in (made.parent, made)] == [0o700, 0o700]


@needs_compiler
@needs_owners
def test_an_unsafe_folder_is_said_once(monkeypatch, folder, tmp_path, tmp_path_factory):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path_factory.mktemp("private")))
    tmp_path.chmod(0o777)
    with pytest.warns(ModelWarning, match=r"can be written by other users.*is used instead: set XDG_CACHE_HOME"):
        assert call(compiled.library(SOURCE, name="twice"), 1.0) == 2.0
    assert call(compiled.library(SOURCE, name="again"), 1.0) == 2.0
    tmp_path.chmod(0o700)


def test_relative_cache_folder_is_ignored(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "slipangle"


def test_without_a_home_every_process_uses_the_same_folder(monkeypatch):
    def no_home():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    assert cache_folder() == private_folder()
    assert private_folder().is_absolute()


@needs_owners
@pytest.mark.skipif(not shutil.which("sleep"), reason="no sleep")
def test_a_hanging_compiler_is_stopped(monkeypatch, folder, tmp_path):
    script = tmp_path / "cc-hangs"
    script.write_text('#!/bin/sh\n[ "$1" = --version ] && exit 0\nsleep 600 & echo $! > "$0.pid"; wait\n')
    script.chmod(0o755)
    monkeypatch.setenv("SLIPANGLE_CC", str(script))
    monkeypatch.setenv("SLIPANGLE_CC_LIMIT", "0.5")
    with pytest.warns(ModelWarning, match=r"it ran past 0.5 s; SLIPANGLE_CC_LIMIT sets another limit"):
        assert compiled.library(SOURCE, name="twice") is None
    with pytest.warns(ModelWarning, match=r"it ran past 0.5 s before"):  # and is not waited for again
        assert compiled.library(SOURCE, name="again") is None
    child = int(script.with_suffix(".pid").read_text())
    deadline = time.monotonic() + 5
    while time.monotonic() < deadline and _runs(child):
        time.sleep(0.01)
    assert not _runs(child)
    assert files(folder) == []


def _runs(pid):
    state = Path(f"/proc/{pid}/stat")
    return state.exists() and state.read_text().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.parametrize("variable", ["SLIPANGLE_CC", "SLIPANGLE_CFLAGS"])
@pytest.mark.parametrize("named", ["cc 'x", 'cc "'])
def test_a_compiler_that_cannot_be_understood(monkeypatch, variable, named):
    monkeypatch.setenv(variable, named)
    if variable != "SLIPANGLE_CC" and compiled.compiler() is None:
        pytest.skip(compiled.sentence())
    with pytest.raises(ConfigError, match=rf"{variable} is .*No closing quotation.*expected .* of a C compiler"):
        compiled.library(SOURCE, name="twice")


@needs_compiler
@pytest.mark.parametrize("named", ["soon", "-1", "nan"])
def test_a_limit_that_cannot_be_understood(monkeypatch, folder, named):
    monkeypatch.setenv("SLIPANGLE_CC_LIMIT", named)
    with pytest.raises(ConfigError, match=r"SLIPANGLE_CC_LIMIT is .*expected seconds"):
        compiled.library(SOURCE, name="limit")


def test_a_compiler_that_is_no_program(monkeypatch, folder, tmp_path):
    script = tmp_path / "cc-text"
    script.write_bytes(b"\x00\x01 not a program")
    script.chmod(0o755)
    monkeypatch.setenv("SLIPANGLE_CC", str(script))
    with pytest.warns(ModelWarning, match="did not compile 'twice' .it cannot be run: "):
        assert compiled.library(SOURCE, name="twice") is None


@needs_compiler
@pytest.mark.skipif(sys.platform != "linux", reason="limits as Linux sets them")
@pytest.mark.parametrize("blocks", [0, 1])
def test_no_room_for_files_runs_uncompiled(folder, tmp_path, blocks):
    (tmp_path / "source.c").write_text(f"{SOURCE}// {tmp_path}")  # in no cache
    child = CHILD.split("loaded.twice")[0] + "print(loaded)"
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({blocks} * 512, {blocks} * 512))\n"
    done = subprocess.run(
        [sys.executable, "-c", limit + child, str(tmp_path / "source.c")],
        env={**os.environ, "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout.strip()) == (0, "None"), done.stderr[-500:]
    assert "did not compile 'twice'" in done.stderr
    assert "Traceback" not in done.stderr


@needs_compiler
def test_scratch_of_killed_processes_goes_when_it_is_old(folder):
    folder.mkdir()
    for name, age in ((".mpc.old", 90000.0), (".mpc.new", 60.0)):
        (folder / name).mkdir()
        (folder / name / "model.c").write_text(SOURCE)
        os.utime(folder / name, (time.time() - age,) * 2)
    compiled.library(SOURCE, name="twice")
    assert sorted(p.name for p in files(folder) if p.name.startswith(".")) == [".mpc.new"]


@needs_compiler
@pytest.mark.skipif(code_cache.fcntl is None, reason="no locks here")
def test_of_processes_that_want_the_same_one_compiles_and_the_others_wait(folder, tmp_path):
    script, calls = tmp_path / "cc-counts", tmp_path / "calls"
    counted = f'[ "$1" = --version ] || {{ echo >> {calls}; sleep 1; }}'
    script.write_text(f'#!/bin/sh\n{counted}\nexec {shlex.join(compiled.compiler())} "$@"\n')
    script.chmod(0o755)
    (tmp_path / "source.c").write_text(SOURCE)
    call_child = [sys.executable, "-c", CHILD, str(tmp_path / "source.c")]
    given = {**os.environ, "SLIPANGLE_CC": str(script)}
    running = [subprocess.Popen(call_child, stdout=subprocess.PIPE, text=True, env=given) for _ in range(3)]
    assert [p.communicate()[0].split()[0] for p in running] == ["8.0"] * 3
    assert len(calls.read_text()) == 1
    (made,) = files(folder)
    assert code_cache._own(made)


@needs_compiler
def test_functions_know_their_arguments():
    source = (
        "static int hidden(int a) { return a; }\n"
        "double scaled(const double *x, long n, double by)\n{\n    double sum = 0;\n"
        "    for (long i = 0; i < n; i++) sum += by * x[i];\n    return sum + hidden(0);\n}\n"
        "typedef struct { int a; } thing;\nthing *same(thing *p)\n{\n    return p;\n}\nint one(void) { return 1; }\n"
        "#ifdef NEVER\nint never(int a) { return a; }\n#endif\n"
    )
    loaded = compiled.library(source, name="typed")
    x = np.array([1.0, 2.0])
    assert loaded.scaled(x.ctypes.data, 2, 3) == 9.0
    assert loaded.same(x.ctypes.data) == x.ctypes.data
    assert loaded.one() == 1
    with pytest.raises(ctypes.ArgumentError):
        loaded.scaled(x.ctypes.data, 2.5, 3.0)
