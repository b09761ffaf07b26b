"""Locks of the compiler cache: whoever holds one and is killed, or never ends, keeps nobody for long."""

import os
import subprocess
import sys
import time

import pytest

from slipangle.codegen import cache as code_cache


@pytest.mark.skipif(code_cache.fcntl is None, reason="no locks here")
@pytest.mark.parametrize("ends", ["killed", "never"])
def test_a_lock_holds_no_longer_than_its_process_lives_or_the_others_wait(tmp_path, ends):
    holds = "import time; from pathlib import Path; from slipangle.codegen import cache\n"
    holds += f"with cache.one_at_a_time(Path({str(tmp_path)!r}), 'it', 1.0): print('in', flush=True); time.sleep(600)"
    other = subprocess.Popen([sys.executable, "-c", holds], stdout=subprocess.PIPE, text=True)
    with other:
        assert other.stdout.readline() == "in\n"
        if ends == "killed":
            other.kill()
            other.wait()
        began = time.monotonic()
        with code_cache.one_at_a_time(tmp_path, "it", 300.0 if ends == "killed" else 0.2):
            waited = time.monotonic() - began
        other.kill()
    assert waited < 100.0 if ends == "killed" else waited >= 0.2
    assert list(tmp_path.iterdir()) == []


def test_locks_that_were_left_long_ago_are_swept_and_others_stay(tmp_path):
    for name in (".old.lock", ".new.lock", ".old.txt"):
        (tmp_path / name).touch()
    for name in (".old.lock", ".old.txt"):
        os.utime(tmp_path / name, (0.0, 0.0))
    code_cache.sweep(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {".new.lock", ".old.txt"}
