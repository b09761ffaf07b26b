"""Tires from files: a ``.tir``, or what slipangle saved."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from slipangle.errors import FormatError
from slipangle.models.storage import load
from slipangle.models.tires.magic_formula.tire import MagicFormulaTire
from slipangle.models.tires.simple import Tire

if TYPE_CHECKING:
    from slipangle.models.tires.magic_formula.axes import AxisSystem
    from slipangle.models.tires.magic_formula.terms import Conventions

FILES = "a .tir file, or a tire that slipangle saved as .json"


def read_tire(
    path: str | Path,
    *,
    outside: Literal["error", "extrapolate"] = "error",
    conventions: Conventions | None = None,
    axes: AxisSystem | None = None,
    force: bool = False,
) -> Tire:
    """Tire of a ``.tir`` file or of a JSON file that slipangle saved.

    ``outside``, ``conventions``, ``axes`` and ``force`` are those of `MagicFormulaTire.from_tir`; a JSON file has its
    own. Raises MissingFileError or FormatError if there is no such file, or it is not one of a tire.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".tir":
        return MagicFormulaTire.from_tir(path, outside=outside, conventions=conventions, axes=axes, force=force)
    if suffix != ".json":
        raise FormatError(f"'{path}' ends in '{suffix}'; expected {FILES}")
    if conventions or axes or force:
        raise FormatError(
            f"'{path}' holds a tire with its conventions and axes; expected --conventions, --file-axes and --force for "
            ".tir files only: leave them out"
        )
    tire = load(path)
    if not isinstance(tire, Tire):
        raise FormatError(f"'{path}' holds a {type(tire).__name__}; expected a tire")
    return tire
