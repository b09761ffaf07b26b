"""Shared fixtures."""

import os
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # tests already run in parallel; set before NumPy loads
    os.environ.setdefault(threads, "1")

os.environ.setdefault("SLIPANGLE_LIVE", "none")  # pages without what a compiler needs seconds for, but where asked

import pytest  # noqa: E402

from slipangle.codegen import compiler  # noqa: E402
from slipangle.data.public import registry  # noqa: E402
from slipangle.optimal.ipopt import Ipopt  # noqa: E402
from slipangle.optimal.realtime import RealTime, backend  # noqa: E402

# Half of an everyday run was the C compiler's, and most of that its optimiser's. Tests in these folders ask what a
# plan, an estimate or a model is, not how optimised code computes it: their libraries are compiled without, in a
# quarter of the time. That optimised code says the same is asked by all others (of the solver itself in
# optimal/realtime, of fits, jobs and exported code, which run so long that it pays), and by `make test-all` of all.
_PLANS = ("after_a_jump", "curvature", "exact_tracking", "repeated_steps", "stages", "truth")
_PLAIN = ("optimal", "control", "estimate", "models", "simulate", *(f"optimal/realtime/test_{n}.py" for n in _PLANS))
_OPTIMISED = ("optimal/realtime", "optimal/lap", "optimal/test_published.py")
_LEVELS = compiler.NATIVE, compiler.PORTABLE


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Choose the optimisation of what the test and its fixtures compile, unless SLIPANGLE_CFLAGS says it."""
    named = [n for n in (*_PLAIN, *_OPTIMISED) if item.path.is_relative_to(Path(__file__).parent / n)]
    without = max(named, key=len, default="") in _PLAIN and item.config.getoption("markexpr") == "not slow"
    compiler.NATIVE, compiler.PORTABLE = (("-O0", *level[1:]) for level in _LEVELS) if without else _LEVELS


class PublicData:
    """The published files that are on this machine; whoever asks for one that is not is skipped.

    Only the registry's own files count, and only with their published content: what else lies in the folder, or is
    missing from it, says nothing about this project.
    """

    def __init__(self, folder: str) -> None:
        self.folder = folder
        self._files = {file.path: file for public in registry.list_sets() for file in public.files}
        self._place = cache(self._look)

    def __call__(self, path: str) -> Path:
        """The file of that path in the registry."""
        place = self._place(path)
        if place is None:
            pytest.skip(f"the published {path} is not in {self.folder}")
        return place

    def glob(self, pattern: str) -> list[Path]:
        """All that are here of the registry's files with such paths."""
        found = [place for path in sorted(self._files) if fnmatch(path, pattern) and (place := self._place(path))]
        if not found:
            pytest.skip(f"no published {pattern} is in {self.folder}")
        return found

    def _look(self, path: str) -> Path | None:
        file = self._files[path]
        places = registry._places(file)
        return next((p for p in places if p.is_file() and registry._digest(p) == file.sha256), None)


@pytest.fixture(scope="session")
def real_data():
    """Public data sets; the test skips where what it asks for, by the loaders too, is absent. Nothing is downloaded."""
    folder = os.environ.get("SLIPANGLE_DATA") or str(Path(__file__).parents[2] / "shared" / "data")
    if not Path(folder).is_dir():
        pytest.skip(f"public data sets are not here: SLIPANGLE_DATA is unset and there is no {folder}")
    data = PublicData(folder)
    fetch_file = registry._fetch_file

    def local(public, file, progress):
        here = os.environ.get("SLIPANGLE_DATA") == folder
        return data(file.path) if here else fetch_file(public, file, progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SLIPANGLE_DATA", folder)
        patch.setattr(registry, "_fetch_file", local)
        yield data


@pytest.fixture(params=["condensed", "riccati", "interpreted", "ipopt"])
def solver(request, monkeypatch):
    """Every solver of optimal control, iterated to convergence."""
    if request.param == "interpreted":
        monkeypatch.setenv("SLIPANGLE_CC", "none")
        monkeypatch.setattr(backend, "_say_once", lambda words: None)
    if request.param == "ipopt":
        return Ipopt(tolerance=1e-13)
    qp = request.param if request.param != "interpreted" else "auto"
    return RealTime(iterations=0, tolerance=1e-11, qp=qp, newton=1e-11)
