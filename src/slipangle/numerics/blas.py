"""One BLAS thread while many small problems are solved."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import scipy

_NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads64_")
_NAMES += ("openblas_{}_num_threads",)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Keep the linear algebra of the block in the calling thread.

    OpenBLAS starts threads from about a hundred rows on and lets them spin; for the small matrices of a fit that costs
    more than it gains, a hundred times more on a busy machine. Other BLAS libraries are left alone.

    >>> with one_blas_thread():
    ...     float(np.linalg.norm(np.linalg.qr(np.eye(3))[0]).round(6))
    1.732051
    """
    libraries = _libraries()
    before = [get() for get, _ in libraries]
    for _, put in libraries:
        put(1)
    try:
        yield
    finally:
        for (_, put), count in zip(libraries, before, strict=True):
            put(count)


@cache
def _libraries() -> tuple[tuple[Any, Any], ...]:
    """How the OpenBLAS libraries that came with NumPy and SciPy tell and take their number of threads."""
    libraries = []
    for package in (np, scipy):
        root = Path(str(package.__file__)).parent
        for folder in (root.parent / f"{root.name}.libs", root / ".dylibs"):
            for path in sorted(folder.glob("*openblas*")) if folder.is_dir() else ():
                try:
                    library = ctypes.CDLL(str(path))
                except OSError:
                    continue
                known = (n for n in _NAMES if hasattr(library, n.format("set")) and hasattr(library, n.format("get")))
                for name in islice(known, 1):
                    libraries.append((getattr(library, name.format("get")), getattr(library, name.format("set"))))
    return tuple(libraries)
