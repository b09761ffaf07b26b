"""Shared fixtures."""

import os
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # tests already run in parallel; set before NumPy loads
    os.environ.setdefault(threads, "1")

import pytest  # noqa: E402


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the public data sets; the test skips where it is absent."""
    folder = os.environ.get("SLIPANGLE_DATA") or str(Path(__file__).parents[2] / "shared" / "data")
    if not Path(folder).is_dir():
        pytest.skip(f"public data sets are not here: SLIPANGLE_DATA is unset and there is no {folder}")
    os.environ["SLIPANGLE_DATA"] = folder
    return Path(folder)
