"""`TireBicycleFit`: scaling factors of tire files from a drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Literal

from slipangle.data.dataset import Dataset, require_dataset
from slipangle.errors import ParameterError
from slipangle.fields import Checked
from slipangle.identify.physics.grey_box import GreyBox
from slipangle.models.ode import Parametrised
from slipangle.models.tires.files import read_tire
from slipangle.models.tires.magic_formula.terms import PRESETS
from slipangle.models.tires.simple import Tire
from slipangle.models.vehicles.tire_bicycle import TireBicycle, TireBicycleParams
from slipangle.models.wrappers.delayed import Delayed

_NEEDED = ("mass", "inertia_z", "wheelbase", "l_f")


@dataclass(frozen=True, kw_only=True)
class TireBicycleFit(Checked):
    """A bicycle on tires of files, whose scaling factors are fitted to a drive.

    Tires are used beyond the limits of their files. In Python, ``GreyBox(start=TireBicycle(...), free=...)`` is the
    same with tires of any origin.

    Parameters
    ----------
    car : table
        Parameters of `TireBicycleParams` by name, SI units: mass, inertia_z, wheelbase and l_f at least; start values
        of free ones.
    tire : str
        File of all four tires, ``.tir``, or ``.json`` as slipangle saves one; in a job relative to its folder.
    tire_f, tire_r : str
        Files of the front and rear tires where they differ.
    free : tuple of str
        Parameters that are fitted; ``LMUY_f`` is the scaling factor LMUY of the front tires, on top of the file's;
        ``delay_`` before an input is its delay. [s]
    per_experiment : tuple of str
        Parameters with one value for each file, and for each stretch of a file between gaps.
    force : bool
        Use coefficients outside their range as they stand.
    conventions : {"book", "mfeval"}
        Where codes of the Magic Formula differ.
    """

    car: Mapping[str, float]
    tire: str = ""
    tire_f: str = ""
    tire_r: str = ""
    free: tuple[str, ...] = ("LMUY_f", "LMUY_r", "LKY_f", "LKY_r", "inertia_z")
    per_experiment: tuple[str, ...] = ()
    force: bool = False
    conventions: Literal["book", "mfeval"] = "book"

    def __post_init__(self) -> None:
        super().__post_init__()
        require_tires(self.tire, self.tire_f, self.tire_r)
        known = {f.name for f in fields(TireBicycleParams)}
        for name in self.car:
            if name not in known:
                TireBicycleParams.si(name)
        missing = [name for name in _NEEDED if name not in self.car]
        if missing:
            raise ParameterError(f"car lacks {', '.join(missing)}; expected {', '.join(_NEEDED)} at least: add them")

    def fit(self, data: Dataset) -> Parametrised:
        """The bicycle with fitted parameters and their intervals; errors and warnings as of `GreyBox.fit`."""
        require_dataset(data, "fit() got")
        tire_f, tire_r = tires_of(self.tire, self.tire_f, self.tire_r, force=self.force, conventions=self.conventions)
        params = TireBicycleParams(**self.car)
        start: Parametrised = TireBicycle(
            params=params, dt=data.dt, tire_f=tire_f, tire_r=tire_r, outputs=tuple(data.outputs)
        )
        free = tuple(name for name in self.free if name not in self.per_experiment)
        names = (*free, *self.per_experiment)
        late = {n.removeprefix("delay_"): 0.5 * data.dt for n in names if n.startswith("delay_")}
        if late:
            start = Delayed(start, delays=late)
        return GreyBox(start=start, free=free, per_experiment=self.per_experiment).fit(data)


def require_tires(tire: str, tire_f: str, tire_r: str) -> None:
    """Raise ParameterError unless one file, or one for each axle, is named."""
    if bool(tire) == bool(tire_f or tire_r) or bool(tire_f) != bool(tire_r):
        raise ParameterError(
            f"tire is '{tire}', tire_f '{tire_f}', tire_r '{tire_r}'; expected tire, or both tire_f and tire_r: name "
            "one file for all wheels or one for each axle"
        )


def tires_of(tire: str, tire_f: str, tire_r: str, *, force: bool, conventions: str) -> tuple[Tire, Tire]:
    """Front and rear tire of files; a JSON file has its own conventions."""
    made = []
    for path in (tire or tire_f, tire or tire_r):
        own = path.lower().endswith(".json")
        made.append(read_tire(path, conventions=None if own else PRESETS[conventions], force=force and not own))
    return made[0], made[1]
