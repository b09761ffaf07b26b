"""All compiled code under AddressSanitizer and UndefinedBehaviorSanitizer, called wildly, in processes of its own."""

import os
import platform
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from tests.fuzz.wild import PARTS

pytestmark = pytest.mark.slow
FLAGS = "-g -fno-omit-frame-pointer -fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all"
CALLS = {"qp": 5000, "plant": 300, "stages": 60, "sensitivities": 500}
BROKEN = {
    "heap": "double twice(double *x, int n) { return 2 * x[n]; }",
    "undefined": "double twice(double *x, int n) { int big = 2147483000 + n; return big + n * 1000; }",
    "cast": "double twice(double *x, int n) { return (int)(x[0] * 1e300); }",
}
CHILD = """
import ctypes, sys
import numpy as np
from slipangle.codegen import compiler as compiled
run = compiled.library(sys.argv[1], name="broken").twice
run.restype, run.argtypes = ctypes.c_double, [ctypes.c_void_p, ctypes.c_int]
x = np.ones(1000)
print(run(x.ctypes.data, int(sys.argv[2])), "was not noticed")
"""


# CasADi asks for a way of loading its plug-ins that AddressSanitizer refuses.
PLAIN_DLOPEN = """
#define _GNU_SOURCE
#include <dlfcn.h>
void *dlopen(const char *file, int flags)
{
    void *(*next)(const char *, int) = dlsym(RTLD_NEXT, "dlopen");
    return next(file, flags & ~RTLD_DEEPBIND);
}
"""


@cache
def environment(folder):
    """What a process needs to load sanitized code, or None and why not."""
    gcc = shutil.which("gcc")
    if platform.system() != "Linux" or not gcc:
        return None, "the sanitizers are asked of gcc on Linux"
    runtime, exceptions = (_library(gcc, name) for name in ("libasan.so", "libstdc++.so"))
    if not (runtime and exceptions):
        return None, f"{gcc} has no libasan, or no libstdc++ beside it"
    (folder / "dlopen.c").write_text(PLAIN_DLOPEN)
    shim = folder / "dlopen.so"
    subprocess.run([gcc, "-shared", "-fPIC", "-o", shim, folder / "dlopen.c", "-ldl"], check=True)
    settings = {
        "SLIPANGLE_CC": f"{gcc} {FLAGS}",
        "SLIPANGLE_CFLAGS": "-O1",
        "SLIPANGLE_CC_LIMIT": "3600",
        "LD_PRELOAD": f"{shim}:{runtime}:{exceptions}",
        "ASAN_OPTIONS": "detect_leaks=0:exitcode=99:verify_asan_link_order=0",
        "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1",
        "PYTHONMALLOC": "malloc",
        "XDG_CACHE_HOME": str(folder),
    }
    done = run(["-c", "import numpy, casadi"], settings)
    if done.returncode:
        return None, f"the interpreter does not run beside libasan: {done.stderr[-200:]}"
    return settings, ""


def _library(gcc, name):
    asked = [gcc, f"-print-file-name={name}"]
    found = subprocess.run(asked, capture_output=True, text=True, check=False).stdout.strip()
    return found if Path(found).is_absolute() else ""


def run(arguments, settings):
    call = [sys.executable, *arguments]
    root = Path(__file__).parents[2]
    return subprocess.run(
        call, env={**os.environ, **settings}, cwd=root, capture_output=True, text=True, check=False, timeout=3600
    )


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sanitized")
    folder.chmod(0o700)
    settings, why = environment(folder)
    if settings is None:
        pytest.skip(why)
    return settings


@pytest.mark.parametrize("name", BROKEN)
def test_the_sanitizers_see_what_is_broken(sanitized, name):
    done = run(["-c", CHILD, BROKEN[name], "1000"], sanitized)
    assert done.returncode != 0, done.stdout
    assert {"heap": "heap-buffer-overflow"}.get(name, "runtime error") in done.stderr, done.stderr[-2000:]


@pytest.mark.parametrize("part", PARTS)
def test_wild_calls_touch_only_what_is_ours(sanitized, part):
    done = run(["-m", "tests.fuzz.wild", part, str(CALLS.get(part, 1000)), "1"], sanitized)
    assert done.returncode == 0, done.stderr[:4000] + done.stderr[-1000:]
    assert "clean after" in done.stdout
