"""One module per table of the thesis: ``slipangle reproduce table-8.2`` runs ``table_8_2.py``.

A module supplies ``reproduce(progress) -> Reproduction``; its docstring says protocol, data and seeds. Benchmarks
follow the same contract in the checkout's ``benchmarks`` folder, as ``bench_NAME.py`` with ``bench(progress)``.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from slipangle.errors import ConfigError, nearest
from slipangle.report.records import Record

Progress = Callable[[float, str], None]  # share done (0 to 1), what is being done


@dataclass(frozen=True, kw_only=True)
class Reproduction:
    """Outcome of one experiment or benchmark: records, protocol (data, split, seeds), Plotly figures, their titles."""

    title: str
    records: Sequence[Record]
    protocol: str
    figures: Sequence[Any] = ()
    captions: Sequence[str] = ()

    @classmethod
    def told(
        cls,
        doc: str | None,
        records: Sequence[Record],
        figures: Sequence[Any] = (),
        captions: Sequence[str] = (),
        *,
        more: str = "",
    ) -> Reproduction:
        """The outcome of a module whose docstring is title and protocol; ``more`` is added to the latter."""
        title, _, rest = (doc or "").partition("\n\n")
        text = " ".join(f"{rest} {more}".split())
        return cls(title=title.strip().rstrip("."), records=records, protocol=text, figures=figures, captions=captions)

    @property
    def holds(self) -> bool:
        """Whether every bound holds."""
        return all(record.holds is None or record.holds for record in self.records)


def run(experiment: Callable[[Progress], Reproduction], progress: Progress) -> Reproduction:
    """What an experiment's ``reproduce``, or a benchmark's ``bench``, gives; that it is done is told here."""
    outcome = experiment(progress)
    progress(1.0, "done")
    return outcome


def names() -> list[str]:
    """Names for ``slipangle reproduce``.

    >>> "table-8.2" in names()
    True
    """
    return sorted(_spoken(m.name) for m in pkgutil.iter_modules(__path__) if not (m.ispkg or m.name.startswith("_")))


def find(name: str) -> ModuleType:
    """The module of an experiment.

    Raises ConfigError if there is none of that name; the nearest names are given.
    """
    if name not in names():
        raise ConfigError(f"there is no experiment '{name}'; {nearest(name, names())}: use one of these names")
    return importlib.import_module(f"{__name__}.{name.replace('-', '_').replace('.', '_')}")


def benchmark_folder() -> Path | None:
    """The checkout's ``benchmarks`` folder, or None for an installation without it."""
    folder = Path(__file__).parents[3] / "benchmarks"
    return folder if folder.is_dir() else None


def benchmark_names() -> list[str]:
    """Names for ``slipangle bench``."""
    folder = benchmark_folder()
    return sorted(p.stem.removeprefix("bench_").replace("_", "-") for p in folder.glob("bench_*.py")) if folder else []


def find_benchmark(name: str) -> ModuleType:
    """The module of a benchmark.

    Raises ConfigError if there is none of that name, or no checkout to take it from.
    """
    folder = benchmark_folder()
    if folder is None:
        raise ConfigError(
            "the benchmarks are not installed; expected a checkout of the project with its 'benchmarks' folder: "
            "clone it and install with pip install --editable"
        )
    if name not in benchmark_names():
        raise ConfigError(f"there is no benchmark '{name}'; {nearest(name, benchmark_names())}: use one of these names")
    path = folder / f"bench_{name.replace('-', '_')}.py"
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ConfigError(f"'{path}' cannot be loaded; expected a Python file")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _spoken(module: str) -> str:
    """``table_8_2`` is spoken ``table-8.2``."""
    kind, _, rest = module.partition("_")
    return f"{kind}-{rest.replace('_', '.')}"
