"""One BLAS thread while many small problems are solved."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy

_NAMES = ("scipy_openblas_{}_num_threads64_", "scipy_openblas_{}_num_threads", "openblas_{}_num_threads64_")
_NAMES += ("openblas_{}_num_threads",)


class _Library(NamedTuple):
    get: Any
    set: Any


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
    before = [library.get() for library in libraries]
    for library in libraries:
        library.set(1)
    try:
        yield
    finally:
        for library, count in zip(libraries, before, strict=True):
            library.set(count)


@cache
def _libraries() -> tuple[_Library, ...]:
    """The OpenBLAS libraries that came with NumPy and SciPy."""
    libraries = []
    for package in (np, scipy):
        root = Path(str(package.__file__)).parent
        for folder in (root.parent / f"{root.name}.libs", root / ".dylibs"):
            for path in sorted(folder.glob("*openblas*")) if folder.is_dir() else ():
                try:
                    library = ctypes.CDLL(str(path))
                except OSError:
                    continue
                for name in _NAMES:
                    if hasattr(library, name.format("set")) and hasattr(library, name.format("get")):
                        libraries.append(
                            _Library(getattr(library, name.format("get")), getattr(library, name.format("set")))
                        )
                        break
    return tuple(libraries)
